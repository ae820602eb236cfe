"""Cameras and pictures of robots."""

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.models import compile_mjcf
from btr_mjx.plotting import rendering
from btr_mjx.plotting.camera import EMPTY_SIDE, FOVY, Camera, camera_for, geom_corners, highest_group, view_axes
from btr_mjx.plotting.render_worker import hide_covered_spheres
from btr_mjx.robots import hexapod

ROBOT = hexapod()


def projected(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Picture coordinates (n, 2), with the upper edge at 1, and depths (n,) of points, as a pinhole shows them."""
    seen = (points - camera.lookat) @ view_axes().T
    depth = seen[:, 2] + camera.distance
    return seen[:, :2] / (depth[:, None] * np.tan(np.radians(FOVY) / 2)), depth


def test_camera_shows_every_corner_and_no_more_than_that() -> None:
    models = [
        compile_mjcf(ROBOT, ROBOT.render(values)) for values in (ROBOT.simulation_box.low, ROBOT.simulation_box.high)
    ]
    camera = camera_for(models, 1.3)
    corners = np.concatenate([geom_corners(model, model.qpos0) for model in models])
    flat, depth = projected(camera, np.concatenate([corners, corners * [1, 1, 0]]))  # with their shadows
    assert (depth > 0).all()
    assert np.abs(flat / [1.3, 1]).max() == pytest.approx(1 - 2 * EMPTY_SIDE)


def test_corners_are_those_of_every_kind_of_geom_that_is_drawn() -> None:
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
      <geom type="sphere" size=".1" pos="1 0 0"/><geom type="capsule" size=".1 .3" pos="0 0 1"/>
      <geom type="cylinder" size=".1 .3"/><geom type="ellipsoid" size=".1 .2 .3"/>
      <geom type="box" size=".1 .2 .3" euler="90 0 0"/>
      <geom type="box" size="1 1 1" rgba="1 1 1 0"/><geom type="box" size="1 1 1" group="4"/>
      </worldbody></mujoco>"""
    corners = geom_corners(mujoco.MjModel.from_xml_string(xml), np.zeros(0)).reshape(5, 8, 3)
    half = [[0.1, 0.1, 0.1], [0.1, 0.1, 0.4], [0.1, 0.1, 0.3], [0.1, 0.2, 0.3], [0.1, 0.3, 0.2]]
    np.testing.assert_allclose(np.ptp(corners, axis=1) / 2, half, atol=1e-12)
    np.testing.assert_allclose(corners.mean(axis=1)[:2], [[1, 0, 0], [0, 0, 1]], atol=1e-12)


def model_with_groups(floor: int, *groups: int) -> mujoco.MjModel:
    geoms = "".join(f'<geom size=".1" pos="{k} 0 0" group="{group}"/>' for k, group in enumerate(groups))
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom type="plane" size="5 5 1" group="{floor}"/>
        <body pos="0 0 1"><joint/>{geoms}</body></worldbody></mujoco>"""
    )


@pytest.mark.parametrize(
    ("groups", "highest"), [((0, 3), 2), ((2, 3, 4), 2), ((3,), 3), ((3, 5), 3), ((4, 4), 4), ((1,), 2)]
)
def test_collision_geoms_are_drawn_where_nothing_else_of_the_robot_is_visible(
    groups: tuple[int, ...], highest: int
) -> None:
    """A floor in group 0 is not the robot."""
    model = model_with_groups(0, *groups)
    assert highest_group(model) == highest
    assert len(geom_corners(model, model.qpos0)) == 8 * sum(group <= highest for group in groups)


def test_covered_spheres_are_hidden() -> None:
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    hide_covered_spheres(model)
    assert model.geom("foot0").rgba[3] == 0
    assert model.geom("b3").rgba[3] == 1


@pytest.fixture
def fresh_probe(monkeypatch: pytest.MonkeyPatch):
    rendering.working_backend.cache_clear()
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    yield monkeypatch
    rendering.working_backend.cache_clear()


def pictures_of(model: mujoco.MjModel, width: int = 96, height: int = 72) -> np.ndarray | None:
    found = rendering.render([(model, model.qpos0[None])], width, height, camera_for([model], width / height))
    return None if found is None else found[0][0]


def test_no_backend_is_said_once_in_one_line(
    fresh_probe: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls = []
    fresh_probe.setattr(rendering.platform, "system", lambda: "Linux")

    def ends_at_once(command: list[str], env: dict[str, str], **options: object) -> subprocess.Popen:
        calls.append(env["MUJOCO_GL"])
        return popen([sys.executable, "-c", "import os; os.abort()"], **options)

    popen = subprocess.Popen
    fresh_probe.setattr(rendering.subprocess, "Popen", ends_at_once)
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    assert pictures_of(model) is None
    assert pictures_of(model) is None
    assert calls == ["egl", "osmesa"]
    (said,) = capsys.readouterr().err.splitlines()
    assert "no OpenGL (tried egl, osmesa)" in said


def test_a_backend_that_hangs_counts_as_broken(fresh_probe: pytest.MonkeyPatch) -> None:
    fresh_probe.setenv("MUJOCO_GL", "egl")
    fresh_probe.setattr(rendering, "TIMEOUT", 0.01)
    fresh_probe.setattr(rendering, "FRAME_TIMEOUT", 0.0)
    assert rendering.working_backend() is None


def test_rendering_can_be_switched_off(fresh_probe: pytest.MonkeyPatch) -> None:
    fresh_probe.setenv("MUJOCO_GL", "disable")
    fresh_probe.setattr(rendering, "_pictures", lambda *a: pytest.fail("must not try"))
    assert rendering.working_backend() is None


needs_gl = pytest.mark.skipif("rendering.working_backend() is None", reason="no OpenGL on this machine")


@needs_gl
def test_geoms_are_rendered_where_a_pinhole_shows_them() -> None:
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    model.geom_rgba[:] = (1.0, 0.0, 0.0, 1.0)
    model.geom_matid[:] = -1
    model.geom_rgba[model.geom("ground").id] = (0.0, 0.0, 1.0, 1.0)
    width, height = 96, 72
    picture = pictures_of(model, width, height)
    assert picture is not None
    assert picture.shape == (height, width, 3)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in ("b0", "b2", "b9", "b14"):
        (x, y) = projected(camera_for([model], width / height), data.geom(name).xpos[None])[0][0]
        column, row = (x * height / width + 1) / 2 * width, (1 - y) / 2 * height
        patch = picture[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].reshape(-1, 3).astype(int)
        assert (patch[:, 0] > 2 * patch[:, 2]).any(), name


@needs_gl
def test_a_robot_of_collision_geoms_alone_is_in_its_picture() -> None:
    model, same = model_with_groups(0, 3), model_with_groups(0, 0)
    np.testing.assert_array_equal(pictures_of(model), pictures_of(same))
    alone = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom type="plane" size="5 5 1"/></worldbody></mujoco>')
    camera = camera_for([model], 96 / 72)
    empty = rendering.render([(alone, np.zeros((1, 0)))], 96, 72, camera)
    assert empty is not None
    assert (empty[0][0] != pictures_of(model)).any()


@needs_gl
def test_the_path_of_a_robot_without_a_sky_is_drawn() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="5 5 1"/><body pos="0 0 .3"><freejoint/>
        <geom size=".1" rgba=".2 .2 .2 1"/></body></worldbody></mujoco>"""
    )
    poses = np.repeat(model.qpos0[None], 2, axis=0)
    poses[1, 0] = 1.0
    (both,) = rendering.render([(model, poses)], 160, 120, camera_for([model], poses=[poses])) or ()
    orange = (both[..., 0].astype(int) > 40 + both[..., 2]).sum(axis=(1, 2))
    assert orange[0] == 0
    assert orange[1] > 20


@needs_gl
def test_words_that_libraries_print_do_not_become_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_with_groups(0, 0)
    clean = pictures_of(model)
    hook = "lambda event, _: event == 'pickle.find_class' and os.write(1, b'words')"
    (tmp_path / "sitecustomize.py").write_text(f"import os, sys\nsys.addaudithook({hook})\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    np.testing.assert_array_equal(pictures_of(model), clean)
