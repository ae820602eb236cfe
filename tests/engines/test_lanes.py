"""The lanes engine against native MuJoCo, and its promises: bits, bad neighbours, refusals."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import (
    CASES,
    FAST,
    QUADRUPED_SERVOS,
    QUICK,
    SERVOS,
    biped,
    chain,
    mjcf,
    plain_box,
    quadruped,
    snake,
    tangle,
    tendons,
)

from btr_mjx.engines import LanesStepper, MjxStepper, UnsupportedModel
from btr_mjx.engines.base import MUJOCO_4
from btr_mjx.engines.lanes_engine.tree import HINGE
from btr_mjx.evaluation import evaluate
from btr_mjx.models import compile_models
from btr_mjx.robots import Robot, hexapod

STIFF_SERVOS = "".join(f'<position joint="p{i}" kp="30" kv="2"/>' for i in range(2))
WORLDS = 24


def random_state(model: mujoco.MjModel, rng: np.random.Generator, pressed: bool) -> mujoco.MjData:
    """A random state with small joint angles; a free root hovers, or is pressed into the ground."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + 0.2 * rng.normal(size=model.nq)
    data.qvel[:] = 2 * rng.normal(size=model.nv)
    data.ctrl[:] = rng.uniform(-0.5, 0.5, model.nu)
    data.act[:] = 0.1 * rng.normal(size=model.na)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        adr = model.jnt_qposadr[joint]
        quaternion = rng.normal(size=4) * (0.3 if rng.random() < 0.8 else 1) + [1, 0, 0, 0]
        data.qpos[adr + 3 : adr + 7] = quaternion / np.linalg.norm(quaternion)
        data.qpos[adr + 2] = 5
        mujoco.mj_kinematics(model, data)
        if pressed:
            touching = np.flatnonzero(
                (model.geom_conaffinity > 0) & (model.body_rootid[model.geom_bodyid] == model.jnt_bodyid[joint])
            )
            low = min(_lowest(model, data, geom) for geom in touching)
            data.qpos[adr + 2] -= low + rng.uniform(0.001, 0.03)
    return data


def _lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of a geom's lowest point over the floor."""
    axes, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    normal = data.geom_xmat[0].reshape(3, 3)[:, 2]
    reach = {
        mujoco.mjtGeom.mjGEOM_SPHERE: size[0],
        mujoco.mjtGeom.mjGEOM_CAPSULE: size[0] + size[1] * abs(normal @ axes[:, 2]),
        mujoco.mjtGeom.mjGEOM_BOX: float(np.abs(normal @ axes) @ size),
        mujoco.mjtGeom.mjGEOM_ELLIPSOID: float(np.linalg.norm((normal @ axes) * size)),
        mujoco.mjtGeom.mjGEOM_CYLINDER: float(
            size[1] * abs(normal @ axes[:, 2]) + size[0] * np.hypot(*(normal @ axes[:, :2]))
        ),
    }[mujoco.mjtGeom(model.geom_type[geom])]
    return float(normal @ (data.geom_xpos[geom] - data.geom_xpos[0]) - reach) / float(normal[2])


def native_step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """One step with a solver that runs until it cannot improve."""
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0.0
    mujoco.mj_step(model, data)


def compare(stepper: LanesStepper, models: list[mujoco.MjModel], params: dict, rng: np.random.Generator) -> int:
    """Step random states with both engines; returns the number of contacts that took part."""
    states = [random_state(model, rng, i % 4 > 0) for i, model in enumerate(models)]
    columns = [np.stack([getattr(d, name) for d in states], axis=1) for name in ("qpos", "qvel", "act", "ctrl")]
    qpos, qvel, act, ctrl = columns
    before = stepper.state(qpos, qvel, act)
    after = jax.jit(stepper.step, compiler_options=QUICK)(params, before, jnp.asarray(ctrl))
    acceleration, exact = np.asarray(stepper.qacc(after)), ~np.asarray(stepper.tripped(after))
    assert exact.mean() > 0.8
    for model, data in zip(models, states, strict=True):
        native_step(model, data)
    names = ("qacc_warmstart", "qvel", "qpos", "act")  # that of the last stage, where there are several
    expected = [np.stack([getattr(d, name) for d in states], axis=1) for name in names]
    got = [acceleration, stepper.qvel(after), stepper.qpos(after), stepper.act(after)]
    for name, x, y in zip(names, got, expected, strict=True):
        error = np.linalg.norm(np.asarray(x) - y, axis=0) / np.maximum(np.linalg.norm(y, axis=0), 1e-3)
        assert np.max(error[exact], initial=0) < 1e-10, (name, error)
    assert not np.asarray(stepper.capped(after)).any()
    power = [np.abs(d.actuator_force * d.actuator_velocity).sum() for d in states]
    np.testing.assert_allclose(np.asarray(stepper.power(after))[exact], np.array(power)[exact], rtol=1e-9)
    return sum(d.ncon for d in states)


