"""A robot in one colour is seen on its floor and before what is behind it."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.plotting import rendering
from btr_mjx.plotting.camera import camera_for
from btr_mjx.plotting.contrast import BACKGROUNDS, set_apart

FLOOR = '<geom type="plane" size="5 5 1" {}/>'
ROBOT = (
    '<body pos="0 0 .2"><freejoint/><geom type="box" size=".2 .1 .05" {0}/><geom size=".06" pos=".2 0 .1" {0}/></body>'
)


def model_of(robot: str, floor: str | None, assets: str = "") -> mujoco.MjModel:
    ground = "" if floor is None else FLOOR.format(floor)
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{ground}{ROBOT.format(robot)}</worldbody></mujoco>"
    )


def brightness(colour: np.ndarray) -> np.ndarray:
    return colour[..., :3] @ [0.2126, 0.7152, 0.0722]


levels = st.integers(0, 100).map(lambda percent: percent / 100)


@given(robot=st.tuples(levels, levels, levels), floor=levels)
def test_a_floor_has_another_brightness_than_the_robot(robot: tuple[float, ...], floor: float) -> None:
    model = model_of(f'rgba="{robot[0]} {robot[1]} {robot[2]} 1"', f'rgba="{floor} {floor} {floor} 1"')
    set_apart(model)
    ground, *parts = brightness(model.geom_rgba)
    assert min(parts) > 0.19
    assert min(abs(ground - part) for part in parts) > 0.19
    if abs(brightness(np.array(robot)) - floor) > 0.21 and brightness(np.array(robot)) > 0.21:
        assert ground == pytest.approx(floor, abs=1e-6)  # it was seen as it was


def test_textures_and_materials() -> None:
    """A material counts as the colour of its geoms; what has a texture keeps it."""
    assets = (
        '<texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="0 0 0" rgb2="1 1 1"/>'
        '<material name="tiles" texture="t" rgba=".5 .5 .5 1"/><material name="black" rgba="0 0 0 1"/>'
    )
    model = model_of('material="black"', 'material="tiles"', assets)
    set_apart(model)
    np.testing.assert_allclose(model.mat_rgba[0], [0.5, 0.5, 0.5, 1])
    assert brightness(model.mat_rgba[1]) == pytest.approx(0.2)


@pytest.mark.parametrize("floor", ["", 'rgba="1 1 1 1"', 'rgba=".05 .05 .05 1"', None])
@pytest.mark.parametrize("robot", ["", 'rgba="1 1 1 1"', 'rgba=".05 .05 .05 1"'])
def test_every_side_of_it_is_seen(robot: str, floor: str | None) -> None:
    """In the picture, its top differs from what surrounds it, and its sides from each other."""
    if rendering.working_backend() is None:
        pytest.skip("no OpenGL")
    model = model_of(robot, floor)
    pictures = rendering.render([(model, model.qpos0[None])], 160, 120, camera_for([model]))
    assert pictures is not None
    grey = brightness(pictures[0][0].astype(float))
    top, around = grey[56:60, 78:82].mean(), np.concatenate([grey[2], grey[-3]]).mean()
    assert abs(top - around) > 25
    assert len(np.unique(np.round(grey[30:95, 40:120] / 8))) >= 4


def test_a_light_robot_has_a_darker_background() -> None:
    assert set_apart(model_of('rgba="1 1 1 1"', None)) == BACKGROUNDS[1]
    assert set_apart(model_of("", None)) == BACKGROUNDS[0]
