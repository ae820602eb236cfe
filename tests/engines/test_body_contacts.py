"""Contact of spheres and capsules with each other against native MuJoCo; single steps of chains are in test_lanes."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import FAST, QUICK, mjcf, tangle

from btr_mjx import lanes
from btr_mjx.engines import LanesStepper

SHAPES = (
    'type="sphere" size="0.06"',
    'type="capsule" size="0.03 0.1" margin="0.01"',
    'type="capsule" size="0.05 0.08" solimp="0.8 0.95 0.01 0.4 3"',
    'type="sphere" size="0.08" friction="1.3 0.1 0.05"',
    'type="capsule" size="0.04 0.06"',
)


def heap(condim: str, option: str = "") -> mujoco.MjModel:
    """Free bodies, every geom with a condim of its own, and a fixed capsule."""
    bodies = "".join(
        f'<body><freejoint/><geom condim="{condim[i % len(condim)]}" mass="{0.1 * (i + 1)}" {shape}/></body>'
        for i, shape in enumerate(SHAPES)
    )
    fixed = f'<geom type="capsule" size=".05 .1" condim="{condim[0]}" pos="0 0.1 0"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco><option {option}/><worldbody>{fixed}{bodies}</worldbody></mujoco>")


def scattered(model: mujoco.MjModel, count: int, rng: np.random.Generator, room: float) -> list[mujoco.MjData]:
    found = []
    for _ in range(count):
        data = mujoco.MjData(model)
        poses = np.concatenate([rng.uniform(-room, room, (model.njnt, 3)), rng.normal(size=(model.njnt, 4))], axis=1)
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        data.qpos[:], data.qvel[:] = poses.ravel(), rng.normal(size=model.nv)
        found.append(data)
    return found


def step(model: mujoco.MjModel, states: list[mujoco.MjData]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations (nv, C) of lanes and of a converged native solver, and which worlds lanes marks."""
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=True)
        before = stepper.state(*(np.stack([getattr(d, n) for d in states], axis=1) for n in ("qpos", "qvel")))
        after = jax.jit(stepper.step, compiler_options=QUICK)({}, before, jnp.zeros((0, len(states))))
        found, marked = np.asarray(stepper.qacc(after)), np.asarray(stepper.tripped(after))
        assert not np.asarray(stepper.capped(after)).any()
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    for data in states:
        mujoco.mj_step(model, data)
    return found, np.stack([d.qacc for d in states], axis=1), marked


@pytest.mark.parametrize("condim", ["1", "3", "13", "46"])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_a_heap_moves_as_native_says(condim: str, cone: str, rng: np.random.Generator) -> None:
    model = heap(condim, f'cone="{cone}"')
    states = scattered(model, 120, rng, room=0.14)
    found, expected, marked = step(model, states)
    touching = np.array([d.ncon for d in states])
    assert touching[~marked].max() >= 5
    assert marked.mean() < 0.1
    error = np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0).clip(1e-3)
    assert error[~marked].max() < 1e-10


def test_worlds_with_more_contacts_than_slots_are_marked_and_no_others(rng: np.random.Generator) -> None:
    model = heap("1")
    states = scattered(model, 300, rng, room=0.08)
    _, _, marked = step(model, states)
    touching = np.array([d.ncon for d in states])
    assert 20 < (touching > 8).sum() < 280
    np.testing.assert_array_equal(marked, touching > 8)