@pytest.mark.parametrize("case", CASES)
def test_one_step_equals_native_mujoco(case: str, rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(CASES[case])
    with jax.enable_x64(True):
        touching = compare(LanesStepper(model, guards="tangle" in case), [model] * WORLDS, {}, rng)
    assert touching > 5 or "pendulum" in case or case == "stops"


@pytest.mark.parametrize("delay", ["", 'delay="0.03" nsample="5"'])
def test_a_damper_with_commands_beyond_its_range(delay: str, rng: np.random.Generator) -> None:
    """implicitfast derives its force, of the clamped and delayed command, by velocity."""
    body = '<body><joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body>'
    damper = f'<actuator><damper joint="hinge" kv="2" ctrlrange="0 1" {delay}/></actuator>'
    option = '<option timestep="0.01" integrator="implicitfast"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{body}</worldbody>{damper}</mujoco>")
    data = mujoco.MjData(model)
    data.qvel[:] = 1
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        state = stepper.state(data.qpos[:, None], data.qvel[:, None])
        for command in rng.uniform(-1, 2, 12):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            state = stepper.step({}, state, jnp.full((1, 1), command))
            np.testing.assert_allclose(np.asarray(stepper.qvel(state))[:, 0], data.qvel, rtol=1e-10)


def test_a_cylinder_that_stands_upright_touches_where_native_does(rng: np.random.Generator) -> None:
    """Its rim is parallel to the floor: no point is the lowest, and MuJoCo takes that along the cylinder's x axis."""
    body = '<body pos="0 0 0.195"><freejoint/><geom type="cylinder" size="0.1 0.2"/></body>'
    model = mujoco.MjModel.from_xml_string(mjcf(body))
    data = mujoco.MjData(model)
    data.qvel[:] = rng.normal(size=6)
    with jax.enable_x64(True):
        stepper = LanesStepper(model)
        state = stepper.state(data.qpos[:, None], data.qvel[:, None])
        after = jax.jit(stepper.step, compiler_options=QUICK)({}, state, jnp.zeros((0, 1)))
    native_step(model, data)
    assert data.ncon == 3  # the fourth point, at the other end, is far above the floor
    np.testing.assert_allclose(np.asarray(stepper.qacc(after))[:, 0], data.qacc, rtol=1e-9)


def test_one_step_of_the_hexapod_with_many_morphologies(robot: Robot, rng: np.random.Generator) -> None:
    models = compile_models(robot, robot.simulation_box.sample(rng, WORLDS))
    single = [mujoco.MjModel.from_xml_string(robot.render(s)) for s in robot.simulation_box.sample(rng, WORLDS)]
    leaves = {name: np.stack([np.asarray(_read(m, name), float) for m in single])[None] for name in models.leaves}
    with jax.enable_x64(True):
        stepper = LanesStepper(models.base, frozenset(leaves))
        params = jax.tree.map(lambda x: x[0], stepper.pack(leaves))
        assert [link.size for link in stepper.plan.links] == [1, 6, 6]
        assert compare(stepper, single, params, rng) > 10


def _read(model: mujoco.MjModel, name: str) -> np.ndarray:
    owner, _, field = name.rpartition(".")
    return getattr(getattr(model, owner) if owner else model, field)


def test_whole_trials_equal_native_mujoco(rng: np.random.Generator) -> None:
    """3400 steps of the hexapod in double precision."""
    robot = hexapod()
    pairs = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 3)
    with jax.enable_x64(True):
        fast, exact = (
            evaluate(robot, *pairs, pairwise=True, engine=engine, times=(0.5, 1.7), states=True).outcome
            for engine in ("lanes", "native")
        )
    np.testing.assert_allclose(fast.qpos, exact.qpos, rtol=0, atol=1e-9)
    assert np.linalg.norm(exact.position[:, 1] - exact.start, axis=-1).min() > 0.01


