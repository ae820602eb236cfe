"""Equality of joints and tendons, limits and friction loss of fixed tendons against native MuJoCo."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import FAST, QUICK, chain, columns, exact, mjcf, quadruped, relative_error, tangle

from btr_mjx import lanes
from btr_mjx.engines import LanesStepper, UnsupportedModel
from btr_mjx.engines.lanes_engine.lanes_state import LanesState

CONSTRAINT = mujoco.mjtConstraint
LIMITS = """<fixed name="a" range="-0.2 0.1" margin="0.02" solreflimit="0.03 0.8" springlength="-0.05 0.1"
stiffness="3"><joint joint="p0" coef="1"/><joint joint="p2" coef="-1.5"/></fixed>
<fixed name="b" range="-0.1 0.3" solimplimit="0.5 0.99 0.1 0.3 3"><joint joint="p1" coef="0.7"/>
<joint joint="p3" coef="1.2"/></fixed>"""
FRICTION = LIMITS.replace('name="a"', 'name="a" frictionloss="1" solreffriction="0.05 1"').replace(
    'name="b"', 'name="b" frictionloss="6"'
)
EQUALITY = """<joint name="curve" joint1="p0" joint2="p2" polycoef="0.1 0.7 -0.5 0.3 0.2"/>
<joint name="off" joint1="p1" joint2="p0" active="false"/><joint name="still" joint1="p3" polycoef="0.2 5"/>
<joint name="soft" joint1="p1" joint2="p3" solref="0.05 0.7" solimp="0.5 0.99 0.1 0.3 3"/>"""
TENDONS = """<tendon name="pair" tendon1="a" tendon2="b" polycoef="0.1 0.5 0.2" solref="-500 -20"/>
<tendon name="held" tendon1="b" polycoef="0.05"/>"""
ACTUATORS = """<motor joint="p0" gear="3"/>
<general tendon="a" dyntype="filter" dynprm="0.1" gainprm="3" biastype="affine" biasprm="1 -2 -0.3"/>
<general joint="p2" dyntype="filterexact" dynprm="0.1" gainprm="3"/>
<general tendon="b" dyntype="integrator" gainprm="3" actlimited="true" actrange="-0.5 0.5"/>
<pid tendon="a" kp="20" ki="4" kv="1" input="pos"/>"""


def rowed(bodies: str, tendon: str = "", equality: str = "", **options: str) -> mujoco.MjModel:
    rows = f"<tendon>{tendon}</tendon><equality>{equality}</equality></mujoco>"
    return mujoco.MjModel.from_xml_string(mjcf(bodies, **options).replace("</mujoco>", rows))


def alike_legs() -> mujoco.MjModel:
    """A quadruped whose legs, members of a group, are coupled to each other: a tendon across, and hips."""
    hips = [f"hip{x}{y}" for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    across = "".join(f'<joint joint="{hip}" coef="{1 - 0.7 * i}"/>' for i, hip in enumerate(hips[:3]))
    tendon = f'<fixed name="across" range="-0.1 0.1" frictionloss="3">{across}</fixed>'
    return rowed(quadruped(), tendon, f'<joint joint1="{hips[0]}" joint2="{hips[3]}" polycoef="0 -1"/>', option=FAST)


def arms_that_touch() -> mujoco.MjModel:
    """Rows beside contacts between bodies."""
    arms = tangle().replace('<joint axis="1 0 0.3"', '<joint name="elbow" axis="1 0 0.3"', 1)
    tendon = """<fixed name="a" range="-0.1 0.1" frictionloss="3"><joint joint="shoulder-0.2" coef="1"/>
    <joint joint="shoulder0.2" coef="1"/></fixed>"""
    return rowed(arms, tendon, '<joint joint1="elbow" joint2="shoulder-0.2" polycoef="0 0.6 0.5"/>')


CASES = {
    "equality": lambda: rowed(chain(4), equality=EQUALITY),
    "limits": lambda: rowed(chain(4), LIMITS),
    "friction": lambda: rowed(chain(4), FRICTION),
    "all": lambda: rowed(chain(4), FRICTION, EQUALITY + TENDONS, actuators=ACTUATORS),
    "implicitfast": lambda: rowed(chain(4), LIMITS, TENDONS, option=FAST),
    "rk4": lambda: rowed(chain(4), FRICTION, TENDONS, option='integrator="RK4"'),
    "alike_legs": alike_legs,
    "arms_that_touch": arms_that_touch,
    "without_equality": lambda: rowed(chain(4), LIMITS, EQUALITY, flags='equality="disable"'),
    "without_limits": lambda: rowed(chain(4), FRICTION, TENDONS, flags='limit="disable"'),
    "without_friction": lambda: rowed(chain(4), FRICTION, TENDONS, flags='frictionloss="disable"'),
}


def scattered(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> list[mujoco.MjData]:
    """States of slow and of fast motion."""
    found = []
    for _ in range(count):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, 0.3 * rng.normal(size=model.nv), 1.0)
        data.qvel[:] = rng.normal(size=model.nv) * 10 ** rng.uniform(-4, 1)
        data.ctrl[:], data.act[:] = rng.uniform(-1, 1, model.nu), 0.3 * rng.normal(size=model.na)
        found.append(data)
    return found


@pytest.mark.parametrize("case", CASES)
def test_a_step_equals_native(case: str, rng: np.random.Generator) -> None:
    model = CASES[case]()
    states = scattered(model, 100, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=case == "arms_that_touch")
        before = stepper.state(*columns(states, "qpos", "qvel", "act"))
        after = jax.jit(stepper.step, compiler_options=QUICK)({}, before, jnp.asarray(columns(states, "ctrl")[0]))
        found = [np.asarray(x(after)) for x in (stepper.qacc, stepper.qvel, stepper.act)]
        computed = ~np.asarray(stepper.tripped(after))
        assert computed.mean() > 0.8
        assert not np.asarray(stepper.capped(after)).any()
    exact(model)
    kinds: dict[int, int] = {}
    slipping = {-1: 0, 0: 0, 1: 0}
    for data in states:
        mujoco.mj_step(model, data)
        for kind, force, loss in zip(data.efc_type, data.efc_force, data.efc_frictionloss, strict=True):
            kinds[int(kind)] = kinds.get(int(kind), 0) + 1
            if kind == CONSTRAINT.mjCNSTR_FRICTION_TENDON:
                slipping[int(np.sign(force)) * int(abs(force) == loss)] += 1
    for x, name in zip(found, ("qacc", "qvel", "act"), strict=True):
        assert relative_error(x[:, computed], columns(states, name)[0][:, computed]) < 1e-9, name
    rows = {name: kinds.get(int(getattr(CONSTRAINT, f"mjCNSTR_{name}")), 0) for name in ("EQUALITY", "LIMIT_TENDON")}
    assert (rows["EQUALITY"] > 0) == bool(model.neq and case != "without_equality")
    assert (rows["LIMIT_TENDON"] > 50) == bool(np.any(model.tendon_limited) and case != "without_limits")
    assert (min(slipping.values()) > 2) == bool(np.any(model.tendon_frictionloss) and case != "without_friction")


def test_limits_of_joints_can_be_disabled(rng: np.random.Generator) -> None:
    """By the flag of limits, or of all constraints."""
    for flag in ("limit", "constraint"):
        model = rowed('<body><joint axis="0 1 0" range="-5 5"/><geom size="0.1"/></body>', flags=f'{flag}="disable"')
        states = scattered(model, 20, rng)
        with jax.enable_x64(True):
            stepper = LanesStepper(model)
            after = stepper.step({}, stepper.state(*columns(states, "qpos", "qvel")), jnp.zeros((0, 20)))
            found = np.asarray(stepper.qacc(after))
        for data in states:
            mujoco.mj_forward(model, data)
        assert relative_error(found, columns(states, "qacc")[0]) < 1e-9


def test_trajectories_equal_native(rng: np.random.Generator) -> None:
    model = exact(CASES["all"]())
    states, controls = scattered(model, 4, rng), rng.uniform(-1, 1, (500, model.nu, 4))
    with jax.enable_x64(True):
        stepper = LanesStepper(model)

        def step(state: LanesState, ctrl: jax.Array) -> tuple[LanesState, jax.Array]:
            state = stepper.step({}, state, ctrl)
            return state, stepper.qpos(state)

        run = jax.jit(lambda state, ctrl: jax.lax.scan(step, state, ctrl)[1], compiler_options=QUICK)
        found = np.asarray(run(stepper.state(*columns(states, "qpos", "qvel", "act")), jnp.asarray(controls)))
    for i, data in enumerate(states):
        for k in range(500):
            data.ctrl[:] = controls[k, :, i]
            mujoco.mj_step(model, data)
            np.testing.assert_allclose(found[k, :, i], data.qpos, rtol=0, atol=1e-7)


def test_controls_of_tendons_may_be_delayed(rng: np.random.Generator) -> None:
    servo = """<position tendon="b" kp="20" delay="0.0051" nsample="5" interp="linear"/><motor joint="p0"/>
    <general tendon="a" dyntype="filter" dynprm="0.01" gainprm="3" delay="0.0047" nsample="6" interp="cubic"/>"""
    model = exact(rowed(chain(4), FRICTION, actuators=servo))
    data, controls = mujoco.MjData(model), rng.uniform(-1, 1, (25, model.nu))
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        state, step = stepper.initial({}, 1), jax.jit(stepper.step, compiler_options=QUICK)
        for ctrl in controls:
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)
            state = step({}, state, jnp.asarray(ctrl[:, None]))
        np.testing.assert_allclose(np.asarray(stepper.qpos(state))[:, 0], data.qpos, rtol=0, atol=1e-11)
        np.testing.assert_allclose(np.asarray(stepper.act(state))[:, 0], data.act, rtol=0, atol=1e-11)


def one(elements: str, end: str) -> str:
    """The first element."""
    return elements.split(end)[0] + end


FIELDS = [
    *(f"eq_{name}" for name in ("data", "solref", "solimp")),
    *(f"tendon_{name}" for name in ("range", "margin", "frictionloss", "invweight0", "length0")),
    *(f"tendon_{name}" for name in ("solref_lim", "solimp_lim", "solref_fri", "solimp_fri")),
    *("dof_invweight0", "qpos0"),
]


@pytest.mark.parametrize("many", [True, False])
def test_fields_may_differ_between_worlds(many: bool, rng: np.random.Generator) -> None:
    """With several rows of each kind, and with one."""
    tendon, equality = (FRICTION, EQUALITY + TENDONS) if many else (one(FRICTION, "/fixed>"), one(EQUALITY, "/>"))
    model = rowed(chain(4), tendon, equality)
    count = 40
    varied = {}
    for name in FIELDS:
        base = np.asarray(getattr(model, name), float)
        noise = 0.1 * rng.normal(size=(count, *base.shape)) if name == "qpos0" else 0.0
        varied[name] = base * rng.uniform(0.9, 1.1, (count, *base.shape)) + noise
    states = scattered(model, count, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, FIELDS)
        params = jax.tree.map(lambda x: x[0], stepper.pack({name: x[None] for name, x in varied.items()}))
        before = stepper.state(*columns(states, "qpos", "qvel"))
        after = jax.jit(stepper.step, compiler_options=QUICK)(params, before, jnp.zeros((0, count)))
        found = np.asarray(stepper.qacc(after))
    exact(model)
    for i, data in enumerate(states):
        for name, x in varied.items():
            getattr(model, name)[:] = x[i]
        mujoco.mj_forward(model, data)
    assert relative_error(found, columns(states, "qacc")[0]) < 1e-9


def test_masses_that_differ_change_the_weights_of_rows(rng: np.random.Generator) -> None:
    rods = chain(2).replace('name="p1"', 'name="p2"')
    model = exact(rowed(rods, one(LIMITS, "/fixed>"), '<tendon tendon1="a" polycoef="0.3"/>'))
    (data,) = scattered(model, 1, rng)
    start = np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    mujoco.mj_getState(model, data, start[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mass = model.body_mass * rng.uniform(0.3, 3, (3, model.nbody))
    with jax.enable_x64(True):
        found = lanes.rollout(model, start, steps=20, varying={"body_mass": mass})
    assert (found.engine == "lanes").all()
    for own, state in zip(mass, found.state, strict=True):
        model.body_mass[:] = own
        mujoco.mj_setConst(model, mujoco.MjData(model))
        mujoco.mj_setState(model, data, start[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        for _ in range(20):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(state[-1, 1 : 1 + model.nq], data.qpos, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["tendon_stiffness", "eq_active0", "wrap_prm"])
def test_other_fields_may_not_differ(name: str) -> None:
    with pytest.raises(UnsupportedModel, match=f"a field '{name}' that differs between worlds"):
        LanesStepper(rowed(chain(4), LIMITS, EQUALITY), [name])


@pytest.mark.parametrize("case", ["all", pytest.param("alike_legs", marks=pytest.mark.slow)])
def test_a_world_has_the_same_bits_beside_others(case: str, rng: np.random.Generator) -> None:
    model = CASES[case]()
    qpos, qvel = columns(scattered(model, 32, rng), "qpos", "qvel")
    stepper = LanesStepper(model)
    zero = jnp.zeros((model.nu, 32))

    def steps(q: jax.Array, v: jax.Array) -> jax.Array:
        state = jax.lax.fori_loop(0, 3, lambda _, s: stepper.step({}, s, zero), stepper.state(q, v))
        return stepper.qacc(state)

    run = jax.jit(steps)
    alone = np.asarray(run(qpos, qvel))
    order = rng.permutation(32)
    np.testing.assert_array_equal(np.asarray(run(qpos[:, order], qvel[:, order])), alone[:, order])
    others, fast = qpos.copy(), qvel.copy()
    others[:, 1:], fast[:, 1:] = qpos[:, [1]], 30 * qvel[:, [1]]
    np.testing.assert_array_equal(np.asarray(run(others, fast))[:, 0], alone[:, 0])
