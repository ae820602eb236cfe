"""Effects against independent routes: compiled MJCF, other models of the same physics, plain loops of the equation."""

import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.commands import Command
from btr_mjx.gap.effects import EFFECTS, Candidate, Effect, Parameter, Scales, candidates, joint_places
from btr_mjx.gap.laws import Rows
from btr_mjx.gap.transcribe import normalised, write_changes
from btr_mjx.gap.worlds import Stretch, World, fields_of, simulate
from btr_mjx.robots import hexapod

PENDULUM = """
<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="servo" axis="0 1 0" damping="0.01" armature="0.002" frictionloss="0.01"
        range="-170 170" stiffness=".1"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.15" size="0.005" mass="0.02"/>
      <geom name="weight" type="sphere" pos="0 0 -0.15" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="servo" kp="5" dampratio="0.7" forcerange="-2 2"/></actuator>
</mujoco>
"""

QUADRUPED = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom friction="0.9" density="500"/><joint damping="0.2"/><position kp="60" kv="1.5"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="0.6"/>
    <body name="torso" pos="0 0 0.42">
      <freejoint/>
      <geom type="box" size="0.2 0.08 0.04"/>
      <body name="head" pos="0.25 0 0.02"><geom type="sphere" size="0.05"/></body>
      <body name="thigh0" pos="0.18 0.1 0">
        <joint name="hip0" axis="0 1 0"/>
        <geom type="box" size="0.02 0.02 0.1" pos="0 0 -0.1"/>
        <body name="shank0" pos="0 0 -0.2">
          <joint name="knee0" axis="0 1 0" range="-2 0.5" limited="true"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015"/>
          <geom name="foot0" type="sphere" pos="0 0 -0.2" size="0.02" friction="1.1" solref="0.01 1"/>
          <site name="tip" pos="0 0 -0.2"/>
        </body>
      </body>
      <body name="thigh1" pos="-0.18 0 0">
        <joint name="hip1" axis="0 1 0"/>
        <inertial pos="0.01 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.0004"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/>
        <body name="shank1" pos="0 0 -0.2">
          <joint name="knee1" axis="0 1 0"/>
          <geom name="foot1" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip0" joint="hip0"/><position name="knee0" joint="knee0" forcerange="-30 30"/>
    <motor name="hip1" joint="hip1" gear="5"/><position name="knee1" joint="knee1"/>
  </actuator>