def test_every_field_may_differ_between_worlds(rng: np.random.Generator) -> None:
    text = mjcf(
        quadruped(),
        option=f'{FAST} density="20" viscosity="0.1" impratio="2" wind="1 0 2"',
        actuators=QUADRUPED_SERVOS.replace("/>", ' forcerange="-3 3" ctrlrange="-0.3 0.3"/>'),
    )
    text = text.replace("<joint name", '<joint frictionloss="0.1" stiffness="2" damping="0.1" armature="0.01" name')
    base = mujoco.MjModel.from_xml_string(text)
    models = [mujoco.MjModel.from_xml_string(text) for _ in range(WORLDS)]
    for model in models:
        model.geom_rbound[1:] *= 2
        for shortcut in (model.body_sameframe, model.geom_sameframe, model.body_simple, model.dof_simplenum):
            shortcut[:] = 0  # they hold for the unedited model only
        for name in FIELDS:
            values = _read(model, name)
            noise = 1 + 0.1 * rng.uniform(-1, 1, np.shape(values))
            if name in ("jnt_stiffness", "dof_frictionloss"):
                noise[: 1 if name == "jnt_stiffness" else 6] = 1
            if name.startswith("opt."):
                setattr(model.opt, name[4:], values * noise)
            else:
                values[:] = values * noise
        for units in (model.jnt_axis, model.body_quat, model.body_iquat, model.geom_quat):
            units[:] /= np.maximum(np.linalg.norm(units, axis=1, keepdims=True), 1e-9)
    leaves = {name: np.stack([np.array(_read(m, name), float) for m in models])[None] for name in FIELDS}
    with jax.enable_x64(True):
        stepper = LanesStepper(base, FIELDS)
        params = jax.tree.map(lambda x: x[0], stepper.pack(leaves))
        assert compare(stepper, models, params, rng) > 10


FIELDS = [
    f"{group}{field}"
    for group, fields in {
        "body_": "mass inertia ipos iquat pos quat invweight0",
        "geom_": "pos quat size friction solref solimp margin",
        "jnt_": "axis pos range stiffness solref solimp",
        "dof_": "damping armature frictionloss invweight0 solref solimp",
        "actuator_": "gainprm biasprm gear ctrlrange forcerange",
        "opt.": "gravity wind density viscosity impratio",
        "": "qpos0 qpos_spring",
    }.items()
    for field in fields.split()
]


def rollouts(stepper: LanesStepper, steps: int, **options):
    """Compiled (params (N, ...), qpos (N, nq, C), qvel, ctrl) -> final (qpos, qvel) of N chunks in turn."""

    def one(args):
        params, qpos, qvel, ctrl = args
        state = stepper.state(qpos, qvel)
        state = jax.lax.fori_loop(0, steps, lambda _, s: stepper.step(params, s, ctrl), state)
        return stepper.qpos(state), stepper.qvel(state)

    return jax.jit(lambda *args: jax.lax.map(one, args), compiler_options=options)


