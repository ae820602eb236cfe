"""Ball joints of the lanes engine against native MuJoCo."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import FAST, QUICK, WATER, columns, mjcf

from btr_mjx import lanes
from btr_mjx.engines import LanesStepper, UnsupportedModel
from btr_mjx.engines.base import MUJOCO_4


def arms(first: str, second: str) -> str:
    """A slide, a hinge, and two alike arms of two ball joints off their bodies' origins, the upper before a slide."""
    rod = '<geom type="capsule" fromto="0 0 0 0.1 0.05 -0.3" size="0.03" conaffinity="0"/>'
    both = "".join(
        f"""<body pos="0 {y} 0" euler="20 0 30"><joint name="shoulder{y}" type="ball" pos="0.02 0.03 0.01" {first}/>
        <joint type="slide" axis="0.3 0 1" stiffness="200" damping="5"/>{rod}
        <body pos="0.1 0.05 -0.3"><joint name="wrist{y}" type="ball" {second}/>{rod}
        <geom size="0.05" pos="0.1 0 -0.1" condim="3"/></body></body>"""
        for y in (-0.2, 0.2)
    )
    return f"""<body pos="0 0 0.8"><joint type="slide" axis="1 0 0.1"/><joint axis="0.1 1 0"/>
    <geom type="capsule" fromto="0 -0.2 0 0 0.2 0" size="0.05" conaffinity="0"/>{both}</body>"""


PLAIN = 'damping="0.05" armature="0.01"', ""
SPRINGS = 'stiffness="3" damping="0.1"', 'stiffness="0.5" armature="0.02" frictionloss="0.1"'
STOPS = (
    'range="0 70" stiffness="2" damping="0.1" armature="0.01"',
    'range="0 100" margin="0.3" solimplimit="0.5 0.9 0.3 0.4 3" solreflimit="-300 -9"',
)
CASES = {
    "plain": mjcf(arms(*PLAIN)),
    "springs": mjcf(arms(*SPRINGS), option=FAST),
    "stops": mjcf(arms(*STOPS)),
    "stops_implicitfast": mjcf(arms(*STOPS), option=f'{FAST} cone="elliptic"'),
    "stops_springs_rk4": mjcf(arms(STOPS[0], SPRINGS[1]), option='integrator="RK4"'),
    "water": mjcf(arms(PLAIN[0], STOPS[1]), option=f"{FAST} {WATER}"),
    "flying": mjcf(arms(*STOPS).replace('<joint type="slide" axis="1 0 0.1"/><joint axis="0.1 1 0"/>', "<freejoint/>")),
}


def model_of(text: str, seed: int = 3) -> mujoco.MjModel:
    """The model, whose ball joints' springs are at rest in random orientations."""
    model = mujoco.MjModel.from_xml_string(text)
    ball = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
    for k, quaternion in zip(ball, np.random.default_rng(seed).normal(size=(len(ball), 4)), strict=True):
        adr = model.jnt_qposadr[k]
        model.qpos_spring[adr : adr + 4] = quaternion / np.linalg.norm(quaternion)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    return model


def random_states(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> list[mujoco.MjData]:
    """States with any orientations of ball joints, of either sign."""
    found = []
    for _ in range(count):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, 0.2 * rng.normal(size=model.nv), 1)
        for k in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
            quaternion = rng.normal(size=4)
            data.qpos[model.jnt_qposadr[k] :][:4] = quaternion / np.linalg.norm(quaternion)
        data.qvel[:] = 2 * rng.normal(size=model.nv)
        found.append(data)
    return found


@pytest.mark.parametrize("case", CASES)
def test_one_step_equals_native_mujoco(case: str, rng: np.random.Generator) -> None:
    model = model_of(CASES[case])
    states = random_states(model, 40, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        before = stepper.state(*columns(states, "qpos", "qvel"))
        after = jax.jit(stepper.step, compiler_options=QUICK)({}, before, jnp.zeros((0, 40)))
        found = [np.asarray(x(after)) for x in (stepper.qacc, stepper.qvel, stepper.qpos)]
        assert not np.asarray(stepper.capped(after)).any()
    for data in states:
        mujoco.mj_step(model, data)
    names = ("qacc_warmstart", "qvel", "qpos")  # that of the last stage, where there are several
    for name, x, y in zip(names, found, columns(states, *names), strict=True):
        error = np.linalg.norm(x - y, axis=0) / np.linalg.norm(y, axis=0)
        assert error.max() < 1e-9, (name, error)
    pushing = [(d.efc_force[d.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT] > 0).any() for d in states]
    assert np.mean(pushing) > 0.3 or "stops" not in case


def test_alike_arms_share_one_trace() -> None:
    sizes = [link.size for link in LanesStepper(model_of(CASES["stops"])).plan.links]
    assert sizes == [1, 2, 2]


def test_trajectories_equal_native(rng: np.random.Generator) -> None:
    model = model_of(CASES["stops_implicitfast"])
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states, pushed = random_states(model, 6, rng), np.zeros(6, int)
    starts = np.zeros((6, mujoco.mj_stateSize(model, full)))
    expected = np.zeros((6, 500, starts.shape[1]))
    for i, data in enumerate(states):
        mujoco.mj_getState(model, data, starts[i], full)
        for k in range(500):
            mujoco.mj_step(model, data)
            pushed[i] += data.nefc > 0
            mujoco.mj_getState(model, data, expected[i, k], full)
    assert pushed.min() > 50
    with jax.enable_x64(True):
        found = lanes.rollout(model, starts, steps=500)
    assert (found.engine == "lanes").all()
    np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-7)


