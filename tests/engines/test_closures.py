"""Equality constraints that connect or weld bodies against native MuJoCo."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import FAST, QUICK, chain, columns, exact, mjcf, quadruped, relative_error

from btr_mjx import lanes
from btr_mjx.engines import LanesStepper
from btr_mjx.engines.lanes_engine.kinematics import matrix_quaternion
from btr_mjx.engines.lanes_engine.lanes_state import LanesState

ROD = '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" conaffinity="0"/>'
FOUR_BAR = f"""<body name="crank" pos="0 0 1"><joint axis="0 1 0" damping="0.01"/>{ROD}
<body name="coupler" pos="0.3 0 0" euler="0 40 0"><joint axis="0 1 0"/>{ROD}</body></body>
<body name="rocker" pos="0.6 0 0.9"><joint axis="0 1 0"/>{ROD}</body>"""
BARS = '<connect body1="coupler" body2="rocker" anchor="0.3 0.01 0"/>'
BRICK = '<geom type="box" size="0.1 0.15 0.2" pos="0.02 0.03 0" conaffinity="0"/><site name="in_{0}" {1}/>'
BRICKS = "".join(
    f'<body name="{name}" pos="{x} 0 1" euler="10 {20 * x} 30"><freejoint/>{BRICK.format(name, site)}</body>'
    for name, x, site in (("one", 0, 'pos="0.1 0.2 0.1" euler="20 0 40"'), ("other", 0.5, 'pos="-0.3 0.1 0"'))
)
FIXED = """<body name="post" pos="0.1 0.2 0.9" euler="0 30 5"><geom size="0.01" conaffinity="0"/>
<site name="hook" pos="0.1 0 0" euler="5 6 7"/><body name="arm" pos="0.1 0 0"/></body>
<body name="hand" mocap="true" pos="1 0 1" euler="3 2 1"/>"""
SOFT = 'solref="0.05 0.7" solimp="0.5 0.99 0.1 0.3 3"'
WELDS = f"""<weld body1="one" torquescale="0.3" anchor="0.1 0.2 -0.1" {SOFT}/>
<weld body1="one" body2="other" relpose="0.4 0.1 0 0.9 0.1 0.3 -0.2" torquescale="2.5"/>
<weld body1="hand" body2="other" solimp="0.9 0.9 0.01"/>"""
SITES = f"""<weld site1="in_one" site2="in_other" torquescale="0.4"/><connect site1="hook" site2="in_one" {SOFT}/>
<weld site1="in_other" site2="hook" active="false"/><connect body1="arm" body2="post" anchor="0 0 1"/>
<weld site1="hook" site2="in_other" solref="-500 -20"/>"""
LOOPS = """<connect body1="tip" body2="base" anchor="0.1 0.05 -0.2"/><weld body1="tip" body2="middle"/>
<joint joint1="p0" joint2="p2" polycoef="0.1 0.7"/>"""


def joined(bodies: str, equality: str, **options: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        mjcf(bodies, **options).replace("</mujoco>", f"<equality>{equality}</equality></mujoco>")
    )


def looped_chain() -> str:
    """A chain whose links have names."""
    found = chain(4)
    for name in ("base", "middle", "other", "tip"):
        found = found.replace("<body pos", f'<body name="{name}" pos', 1)
    return found


def alike_legs() -> mujoco.MjModel:
    """A quadruped on a floor: two of its alike legs are joined to each other, two to the trunk."""
    bodies = quadruped().split("<body pos=")[1:]
    shanks = [n for n, body in enumerate(bodies) if 'name="knee' in body]
    names = {0: "trunk"} | {n: f"shank{k}" for k, n in enumerate(shanks)}
    text = "".join(f'<body name="{names.get(n, n)}" pos={body}' for n, body in enumerate(bodies))
    ties = """<connect body1="shank0" body2="shank1" anchor="0 0.05 -0.2" solref="0.1 1"/>
    <weld body1="shank2" body2="trunk" solref="0.1 1"/><connect body1="trunk" body2="shank3" anchor="0 0 -0.1"/>"""
    return joined(text, ties, option=f'{FAST} cone="elliptic"')


CASES = {
    "four_bar": lambda: joined(FOUR_BAR, BARS),
    "four_bar_implicitfast": lambda: joined(FOUR_BAR, BARS, option=FAST),
    "bricks": lambda: joined(BRICKS + FIXED, WELDS, option='gravity="1 -2 -9"'),
    "sites": lambda: joined(BRICKS + FIXED, SITES, option=FAST),
    "loops": lambda: joined(looped_chain(), LOOPS),
    "loops_rk4": lambda: joined(looped_chain(), LOOPS, option='integrator="RK4"'),
    "alike_legs": alike_legs,
}


def scattered(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> list[mujoco.MjData]:
    """States of slow and of fast motion, near where the constraints hold and far from it."""
    found = []
    for _ in range(count):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv) * 10 ** rng.uniform(-4, 0.5), 1.0)
        data.qvel[:] = rng.normal(size=model.nv) * 10 ** rng.uniform(-4, 1)
        found.append(data)
    return found


def stepped(
    stepper: LanesStepper, states: list[mujoco.MjData], params: dict[str, list[jax.Array]] | None = None
) -> LanesState:
    before = stepper.state(*columns(states, "qpos", "qvel"))
    return jax.jit(stepper.step, compiler_options=QUICK)(params or {}, before, jnp.zeros((0, len(states))))


@pytest.mark.parametrize("case", CASES)
def test_a_step_equals_native(case: str, rng: np.random.Generator) -> None:
    model = CASES[case]()
    states = scattered(model, 100, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        after = stepped(stepper, states)
        found = [np.asarray(x(after)) for x in (stepper.qacc, stepper.qvel)]
        assert not np.asarray(stepper.capped(after)).any()
    exact(model)
    for data in states:
        mujoco.mj_step(model, data)
    for x, name in zip(found, ("qacc", "qvel"), strict=True):
        assert relative_error(x, columns(states, name)[0]) < 1e-10, name
    assert (sum(data.ncon for data in states) > 50) == (case == "alike_legs")


def test_the_quaternion_of_a_matrix_is_exact_also_of_half_turns(rng: np.random.Generator) -> None:
    turns = [*np.eye(4), *rng.normal(size=(20, 4)), *(rng.normal(size=(20, 4)) * [1e-9, 1, 1, 1])]
    quaternions = np.array([q / np.linalg.norm(q) for q in turns])
    matrices = np.zeros((len(quaternions), 9))
    for q, matrix in zip(quaternions, matrices, strict=True):
        mujoco.mju_quat2Mat(matrix, q)
    with jax.enable_x64(True):
        found = np.array(
            matrix_quaternion([[jnp.asarray(matrices[:, 3 * i + j]) for j in range(3)] for i in range(3)])
        ).T
    sign = np.sign((found * quaternions).sum(1, keepdims=True))
    np.testing.assert_allclose(sign * found, quaternions, rtol=0, atol=1e-15)


def test_single_precision_is_enough_for_stiff_constraints(rng: np.random.Generator) -> None:
    """The error grows with the stiffness, not with its square."""
    model = exact(CASES["bricks"]())
    model.eq_solimp[:, :2] = 0.999
    states = scattered(model, 100, rng)
    stepper = LanesStepper(model)
    found = np.asarray(stepper.qacc(stepped(stepper, states)), float)
    for data in states:
        mujoco.mj_forward(model, data)
    assert relative_error(found, columns(states, "qacc")[0]) < 1e-4


def test_equality_of_flexes_is_refused() -> None:
    cloth = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1"><edge equality="true"/></flexcomp>'
    refused = lanes.coverage(mjcf(cloth)).refused
    assert any("cloth" in own for own in refused)
    assert any("mjEQ_FLEX" in own for own in refused)


def test_trajectories_equal_native(rng: np.random.Generator) -> None:
    """A mechanism that turns and keeps its loop closed."""
    model = exact(CASES["four_bar"]())
    data, step_count = mujoco.MjData(model), 500
    for _ in range(100):
        mujoco.mj_step(model, data)
    with jax.enable_x64(True):
        stepper = LanesStepper(model)

        def step(state: LanesState, _: None) -> tuple[LanesState, jax.Array]:
            state = stepper.step({}, state, jnp.zeros((0, 1)))
            return state, stepper.qpos(state)[:, 0]

        run = jax.jit(lambda state: jax.lax.scan(step, state, length=step_count)[1], compiler_options=QUICK)
        found = np.asarray(run(stepper.state(data.qpos[:, None], data.qvel[:, None])))
    expected = np.zeros((step_count, model.nq))
    for k in range(step_count):
        mujoco.mj_step(model, data)
        expected[k] = data.qpos
    assert np.ptp(expected, axis=0).min() > 0.5
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


FIELDS = ["eq_data", "eq_solref", "eq_solimp", "body_invweight0", "body_pos", "body_quat", "site_pos", "site_quat"]


@pytest.mark.parametrize("case", ["bricks", "sites", "four_bar"])
def test_fields_may_differ_between_worlds(case: str, rng: np.random.Generator) -> None:
    model, count = CASES[case](), 40
    fields = [name for name in FIELDS if getattr(model, name).size]
    varied = {name: np.repeat(getattr(model, name)[None], count, 0) for name in fields}
    varied = {name: x * rng.uniform(0.8, 1.2, x.shape) for name, x in varied.items()}
    for turns in (varied["body_quat"], varied.get("site_quat"), varied["eq_data"][..., 6:10]):
        if turns is not None:
            turns /= np.linalg.norm(turns, axis=-1, keepdims=True).clip(1e-9)
    states = scattered(model, count, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, fields)
        params = jax.tree.map(lambda x: x[0], stepper.pack({name: x[None] for name, x in varied.items()}))
        found = np.asarray(stepper.qacc(stepped(stepper, states, params)))
    exact(model)
    for shortcut in (model.body_sameframe, model.site_sameframe):
        shortcut[:] = 0  # they hold for the unedited model only
    for i, data in enumerate(states):
        for name, x in varied.items():
            getattr(model, name)[:] = x[i]
        for body in np.flatnonzero(model.body_mocapid >= 0):
            data.mocap_pos[:], data.mocap_quat[:] = model.body_pos[body], model.body_quat[body]
        mujoco.mj_forward(model, data)
    assert relative_error(found, columns(states, "qacc")[0]) < 1e-9


def test_anchors_follow_bodies_that_differ(rng: np.random.Generator) -> None:
    """The point on the second body is where the first body's is in qpos0."""
    model, count = exact(CASES["four_bar"]()), 3
    places = model.body_pos + 0.05 * rng.uniform(-1, 1, (count, *model.body_pos.shape)) * (model.body_pos != 0)
    start = np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    with jax.enable_x64(True):
        found = lanes.rollout(model, start, steps=20, varying={"body_pos": places})
    assert (found.engine == "lanes").all()
    for own, state in zip(places, found.state, strict=True):
        model.body_pos[:] = own
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        mujoco.mj_setState(model, data, start[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        for _ in range(20):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(state[-1, 1 : 1 + model.nq], data.qpos, rtol=0, atol=1e-9)


def test_derivatives_are_finite_where_the_constraint_holds(rng: np.random.Generator) -> None:
    """The norm of the residual has no derivative at zero; impedance is even in it."""
    body = f'<body name="one" pos="0 0 1"><freejoint/>{BRICK.format("one", "")}</body>'
    model = exact(joined(body, '<weld body1="one"/>'))
    data, along, delta = mujoco.MjData(model), rng.normal(size=model.nv), 1e-6
    with jax.enable_x64(True):
        stepper = LanesStepper(model)

        def force(length: jax.Array) -> jax.Array:
            place = jnp.asarray(model.qpos0).at[:3].add(length * along[:3])
            return stepper.qacc(
                stepper.step({}, stepper.state(place[:, None], length * along[:, None]), jnp.zeros((0, 1)))
            )

        _, slope = jax.jvp(force, (0.0,), (1.0,))
    rates = []
    for sign in (-1, 1):
        data.qpos[:3] = model.qpos0[:3] + sign * delta * along[:3]
        data.qvel[:] = sign * delta * along
        mujoco.mj_forward(model, data)
        rates.append(data.qacc.copy())
    np.testing.assert_allclose(np.asarray(slope)[:, 0], (rates[1] - rates[0]) / (2 * delta), rtol=1e-4)


def test_a_world_has_the_same_bits_beside_others(rng: np.random.Generator) -> None:
    model = CASES["loops"]()
    qpos, qvel = columns(scattered(model, 32, rng), "qpos", "qvel")
    stepper = LanesStepper(model)
    run = jax.jit(lambda q, v: stepper.qacc(stepper.step({}, stepper.state(q, v), jnp.zeros((0, 32)))))
    alone = np.asarray(run(qpos, qvel))
    order = rng.permutation(32)
    np.testing.assert_array_equal(np.asarray(run(qpos[:, order], qvel[:, order])), alone[:, order])