def test_bits_do_not_depend_on_lane_neighbours_or_chunk_and_bad_neighbours_do_no_harm(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(CASES["quadruped"])
    stepper = LanesStepper(model, ["body_mass"])
    run = rollouts(stepper, 40)
    probe = random_state(model, rng, pressed=True)

    def batch(places: set[tuple[int, int]], broken: bool) -> tuple[np.ndarray, ...]:
        columns = {"qpos": (2, model.nq, WORLDS), "qvel": (2, model.nv, WORLDS), "ctrl": (2, model.nu, WORLDS)}
        arrays = {name: np.zeros(shape, np.float32) for name, shape in columns.items()}
        mass = np.zeros((2, WORLDS, model.nbody))
        for n in range(2):
            for c in range(WORLDS):
                mine = (n, c) in places
                data = probe if mine else random_state(model, rng, pressed=True)
                for name, array in arrays.items():
                    array[n, :, c] = getattr(data, name)
                mass[n, c] = model.body_mass * (1 if mine else rng.uniform(0.8, 1.2))
                if broken and not mine:
                    arrays[("qvel", "qpos", "ctrl")[c % 3]][n, c % 3, c] = (np.nan, np.inf, 1e30)[(c // 3) % 3]
        params = stepper.pack({"body_mass": mass})
        qpos, qvel = run(params, arrays["qpos"], arrays["qvel"], arrays["ctrl"])
        return tuple(np.concatenate([np.asarray(qpos)[n, :, c], np.asarray(qvel)[n, :, c]]) for n, c in sorted(places))

    first = batch({(0, 0)}, broken=False)[0]
    assert np.isfinite(first).all()
    for broken in (False, True):
        for result in batch({(0, 3), (0, 23), (1, 7), (1, 16)}, broken):
            assert np.array_equal(result, first)


def test_momentum_is_conserved_in_flight(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(quadruped(), option='gravity="0 0 0"', actuators=QUADRUPED_SERVOS))
    model.opt.timestep = 1e-5
    states = [random_state(model, rng, pressed=False) for _ in range(4)]
    columns = [np.stack([getattr(d, name) for d in states], axis=1)[None] for name in ("qpos", "qvel", "ctrl")]
    with jax.enable_x64(True):
        qpos, qvel = rollouts(LanesStepper(model), 200, **QUICK)({}, *columns)
    for i, data in enumerate(states):
        momenta = []
        for q, v in ((data.qpos.copy(), data.qvel.copy()), (qpos[0, :, i], qvel[0, :, i])):
            data.qpos[:], data.qvel[:] = q, v
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
            momenta.append(np.concatenate([model.body_subtreemass[0] * data.subtree_linvel[0], data.subtree_angmom[0]]))
        assert np.linalg.norm(momenta[1] - momenta[0]) < 1e-4 * np.linalg.norm(momenta[0])


def test_energy_is_conserved_without_damping(rng: np.random.Generator) -> None:
    """Its error is the integrator's: of first order in the step, and the same as native MuJoCo's."""
    drifts: list[float] = []
    velocity = rng.normal(size=4)
    for dt in (2e-4, 1e-4):
        text = mjcf(chain(4), flags='energy="enable"').replace('timestep="0.002"', f'timestep="{dt}"')
        model = mujoco.MjModel.from_xml_string(text)
        model.dof_damping[:] = 0
        data = mujoco.MjData(model)
        start = data.qpos.copy(), velocity
        steps = round(0.2 / dt)
        with jax.enable_x64(True):
            columns = [x[None, :, None] for x in (*start, data.ctrl)]
            qpos, qvel = rollouts(LanesStepper(model), steps, **QUICK)({}, *columns)
        energies = []
        for data.qpos[:], data.qvel[:] in (start, (qpos[0, :, 0], qvel[0, :, 0])):
            mujoco.mj_forward(model, data)
            energies.append(data.energy.sum())
        drifts.append(abs(energies[1] - energies[0]) / max(abs(energies[0]), 1.0))
    assert drifts[0] < 1e-2
    assert 1.6 < drifts[0] / drifts[1] < 2.4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (mjcf(plain_box(), option='integrator="implicit"'), ["IMPLICIT", "integrator"]),
        (mjcf(chain(4), option='integrator="RK4"', actuators=SERVOS), ["RK4", "activations"]),
        (mjcf(plain_box() + plain_box().replace("0 0 1", "3 0 1").replace("<geom", '<geom contype="1"')), ["contact"]),
        (mjcf(tangle()), ["contact between bodies", "geom number"]),
        (mjcf(snake(40)), ["32 dofs", "46"]),
        (mjcf(plain_box() + '<geom name="step" type="box" size="1 1 1" contype="1"/>'), ["contact", "step"]),
        (mjcf(chain(1), actuators='<muscle name="biceps" joint="p0" lengthrange="0 1"/>'), ["MUSCLE", "biceps"]),
        (
            mjcf(
                chain(1)
                .replace("<body ", '<body gravcomp="1" ', 1)
                .replace('name="p0"', 'name="p0" actuatorgravcomp="true"')
            ),
            ["gravity compensation", "p0"],
        ),
        (tendons(mjcf(biped())).replace('name="all"', 'name="all" armature="0.1"'), ["tendon_armature", "all"]),
        pytest.param(
            tendons(mjcf(biped()), ("hip0.1", "hip0.1")),
            ["list a joint twice", "all"],
            marks=pytest.mark.skipif(MUJOCO_4, reason="MuJoCo 4.0 does not compile it"),
        ),
        (tendons(mjcf(biped(), option=FAST)), ["damping of tendons", "all"]),
    ],
)
def test_what_is_not_computed_is_refused_by_name(text: str, words: list[str]) -> None:
    with pytest.raises(UnsupportedModel) as caught:
        LanesStepper(mujoco.MjModel.from_xml_string(text))
    for word in [*words, 'engine="native"']:
        assert word in str(caught.value)


@pytest.mark.skipif(not MUJOCO_4, reason="MuJoCo has it from 4.0 on")
@pytest.mark.parametrize(
    ("text", "word"),
    [
        (mjcf(chain(2).replace('springref="0.2"', 'springref="0.2" springyield="0.1"')), "springyield"),
        (mjcf(plain_box(), flags="speculative='enable'"), "(?i)speculative"),
    ],
)
def test_what_is_new_in_mujoco_4_is_refused(text: str, word: str) -> None:
    model = mujoco.MjModel.from_xml_string(text)
    for stepper in (LanesStepper, MjxStepper):
        with pytest.raises(UnsupportedModel, match=word):
            stepper(model, frozenset())


def test_an_actuator_at_the_force_limit_of_its_joint() -> None:
    """Whether such an actuator damps implicit integration differs between versions of MuJoCo."""
    text = mjcf(chain(2).replace("<joint ", '<joint actuatorfrcrange="-1 1" '), option=FAST, actuators=STIFF_SERVOS)
    model = mujoco.MjModel.from_xml_string(text)
    with jax.enable_x64(True):
        compare(LanesStepper(model), [model] * WORLDS, {}, np.random.default_rng(4))


def test_wrong_fields_are_refused() -> None:
    model = mujoco.MjModel.from_xml_string(CASES["box_corners"])
    with pytest.raises(UnsupportedModel, match=r"opt\.timestep"):
        LanesStepper(model, ["opt.timestep"])
    stepper = LanesStepper(model, ["body_mass", "geom_rgba"])
    with pytest.raises(ValueError, match="expected those that vary"):
        stepper.pack({})
    with pytest.raises(ValueError, match="body_mass"):
        stepper.pack({"body_mass": np.ones((1, 4, 7))})


def test_structure_alike_subtrees_share_one_trace() -> None:
    sizes = lambda text: [link.size for link in LanesStepper(mujoco.MjModel.from_xml_string(text)).plan.links]  # noqa: E731
    assert sizes(CASES["quadruped"]) == [1, 4, 4]
    assert sizes(CASES["biped"]) == [1, 2, 2]
    assert sizes(CASES["two_balls"]) == [2]
    assert sizes(mjcf(snake(3))) == [1, 1, 1, 1]
    lopsided = biped().replace('name="hip0.1"', 'name="hip0.1" range="-10 10"')
    assert sizes(mjcf(lopsided)) == [1, 1, 1, 1, 1]


def test_masked_elements_of_a_field_stay_constants() -> None:
    model = mujoco.MjModel.from_xml_string(CASES["pendulum_euler"])
    mask = np.zeros(model.nv, bool)
    mask[2] = True
    stepper = LanesStepper(model, {"dof_damping": mask})
    params = stepper.pack({"dof_damping": np.full((1, WORLDS, model.nv), 0.5)})
    assert list(params) == ["2/joint0/damping"]
    assert stepper.plan.links[2].joints[0].kind == HINGE


def test_friction_of_a_free_joint_is_refused_when_worlds_bring_it() -> None:
    model = mujoco.MjModel.from_xml_string(CASES["box_corners"])
    stepper = LanesStepper(model, ["dof_frictionloss"])
    with pytest.raises(UnsupportedModel, match="free joint"):
        stepper.pack({"dof_frictionloss": np.ones((1, WORLDS, model.nv))})