</mujoco>
"""


def hexapod_xml(**lengths: float) -> str:
    robot = hexapod()
    values = dict(zip(robot.simulation_box.names, robot.nominal, strict=True)) | lengths
    return robot.render(list(values.values()))


MODELS = {"pendulum": PENDULUM, "quadruped": QUADRUPED, "hexapod": hexapod_xml()}


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODELS[name])


def one(model: mujoco.MjModel, name: str, effects: tuple[Effect, ...] = EFFECTS) -> Candidate:
    found = {c.name: c for c in candidates(model, Scales.of(model), effects)}
    return found[name]


def moderate(candidate: Candidate) -> np.ndarray:
    """Values a few steps away from the null, inside the bounds."""
    low, high, step = (np.array([getattr(p, a) for p in candidate.parameters]) for a in ("low", "high", "step"))
    return np.clip(candidate.null + 2.5 * step, low, high)


@pytest.mark.parametrize("name", MODELS)
def test_every_native_edit_is_what_the_compiler_makes_of_it(name: str) -> None:
    base = normalised(MODELS[name]).compile()
    original = load(name)
    assert set(fields_of(World.of(base), original)) <= {"actuator_acc0"} or _close(base, original)
    seen = set()
    for candidate in candidates(base, Scales.of(base), EFFECTS):
        if name == "hexapod" and (candidate.effect.name, len(candidate.place.members)) in seen:
            continue  # one place of a kind: each is compiled
        seen.add((candidate.effect.name, len(candidate.place.members)))
        world = candidate.apply(World.of(base), moderate(candidate))
        spec = normalised(MODELS[name])
        assert write_changes(spec, world, base) == [], candidate.name
        compiled = mujoco.MjModel.from_xml_string(_saved(spec))
        for field, ours in fields_of(World.of(compiled), world.model).items():
            if field.endswith("sameframe"):
                continue
            theirs = np.asarray(
                getattr(world.model, field) if "." not in field else getattr(world.model.opt, field[4:])
            )
            if field in ("body_inertia", "body_iquat"):
                continue  # the principal axes may come in another order
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-7, err_msg=f"{candidate.name}: {field}")
        for body in range(base.nbody):
            np.testing.assert_allclose(
                inertia(compiled, body), inertia(world.model, body), rtol=1e-4, atol=1e-7, err_msg=candidate.name
            )


def _saved(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return spec.to_xml()


def _close(a: mujoco.MjModel, b: mujoco.MjModel) -> bool:
    return all(
        np.allclose(value, getattr(b, field), rtol=1e-5, atol=1e-8)
        for field, value in fields_of(World.of(a), b).items()
    )


def inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    return turn @ np.diag(model.body_inertia[body]) @ turn.T


def test_every_effect_is_documented_and_has_a_place_on_a_walking_robot() -> None:
    table = (Path(__file__).parent.parent / "docs" / "effects.md").read_text(encoding="utf-8")
    assert [effect.name for effect in EFFECTS if f"| `{effect.name}` |" not in table] == []
    assert all(effect.equation and effect.excited_by and effect.apply.__doc__ for effect in EFFECTS)
    model = load("quadruped")
    found = {c.effect.name for c in candidates(model, Scales.of(model), EFFECTS)}
    assert found == {effect.name for effect in EFFECTS}
    assert len(found) >= 19


def test_places_make_sense() -> None:
    model = load("quadruped")
    labels: dict[str, list[str]] = {}
    for candidate in candidates(model, Scales.of(model), EFFECTS):
        labels.setdefault(candidate.effect.name, []).append(candidate.place.label)
    legs = ["subtree:thigh0", "subtree:thigh1"]
    assert labels["viscous_damping"] == ["joint:hip0", "joint:knee0", "joint:hip1", "joint:knee1", *legs, "all"]
    assert labels["actuator_delay"] == [f"actuator:{n}" for n in ("hip0", "knee0", "hip1", "knee1")] + [*legs, "all"]
    assert labels["backlash"] == ["joint:hip0", "joint:knee0", "joint:knee1", "subtree:thigh0", "all"]
    assert labels["payload"] == [f"body:{n}" for n in ("torso", "head", "thigh0", "shank0", "thigh1", "shank1")]
    assert labels["link_length"] == [f"body:{n}" for n in ("thigh0", "shank0", "thigh1", "shank1")]
    assert labels["constant_force"] == [f"body:{n}" for n in ("torso", "shank0", "shank1")]
    assert {"geom:foot0", "geom:foot1", "world"} <= set(labels["ground_friction"])
    pendulum = load("pendulum")
    names = {c.name for c in candidates(pendulum, Scales.of(pendulum), EFFECTS)}
    assert not {n for n in names if n.startswith(("ground_friction", "contact_softness", "com_shift"))}
    assert {"load_friction@joint:servo", "ground_slope@world", "link_length@body:arm", "payload@body:arm"} <= names
    assert not {n for n in names if n.endswith("@all")}


def windows(model: mujoco.MjModel, seed: int = 0, count: int = 4, length: float = 0.06) -> Stretch:
    rng = np.random.default_rng(seed)
    times = np.linspace(0, 1, 60)
    phase, speed = rng.uniform(0, 6, model.nu), rng.uniform(8, 20, model.nu)
    sent = Command(times, 0.4 * np.sin(np.outer(times, speed) + phase), "cubic")
    qpos = np.tile(model.qpos0, (count, 1))
    scalar = model.jnt_qposadr[model.jnt_type >= 2]
    qpos[:, scalar] += rng.uniform(-0.2, 0.2, (count, len(scalar)))
    qvel = rng.normal(size=(count, model.nv)) * (
        1.0 if model.jnt_type[0] else np.r_[np.zeros(6), np.ones(model.nv - 6)]
    )
    start = rng.uniform(0, 0.8, count)
    return Stretch(start, qpos, qvel, np.array([0.5 * length, length]), (sent,), np.zeros(count, int))


def loop(model: mujoco.MjModel, stretch: Stretch, row: int, act, steps: int) -> np.ndarray:
    """The equation by hand: act(model, data, command at mid-step) is called before every step."""
    model = copy.copy(model)
    data = mujoco.MjData(model)
    data.time, data.qpos[:], data.qvel[:] = stretch.start[row], stretch.qpos[row], stretch.qvel[row]
    for k in range(steps):
        t = stretch.start[row] + (k + 0.5) * model.opt.timestep
        data.ctrl[:] = stretch.commands[0].at(t)
        if k == 0:
            mujoco.mj_forward(model, data)
        act(model, data, t)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


def check_loop(model: mujoco.MjModel, candidate: Candidate, values: list[float], act) -> None:
    stretch = windows(model)
    states, plain = simulate([(candidate.apply(World.of(model), values), stretch), (World.of(model), stretch)])
    assert np.abs(states - plain).max() > 1e-4
    for row in range(len(stretch)):
        np.testing.assert_allclose(states[row, -1], loop(model, stretch, row, act, 60), rtol=0, atol=1e-7)


def test_load_friction_follows_the_motor_torque() -> None:
    model = load("quadruped")
    dof = model.joint("hip1").dofadr[0]

    def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        model.dof_frictionloss[dof] = 0.3 * abs(5.0 * data.actuator_force[2])

    check_loop(model, one(model, "load_friction@joint:hip1"), [0.3], act)


def test_stribeck_friction_fades_with_speed() -> None:
    model = load("pendulum")

    def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        model.dof_frictionloss[0] = 0.01 + 0.2 * np.exp(-((data.qvel[0] / 0.8) ** 2))

    check_loop(model, one(model, "stribeck_friction@joint:servo"), [0.2, 0.8], act)


def test_backlash_is_a_dead_zone_in_the_servo_error() -> None:
    model = load("quadruped")

    def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        error = data.ctrl[1] - data.joint("knee0").qpos[0]
        data.ctrl[1] = data.joint("knee0").qpos[0] + np.sign(error) * max(abs(error) - 0.05, 0.0)

    check_loop(model, one(model, "backlash@joint:knee0"), [0.05], act)


def test_delay_and_lag_shift_the_command() -> None:
    model = load("quadruped")
    sent = windows(model).commands[0]

    def late(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.ctrl[[2, 3]] = sent.at(t - 0.01)[[2, 3]]

    check_loop(model, one(model, "actuator_delay@subtree:thigh1"), [0.01], late)

    def smooth(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.ctrl[0] = sent.filtered(0.02).at(t)[0]

    check_loop(model, one(model, "actuator_lag@actuator:hip0"), [0.02], smooth)


def test_a_force_and_a_limit_act_on_their_bodies() -> None:
    model = load("quadruped")

    def push(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.xfrc_applied[model.body("torso").id, :3] = [20.0, -5.0, 10.0]

    check_loop(model, one(model, "constant_force@body:torso"), [20.0, -5.0, 10.0], push)

    def limit(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.ctrl[2] = np.clip(data.ctrl[2], -0.1, 0.1)  # a motor of gain 1

    check_loop(model, one(model, "torque_limit@actuator:hip1"), [0.1], limit)


def test_an_encoder_offset_is_seen_by_the_servo() -> None:
    model = load("quadruped")
    stretch = windows(model)
    world = one(model, "joint_offset@joint:knee0").apply(World.of(model), [0.07])
    shown = simulate([(world, stretch)])[0]
    address, dof = model.joint("knee0").qposadr[0], model.joint("knee0").dofadr[0]
    for row in range(len(stretch)):
        true = copy.deepcopy(stretch)
        true.qpos[row, address] -= 0.07

        def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
            data.ctrl[1] -= 0.07  # the servo's error is r - (q + offset)

        expected = loop(model, true, row, act, 60)
        expected[address] += 0.07
        np.testing.assert_allclose(shown[row, -1], expected, rtol=0, atol=1e-7)
    assert model.jnt_limited[model.joint("knee0").id]
    assert dof


def test_a_payload_is_a_heavy_point() -> None:
    heavy = '<geom type="sphere" pos="{}" size="1e-4" mass="1.5" contype="0" conaffinity="0"/>'
    base = load("quadruped")
    for body, values, where in (
        ("torso", [1.5, 0.1, 0.05, 0.08], "0.1 0.05 0.08"),
        ("shank0", [1.5, 0.15], "0 0 -0.15"),
        ("head", [1.5], "0 0 0"),
    ):
        start = f'<body name="{body}"'
        at = QUADRUPED.index(">", QUADRUPED.index(start)) + 1
        if body == "torso":
            at = QUADRUPED.index("<freejoint/>") + len("<freejoint/>")
        if body == "shank0":
            at = QUADRUPED.index("/>", at) + 2
        expected = mujoco.MjModel.from_xml_string(QUADRUPED[:at] + heavy.format(where) + QUADRUPED[at:])
        world = one(base, f"payload@body:{body}").apply(World.of(base), values)
        fields_of(world, base)
        b = base.body(body).id
        np.testing.assert_allclose(world.model.body_mass, expected.body_mass, rtol=1e-9)
        np.testing.assert_allclose(world.model.body_ipos, expected.body_ipos, atol=1e-9)
        np.testing.assert_allclose(inertia(world.model, b), inertia(expected, b), rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(world.model.dof_M0, expected.dof_M0, rtol=1e-4)


def test_a_longer_limb_is_the_limb_that_the_template_draws() -> None:
    base = load("hexapod")
    for body, geoms, name, change in (("b9", ["b9", "foot0"], "bl_9", 0.06), ("b3", ["b3", "knee0"], "bl_3", -0.05)):
        nominal = 1.36 if name == "bl_9" else 0.64
        expected = mujoco.MjModel.from_xml_string(hexapod_xml(**{name: nominal + change}))
        world = one(base, f"link_length@body:{body}").apply(World.of(base), [change])
        fields_of(world, base)
        b = base.body(body).id
        assert world.model.body_mass[b] == pytest.approx(expected.body_mass[b], rel=1e-5)
        np.testing.assert_allclose(world.model.body_ipos[b], expected.body_ipos[b], atol=1e-6)
        np.testing.assert_allclose(inertia(world.model, b), inertia(expected, b), rtol=1e-4, atol=1e-7)
        np.testing.assert_allclose(world.model.body_pos[2:], expected.body_pos[2:], atol=1e-6)
        for geom in geoms:
            g = base.geom(geom).id
            np.testing.assert_allclose(world.model.geom_pos[g], expected.geom_pos[g], atol=1e-6)
            np.testing.assert_allclose(world.model.geom_size[g], expected.geom_size[g], atol=1e-6)
            assert world.model.geom_rbound[g] == pytest.approx(expected.geom_rbound[g], rel=1e-6)
        assert world.model.geom_rbound[base.geom("b1").id] == base.geom_rbound[base.geom("b1").id]


def test_a_body_with_its_own_inertia_is_stretched() -> None:
    base = load("quadruped")
    world = one(base, "link_length@body:thigh1").apply(World.of(base), [0.02])
    b = base.body("thigh1").id
    tube = np.pi * 0.02**2 * 0.02
    whole = np.pi * 0.02**2 * 0.2 + 4 / 3 * np.pi * 0.02**3
    assert world.model.body_mass[b] == pytest.approx(0.4 * (1 + tube / whole))
    np.testing.assert_allclose(world.model.body_ipos[b], [0.01, 0, -0.11], atol=1e-9)
    assert world.model.body_pos[base.body("shank1").id][2] == pytest.approx(-0.22)


@pytest.mark.parametrize("place", ["world", "geom:foot0"])
def test_ground_friction_is_what_contacts_get(place: str) -> None:
    model = load("quadruped")
    candidate = one(model, f"ground_friction@{place}")
    believed = {"world": candidate.parameters[0].null, "geom:foot0": 1.1}[place]
    assert candidate.parameters[0].null == pytest.approx(believed)
    world = candidate.apply(World.of(model), [0.5 * believed])
    before, after = contacts(model), contacts(world.model)
    assert set(before) == set(after)
    for geom, (friction, solref, solimp, dim) in before.items():
        same = place != "world" and geom != "foot0"
        np.testing.assert_allclose(after[geom][0], friction * (1.0 if same else 0.5), rtol=1e-9)
        np.testing.assert_allclose(after[geom][1], solref, rtol=1e-9)
        np.testing.assert_allclose(after[geom][2], solimp, rtol=1e-9)
        assert after[geom][3] == dim


def contacts(model: mujoco.MjModel) -> dict[str, tuple]:
    data = mujoco.MjData(model)
    data.qpos[2] = 0.405
    mujoco.mj_forward(model, data)
    floor = model.geom("floor").id
    out = {}
    for contact in data.contact[: data.ncon]:
        if floor in contact.geom:
            other = model.geom(contact.geom[contact.geom != floor][0]).name
            out[other] = (contact.friction[0], contact.solref.copy(), contact.solimp.copy(), contact.dim)
    assert {"foot0", "foot1"} <= set(out)
    return out


def test_contact_softness_shifts_the_time_constant_of_contacts() -> None:
    model = load("quadruped")
    candidate = one(model, "contact_softness@world")
    null = candidate.parameters[0].null
    world = candidate.apply(World.of(model), [null + 0.01])
    for geom, (_, solref, _, _) in contacts(model).items():
        assert contacts(world.model)[geom][1][0] == pytest.approx(solref[0] + 0.01)


def test_a_slope_turns_gravity_as_a_tilted_floor_does() -> None:
    xml = """<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="5 5 1" friction="0.1" {floor}/>
      <body pos="0 0 0"><freejoint/><geom type="box" size="0.1 0.05 0.04" friction="0.1"/></body>
    </worldbody></mujoco>"""
    flat = mujoco.MjModel.from_xml_string(xml.format(floor=""))
    world = one(flat, "ground_slope@world").apply(World.of(flat), [0.3, -0.2])
    about_x, about_y, turn = np.zeros(4), np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(about_x, [1, 0, 0], 0.3)
    mujoco.mju_axisAngle2Quat(about_y, [0, 1, 0], -0.2)
    mujoco.mju_mulQuat(turn, about_y, about_x)
    tilted = mujoco.MjModel.from_xml_string(xml.format(floor=f'quat="{" ".join(map(str, turn))}"'))
    start = np.r_[0, 0, 0.05, 1, 0, 0, 0]
    stretch = Stretch(np.zeros(1), start[None], np.zeros((1, 6)), np.array([0.3]), (_no_command(),), np.zeros(1, int))
    ours = simulate([(world, stretch)])[0][0, 0]
    position, data = np.zeros(3), mujoco.MjData(tilted)
    mujoco.mju_rotVecQuat(position, start[:3], turn)
    data.qpos[:] = np.r_[position, turn]
    for _ in range(300):
        mujoco.mj_step(tilted, data)
    back = np.zeros(3)
    mujoco.mju_rotVecQuat(back, data.qpos[:3], turn * [1, -1, -1, -1])
    assert np.linalg.norm(ours[:2]) > 0.05
    np.testing.assert_allclose(ours[:3], back, atol=1e-6)


def _no_command() -> Command:
    return Command(np.zeros(1), np.zeros((1, 0)))


def test_air_drag_is_the_density_of_the_air() -> None:
    model = load("quadruped")
    world = one(model, "air_drag@world").apply(World.of(model), [30.0])
    dense = mujoco.MjModel.from_xml_string(QUADRUPED.replace('timestep="0.001"', 'timestep="0.001" density="30"'))
    stretch = windows(model)
    states, expected, plain = simulate([(world, stretch), (World.of(dense), stretch), (World.of(model), stretch)])
    np.testing.assert_allclose(states, expected, atol=1e-12)
    assert np.abs(states - plain).max() > 1e-5


def test_nothing_changes_at_the_null() -> None:
    for name in MODELS:
        model = load(name)
        for candidate in candidates(model, Scales.of(model), EFFECTS):
            world = candidate.apply(World.of(model), candidate.null)
            allowed = (
                {"actuator_forcerange", "actuator_forcelimited"} if candidate.effect.name == "torque_limit" else set()
            )
            for field, values in fields_of(world, model).items():
                if field in allowed | {"geom_priority", "geom_solref", "geom_solimp", "geom_friction", "geom_condim"}:
                    continue
                if field.endswith("sameframe") or field in ("body_iquat", "body_inertia"):
                    continue
                np.testing.assert_allclose(values, getattr(model, field), rtol=1e-7, atol=1e-9, err_msg=candidate.name)
            for body in range(model.nbody):
                np.testing.assert_allclose(inertia(world.model, body), inertia(model, body), rtol=1e-5, atol=1e-9)


def test_groups_are_their_members() -> None:
    model = load("quadruped")
    every = {c.name: c for c in candidates(model, Scales.of(model), EFFECTS)}
    for candidate in every.values():
        if not candidate.place.members:
            continue
        assert candidate.effect.summable
        together = candidate.apply(World.of(model), moderate(candidate))
        one_by_one = World.of(model)
        for member in candidate.place.members:
            every[f"{candidate.effect.name}@{member}"].apply(one_by_one, moderate(candidate))
        assert set(fields_of(together, model)) == set(fields_of(one_by_one, model))
        for field, values in fields_of(together, model).items():
            np.testing.assert_allclose(values, getattr(one_by_one.model, field), err_msg=candidate.name)
        stretch = windows(model, count=2)
        a, b = simulate([(together, stretch), (one_by_one, stretch)])
        np.testing.assert_allclose(a, b, atol=1e-9, err_msg=candidate.name)


def test_scales_of_data_are_those_of_the_data() -> None:
    model = load("quadruped")
    data, rows = mujoco.MjData(model), []
    for k in range(600):
        data.ctrl[:] = 0.3 * np.sin(0.012 * k + np.arange(4))
        mujoco.mj_step(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), np.abs(data.actuator_force).copy()))
    qpos, qvel, ctrl, force = (np.array(column) for column in zip(*rows, strict=True))
    scales = Scales.measured(model, qpos, qvel, ctrl)
    np.testing.assert_allclose(scales.force, np.percentile(force, 99.5, axis=0), rtol=0.3)
    np.testing.assert_allclose(scales.torque[8], 5 * scales.force[2])
    assert 0.02 < scales.time < 0.5
    floor, feet = model.geom("floor").id, [model.geom(n).id for n in ("foot0", "foot1")]
    assert scales.touching[feet].all()
    assert not scales.touching[floor]


class Gust:
    fields = ()

    def __init__(self, dofs: np.ndarray, size: float) -> None:
        self.dofs, self.size = dofs, size

    def __call__(self, rows: Rows) -> None:
        rows.qfrc_applied[:, self.dofs] -= self.size * (rows.qvel * np.abs(rows.qvel))[:, self.dofs]


def test_an_effect_of_ones_own() -> None:
    def ranges(model: mujoco.MjModel, scales: Scales, place: object) -> tuple[Parameter, ...]:
        return (Parameter("coefficient", "N m s^2", 0.0, 1.0, 0.01),)

    def edit(world: World, place, values: np.ndarray) -> None:
        world.model.dof_dampingpoly[place.dofs(world.model), 0] += values[0]

    def by_law(world: World, place, values: np.ndarray) -> None:
        world.laws.append(Gust(place.dofs(world.model), values[0]))

    native = Effect("quadratic_damping", joint_places, ranges, edit, summable=True)
    law = Effect("gust", joint_places, ranges, by_law, summable=True)
    model = load("quadruped")
    stretch = windows(model)
    effects = (*EFFECTS, native, law)
    worlds = [one(model, f"{n}@all", effects).apply(World.of(model), [0.001]) for n in ("quadratic_damping", "gust")]
    a, b, plain = simulate([*((world, stretch) for world in worlds), (World.of(model), stretch)])
    assert np.abs(a - plain).max() > 1e-3
    np.testing.assert_allclose(a, b, atol=0.05 * np.abs(a - plain).max())
    with pytest.raises(InputError, match="same name"):
        candidates(model, Scales.of(model), (native, native))
    with pytest.raises(InputError, match="values"):
        one(model, "gust@all", effects).apply(World.of(model), [0.1, 0.2])
    with pytest.raises(InputError, match="null"):
        Parameter("coefficient", "1", 1.0, 2.0, 0.1)
