"""Effects against independent implementations: loops of their equations, other models of the same physics."""

import copy

import mujoco
import numpy as np
import pytest
from gap_models import QUADRUPED, check_loop, hexapod_xml, inertia, load, loop, one, windows

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.simulate import Command, Segments, World, differing_fields, simulate


def test_load_friction_is_proportional_to_motor_torque() -> None:
    model = load("quadruped")
    dof = model.joint("hip1").dofadr[0]

    def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        model.dof_frictionloss[dof] = 0.3 * abs(5.0 * data.actuator_force[2])

    check_loop(model, one(model, "load_friction@joint:hip1"), [0.3], act)


def test_stribeck_friction_decreases_with_speed() -> None:
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


def test_constant_force_and_torque_limit() -> None:
    model = load("quadruped")

    def push(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.xfrc_applied[model.body("torso").id, :3] = [20.0, -5.0, 10.0]

    check_loop(model, one(model, "constant_force@body:torso"), [20.0, -5.0, 10.0], push)

    def limit(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.ctrl[2] = np.clip(data.ctrl[2], -0.1, 0.1)  # a motor of gain 1

    check_loop(model, one(model, "torque_limit@actuator:hip1"), [0.1], limit)


LEG = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="thigh">
      <joint name="hip" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="1"/>
      <body name="calf" pos="0 0 -0.2">
        <joint name="knee" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="40" {limit}/><position name="knee" joint="knee" kp="30" gear="-2" {limit}/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("limit", "place", "values"),
    [
        ('forcerange="-3 3"', "all", [4.0]),
        ('forcerange="-3 3"', "each:all", [4.0, 2.0]),
        ('forcerange="-3 2"', "actuator:knee", [1.5]),
        ("", "all", [4.0, 3.0]),
        ("", "actuator:hip", [4.0, 3.0]),
    ],
)
def test_a_torque_speed_line_is_a_clipped_torque_written_every_step(
    limit: str, place: str, values: list[float]
) -> None:
    """Servos by hand: the force of every motor from position and command, then clipped between two lines."""
    model = mujoco.MjModel.from_xml_string(LEG.format(limit=limit))
    free = mujoco.MjModel.from_xml_string(LEG.format(limit="").replace("position", "motor").replace(" kp=", " user="))
    first = 0 if place != "actuator:knee" else 1
    last = 1 if place != "actuator:hip" else 0
    no_load = {a: values[min(a, len(values) - 1)] if place.startswith("each") else values[0] for a in (0, 1)}
    segments = windows(model)
    world = one(model, f"torque_speed@{place}", KNOWN_EFFECTS).apply(World.of(model), values)
    states, plain = simulate([(world, segments), (World.of(model), segments)])
    assert np.abs(states - plain).max() > 1e-2
    data = mujoco.MjData(free)
    for row in range(len(segments)):
        data.qpos[:], data.qvel[:] = segments.qpos[row], segments.qvel[row]
        for k in range(60):
            sent = segments.commands[0].at(segments.start[row] + k * 1e-3)
            for a, (gain, gear) in enumerate(((40.0, 1.0), (30.0, -2.0))):
                low, high = model.actuator_forcerange[a] if limit else (-np.inf, np.inf)
                if first <= a <= last:
                    low, high = (low, high) if limit else (-3.0, 3.0)
                    speed = np.sign(gear) * data.qvel[a] / no_load[a]
                    low, high = low * max(0.0, min(1.0, 1 + speed)), high * max(0.0, min(1.0, 1 - speed))
                data.ctrl[a] = min(max(gain * (sent[a] - gear * data.qpos[a]), low), high)
            mujoco.mj_step(free, data)
        np.testing.assert_allclose(states[row, -1], np.r_[data.qpos, data.qvel], rtol=0, atol=1e-8)


def test_similar_effects_follow_their_equations() -> None:
    model = load("quadruped")
    knee, torso = model.joint("knee0"), model.body("torso").id

    def hard(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.qfrc_applied[knee.dofadr[0]] = (
            -40.0 * (data.qpos[knee.qposadr[0]] - model.qpos_spring[knee.qposadr[0]]) ** 3
        )

    def one_sided(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        away = data.qpos[knee.qposadr[0]] - model.qpos_spring[knee.qposadr[0]]
        data.qfrc_applied[knee.dofadr[0]] = -8.0 * abs(away)

    def fading(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.ctrl[2] *= 1 - 0.5 * data.time  # a motor

    def cord(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
        data.xfrc_applied[torso, :3] = -300.0 * (data.qpos[:3] - model.qpos0[:3])

    for name, value, act in (
        ("hardening_spring@joint:knee0", 40.0, hard),
        ("one_sided_spring@joint:knee0", 8.0, one_sided),
        ("fading_motor@actuator:hip1", -0.5, fading),
        ("elastic_cord@body:torso", 300.0, cord),
    ):
        check_loop(model, one(model, name, KNOWN_EFFECTS), [value], act)


def test_encoder_offset_acts_on_servo() -> None:
    model = load("quadruped")
    segments = windows(model)
    world = one(model, "joint_offset@joint:knee0").apply(World.of(model), [0.07])
    shown = simulate([(world, segments)])[0]
    address, dof = model.joint("knee0").qposadr[0], model.joint("knee0").dofadr[0]
    for row in range(len(segments)):
        true = copy.deepcopy(segments)
        true.qpos[row, address] -= 0.07

        def act(model: mujoco.MjModel, data: mujoco.MjData, t: float) -> None:
            data.ctrl[1] -= 0.07  # the servo's error is r - (q + offset)

        expected = loop(model, true, row, act, 60)
        expected[address] += 0.07
        np.testing.assert_allclose(shown[row, -1], expected, rtol=0, atol=1e-7)
    assert model.jnt_limited[model.joint("knee0").id]
    assert dof


def test_payload_is_a_point_mass() -> None:
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
        differing_fields(world, base)
        b = base.body(body).id
        np.testing.assert_allclose(world.model.body_mass, expected.body_mass, rtol=1e-9)
        np.testing.assert_allclose(world.model.body_ipos, expected.body_ipos, atol=1e-9)
        np.testing.assert_allclose(inertia(world.model, b), inertia(expected, b), rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(world.model.dof_M0, expected.dof_M0, rtol=1e-4)


def test_a_welded_body_may_be_taken_off() -> None:
    base = load("quadruped")
    candidate = one(base, "payload@body:head")
    (mass,) = candidate.parameters
    head = '<body name="head" pos="0.25 0 0.02"><geom type="sphere" size="0.05"/></body>'
    expected = mujoco.MjModel.from_xml_string(QUADRUPED.replace(head, ""))
    segments = windows(base)
    world = candidate.apply(World.of(base), [mass.low])
    found, without, plain = simulate([(w, segments) for w in (world, World.of(expected), World.of(base))])
    assert mass.low == -base.body("head").mass[0]
    assert not mass.at_edge(mass.low)
    # A second mass of the same rigid body, free beside that of the first, would hide whether it is still there.
    assert mass.tolerance == 0 < one(base, "payload@body:torso").parameters[0].tolerance
    np.testing.assert_allclose(found, without, rtol=0, atol=1e-6)
    assert np.abs(found - plain).max() > 1e-3
    lighter = candidate.apply(World.of(base), [0.4 * mass.low]).model
    np.testing.assert_allclose(lighter.body("head").inertia, 0.6 * base.body("head").inertia, rtol=1e-9)


def test_link_length_equals_template_model() -> None:
    base = load("hexapod")
    for body, geoms, name, change in (("b9", ["b9", "foot0"], "bl_9", 0.06), ("b3", ["b3", "knee0"], "bl_3", -0.05)):
        nominal = 1.36 if name == "bl_9" else 0.64
        expected = mujoco.MjModel.from_xml_string(hexapod_xml(**{name: nominal + change}))
        world = one(base, f"link_length@body:{body}").apply(World.of(base), [change])
        differing_fields(world, base)
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


def test_explicit_inertia_is_stretched() -> None:
    base = load("quadruped")
    world = one(base, "link_length@body:thigh1").apply(World.of(base), [0.02])
    b = base.body("thigh1").id
    tube = np.pi * 0.02**2 * 0.02
    whole = np.pi * 0.02**2 * 0.2 + 4 / 3 * np.pi * 0.02**3
    assert world.model.body_mass[b] == pytest.approx(0.4 * (1 + tube / whole))
    np.testing.assert_allclose(world.model.body_ipos[b], [0.01, 0, -0.11], atol=1e-9)
    assert world.model.body_pos[base.body("shank1").id][2] == pytest.approx(-0.22)


@pytest.mark.parametrize("place", ["world", "geom:foot0"])
def test_ground_friction_equals_contact_friction(place: str) -> None:
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


def test_ground_slope_equals_tilted_floor() -> None:
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
    segments = Segments(np.zeros(1), start[None], np.zeros((1, 6)), np.array([0.3]), (_no_command(),), np.zeros(1, int))
    ours = simulate([(world, segments)])[0][0, 0]
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


def test_air_drag_sets_density() -> None:
    model = load("quadruped")
    world = one(model, "air_drag@world").apply(World.of(model), [30.0])
    dense = mujoco.MjModel.from_xml_string(QUADRUPED.replace('timestep="0.001"', 'timestep="0.001" density="30"'))
    segments = windows(model)
    states, expected, plain = simulate([(world, segments), (World.of(dense), segments), (World.of(model), segments)])
    np.testing.assert_allclose(states, expected, atol=1e-12)
    assert np.abs(states - plain).max() > 1e-5