@pytest.mark.parametrize("turn", [0.0, 1e-9])
def test_parallel_capsules_are_marked_where_they_touch(turn: float) -> None:
    """MuJoCo finds two contacts, at both ends."""
    rods = "".join(
        f'<body pos="0 {y} 0" euler="{a} 0 0"><freejoint/><geom type="capsule" size="0.05 0.2"/></body>'
        for y, a in ((0, 0), (0.099, turn), (5, 0), (6, 0))
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{rods}</worldbody></mujoco>")
    apart = mujoco.MjData(model)
    apart.qpos[8] = 0.11
    touching = mujoco.MjData(model)
    _, _, marked = step(model, [touching, apart])
    assert touching.ncon >= 1
    np.testing.assert_array_equal(marked, [True, False])


def test_capsules_whose_axes_cross_are_marked() -> None:
    """The direction of their contact is lost in rounding."""
    rods = "".join(f'<body euler="{a} 0 0"><freejoint/><geom type="capsule" size="0.05 0.2"/></body>' for a in (0, 90))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{rods}</worldbody></mujoco>")
    crossing, apart = mujoco.MjData(model), mujoco.MjData(model)
    apart.qpos[7] = 0.01
    found, expected, marked = step(model, [crossing, apart])
    np.testing.assert_array_equal(marked, [True, False])
    np.testing.assert_allclose(found[:, 1], expected[:, 1], rtol=1e-9, atol=1e-9)


def test_trajectories_with_contact_equal_native(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(tangle(), option=f'{FAST} tolerance="0" iterations="100"'))
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.zeros((6, mujoco.mj_stateSize(model, full)))
    data, touched = mujoco.MjData(model), np.zeros(6, int)
    expected = np.zeros((6, 500, starts.shape[1]))
    for i in range(6):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = 0.05 * rng.normal(size=model.nq), rng.normal(size=model.nv)
        mujoco.mj_getState(model, data, starts[i], full)
        for k in range(500):
            mujoco.mj_step(model, data)
            touched[i] += (model.geom_type[data.contact.geom] != mujoco.mjtGeom.mjGEOM_PLANE).all(axis=1).any()
            mujoco.mj_getState(model, data, expected[i, k], full)
    assert touched.min() > 50
    with jax.enable_x64(True):
        found = lanes.rollout(model, starts, steps=500)
    assert (found.engine == "lanes").all()
    np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-7)


def test_friction_sizes_and_masses_may_differ_between_worlds(rng: np.random.Generator) -> None:
    model = heap("36")
    count = 60
    varied = {
        n: np.repeat(np.asarray(getattr(model, n), float)[None], count, 0) for n in ("geom_friction", "geom_size")
    }
    varied = {n: x * rng.uniform(0.7, 1.3, x.shape) for n, x in varied.items()}
    varied["geom_margin"] = rng.uniform(0, 0.01, (count, model.ngeom))
    states = scattered(model, count, rng, room=0.15)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, list(varied), guards=True)
        params = jax.tree.map(lambda x: x[0], stepper.pack({name: x[None] for name, x in varied.items()}))
        before = stepper.state(*(np.stack([getattr(d, n) for d in states], axis=1) for n in ("qpos", "qvel")))
        after = jax.jit(stepper.step, compiler_options=QUICK)(params, before, jnp.zeros((0, count)))
        found, marked = np.asarray(stepper.qacc(after)), np.asarray(stepper.tripped(after))
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    compared = 0
    for i, data in enumerate(states):
        for name, x in varied.items():
            getattr(model, name)[:] = x[i]
        model.geom_rbound[:] = model.geom_size[:, :2].sum(1)
        model.geom_aabb[:, 3:] = model.geom_rbound[:, None]
        mujoco.mj_forward(model, data)
        if not marked[i]:
            np.testing.assert_allclose(found[:, i], data.qacc, rtol=0, atol=1e-9 * np.linalg.norm(data.qacc))
            compared += data.ncon
    assert compared > 100


def test_a_world_has_the_same_bits_beside_others(rng: np.random.Generator) -> None:
    """Other worlds of a chunk keep the loops going, and touch elsewhere."""
    model = heap("3")
    states = scattered(model, 32, rng, room=0.14)
    qpos, qvel = (np.stack([getattr(d, n) for d in states], axis=1) for n in ("qpos", "qvel"))
    stepper = LanesStepper(model, guards=True)
    run = jax.jit(lambda q, v: stepper.qacc(stepper.step({}, stepper.state(q, v), jnp.zeros((0, 32)))))
    alone = np.asarray(run(qpos, qvel))
    order = rng.permutation(32)
    np.testing.assert_array_equal(np.asarray(run(qpos[:, order], qvel[:, order])), alone[:, order])
    others = qpos.copy()
    others[:, 1:] = qpos[:, [1]] + 10 * np.arange(model.nq)[:, None]
    np.testing.assert_array_equal(np.asarray(run(others, qvel))[:, 0], alone[:, 0])
