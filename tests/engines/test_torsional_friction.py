"""Contacts of condim 4 and 6 against native MuJoCo, by zone of the cone; random single steps are in test_lanes."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import FAST, QUICK, mjcf

from btr_mjx.engines import LanesStepper
from btr_mjx.engines.lanes_engine.constraints.cones import Cone
from btr_mjx.engines.lanes_engine.constraints.friction_cones import make_cone

FEET = (
    'type="sphere" size="0.1"',
    'type="capsule" size="0.05 0.1" euler="90 0 0"',
)


def feet(condim: int, option: str) -> mujoco.MjModel:
    """Free bodies that rest on the floor, and two pendulums on ball joints that touch a fixed ball."""
    friction = f'condim="{condim}" friction="0.8 0.06 0.02"'
    bodies = "".join(
        f'<body pos="{i} 0 {(0.099, 0.049)[i]}"><freejoint/><geom {friction} {foot}/></body>'
        for i, foot in enumerate(FEET)
    )
    arms = "".join(
        f"""<body pos="{x} 1 1"><joint type="ball" damping="0.01"/>
        <geom type="capsule" contype="2" fromto="0 0 0 0 0 -0.3" size="0.05" {friction}/></body>"""
        for x in (-0.13, 0.13)
    )
    arms += f'<geom contype="2" conaffinity="2" pos="0 1 0.7" size="0.09" {friction}/>'
    model = mujoco.MjModel.from_xml_string(mjcf(bodies + arms, option=option))
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    return model


def moving(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> list[mujoco.MjData]:
    """Feet at rest, spinning, rolling, sliding, lifting off, or several of these."""
    found = []
    for i in range(count):
        data = mujoco.MjData(model)
        kinds = rng.choice([0, 0, 1e-3, 0.1, 1], size=(model.njnt, 2))
        speed = rng.normal(size=model.nv) * kinds[model.dof_jntid, (np.arange(model.nv) % 6 > 2).astype(int)]
        data.qvel[:] = speed if i else 0
        data.qvel[2:12:6] -= rng.choice([0, 0.02, -0.05], size=2)
        found.append(data)
    return found


@pytest.mark.parametrize(
    ("condim", "option"),
    [
        (4, ""),
        (6, 'integrator="RK4"'),
        pytest.param(6, f'{FAST} cone="elliptic" impratio="2"', marks=pytest.mark.slow),
    ],
)
def test_steps_and_trajectories_equal_native(condim: int, option: str, rng: np.random.Generator) -> None:
    """In every zone of the cone; on the way the feet slow down, stop and stay."""
    model = feet(condim, option)
    states = moving(model, 60, rng)
    zones: set[int] = set()
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=True)
        step = jax.jit(lambda s: stepper.step({}, s, jnp.zeros((0, 60))), compiler_options=QUICK)
        state = step(stepper.state(*(np.stack([getattr(d, x) for d in states], axis=1) for x in ("qpos", "qvel"))))
        found, next_speed = np.asarray(stepper.qacc(state)), np.asarray(stepper.qvel(state))
        assert not (np.asarray(stepper.capped(state)) | np.asarray(stepper.tripped(state))).any()
        for i, data in enumerate(states):
            mujoco.mj_step(model, data)
            assert (data.contact.dim == condim).all()
            assert (model.geom_type[data.contact.geom] != mujoco.mjtGeom.mjGEOM_PLANE).all(axis=1).sum() == 2
            zones |= set(data.efc_state.tolist())
            for x, y in ((found[:, i], data.qacc_warmstart), (next_speed[:, i], data.qvel)):
                assert np.linalg.norm(x - y) < 1e-9 * np.linalg.norm(y) + 1e-12
        for _ in range(499):
            state = step(state)
        end = np.concatenate([stepper.qpos(state), stepper.qvel(state)])
        assert not np.asarray(stepper.tripped(state)).any()
    kinds = mujoco.mjtConstraintState
    expected = {int(kinds.mjCNSTRSTATE_SATISFIED), int(kinds.mjCNSTRSTATE_QUADRATIC)}
    assert zones == expected | ({int(kinds.mjCNSTRSTATE_CONE)} if "elliptic" in option else set())
    for i, data in enumerate(states[:5]):
        for _ in range(499):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(end[:, i], np.concatenate([data.qpos, data.qvel]), rtol=0, atol=1e-7)


@pytest.mark.parametrize("option", ["", pytest.param('cone="elliptic" impratio="2"', marks=pytest.mark.slow)])
def test_a_world_has_the_same_bits_beside_others(option: str, rng: np.random.Generator) -> None:
    model = feet(6, option)
    states = moving(model, 32, rng)
    qpos, qvel = (np.stack([getattr(d, name) for d in states], axis=1) for name in ("qpos", "qvel"))
    stepper = LanesStepper(model, guards=True)
    accelerations = lambda q, v: stepper.qacc(stepper.step({}, stepper.state(q, v), jnp.zeros((0, 32))))  # noqa: E731
    run = jax.jit(accelerations, compiler_options=QUICK)
    alone, order = np.asarray(run(qpos, qvel)), rng.permutation(32)
    np.testing.assert_array_equal(np.asarray(run(qpos[:, order], qvel[:, order])), alone[:, order])
    qvel[:, 1:] = np.where(np.arange(31) % 2, np.nan, 1e30)
    np.testing.assert_array_equal(np.asarray(run(qpos, qvel))[:, 0], alone[:, 0])


@pytest.mark.parametrize("condim", [3, 4, 6])
def test_slopes_along_a_line_are_those_of_the_forces(condim: int, rng: np.random.Generator) -> None:
    """The closed form of a cone against its stiffness and force at the same point, in every zone."""
    friction = [0.8, *([0.06] if condim > 3 else []), *([0.02] if condim > 4 else [])]
    with jax.enable_x64(True):
        rows = lambda: list(jnp.asarray(rng.normal(size=(condim, 500))))  # noqa: E731
        cone = make_cone(condim, [], friction, jnp.full(500, 3.0), rows(), 2.0, np.float64)
        start, along = rows(), rows()
        zones = set()
        for length in (0.0, 0.3, 1.0, 2.5):
            here = [x + length * d for x, d in zip(start, along, strict=True)]
            kinds = np.count_nonzero(np.array(cone.model(here)[:4]), axis=0)
            zones |= set(kinds.tolist())
            both = (law(length) for law in (cone.slopes(start, along), Cone.slopes(cone, start, along)))
            for found, expected in zip(*both, strict=True):
                np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
        assert len(zones) == 3  # separated, sticking, sliding