def test_energy_is_conserved_without_damping(rng: np.random.Generator) -> None:
    """Its error is that of MuJoCo's Runge-Kutta method: second order while it adds velocities of different axes (3.x),
    fourth order since it turns along with them."""
    text = mjcf(arms("", "").replace('damping="5"', ""), option='integrator="RK4"')
    drifts: list[float] = []
    for dt in (4e-3, 2e-3):
        model = model_of(text)
        model.opt.timestep = dt
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        data = random_states(model, 1, np.random.default_rng(1))[0]
        mujoco.mj_forward(model, data)
        before = data.energy.sum()
        with jax.enable_x64(True):
            stepper = LanesStepper(model)
            state = stepper.state(data.qpos[:, None], data.qvel[:, None])
            steps = round(0.4 / dt)
            run = lambda s: jax.lax.fori_loop(0, steps, lambda _, s: stepper.step({}, s, jnp.zeros((0, 1))), s)  # noqa: B023, E731
            state = jax.jit(run, compiler_options=QUICK)(state)
            data.qpos[:], data.qvel[:] = stepper.qpos(state)[:, 0], stepper.qvel(state)[:, 0]
        mujoco.mj_forward(model, data)
        drifts.append(abs(data.energy.sum() - before) / abs(before))
    assert drifts[0] < 1e-4
    order = 4 if MUJOCO_4 else 2
    assert 0.75 < drifts[0] / drifts[1] / 2**order < 1.25


def test_a_world_has_the_same_bits_beside_others(rng: np.random.Generator) -> None:
    model = model_of(CASES["stops"])
    qpos, qvel = columns(random_states(model, 32, rng), "qpos", "qvel")
    stepper = LanesStepper(model)
    run = jax.jit(lambda q, v: stepper.qacc(stepper.step({}, stepper.state(q, v), jnp.zeros((0, 32)))))
    alone, order = np.asarray(run(qpos, qvel)), rng.permutation(32)
    np.testing.assert_array_equal(np.asarray(run(qpos[:, order], qvel[:, order])), alone[:, order])
    qvel[:, 1:] = np.where(np.arange(31) % 2, np.nan, 1e30)
    np.testing.assert_array_equal(np.asarray(run(qpos, qvel))[:, 0], alone[:, 0])


def test_fields_of_ball_joints_may_differ_between_worlds(rng: np.random.Generator) -> None:
    model = model_of(CASES["stops"])
    count = 30
    names = ("jnt_pos", "jnt_range", "jnt_stiffness", "qpos_spring", "dof_damping", "dof_armature")
    varied = {n: np.repeat(np.asarray(getattr(model, n), float)[None], count, 0) for n in names}
    for name in ("jnt_pos", "jnt_range", "jnt_stiffness"):
        varied[name] *= rng.uniform(0.7, 1.3, varied[name].shape)
    for name in ("dof_damping", "dof_armature"):
        varied[name] *= rng.uniform(0.7, 1.3, (count, model.njnt))[:, model.dof_jntid]
    quaternions = [int(a) for a in model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_BALL]]
    for adr in quaternions:
        turned = rng.normal(size=(count, 4))
        varied["qpos_spring"][:, adr : adr + 4] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    states = random_states(model, count, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, list(varied))
        params = jax.tree.map(lambda x: x[0], stepper.pack({name: x[None] for name, x in varied.items()}))
        before = stepper.state(*columns(states, "qpos", "qvel"))
        after = jax.jit(stepper.step, compiler_options=QUICK)(params, before, jnp.zeros((0, count)))
        found = np.asarray(stepper.qacc(after))
    for i, data in enumerate(states):
        for name, x in varied.items():
            getattr(model, name)[:] = x[i]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(found[:, i], data.qacc, rtol=0, atol=1e-9 * np.linalg.norm(data.qacc))


def test_disabled_limits_do_not_push(rng: np.random.Generator) -> None:
    model = model_of(CASES["stops"])
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    states = random_states(model, 10, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        before = stepper.state(*columns(states, "qpos", "qvel"))
        found = np.asarray(stepper.qacc(jax.jit(stepper.step, compiler_options=QUICK)({}, before, jnp.zeros((0, 10)))))
    for i, data in enumerate(states):
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(found[:, i], data.qacc, rtol=0, atol=1e-9 * np.linalg.norm(data.qacc))


def test_what_is_not_computed_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(UnsupportedModel, match=r"friction loss of a ball joint with a limit \(joint 'shoulder-0.2'\)"):
        LanesStepper(model_of(mjcf(arms(STOPS[0] + ' frictionloss="1"', ""))))
    driven = mjcf(arms(*PLAIN), actuators='<motor name="deltoid" joint="shoulder0.2" gear="1 0 0"/>')
    with pytest.raises(UnsupportedModel, match=r"ball joint .*deltoid"):
        LanesStepper(model_of(driven))
    uneven = model_of(CASES["stops"])
    uneven.dof_damping[-1] = 7
    with pytest.raises(UnsupportedModel, match="damping and armature that differ between the axes"):
        LanesStepper(uneven)
    stepper = LanesStepper(model_of(CASES["stops"]), ["dof_frictionloss"])
    with pytest.raises(UnsupportedModel, match=r"friction loss of a ball joint with a limit .* in some of the worlds"):
        stepper.pack({"dof_frictionloss": np.ones((1, 2, uneven.nv))})
