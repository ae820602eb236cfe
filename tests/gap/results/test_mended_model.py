"""MendedModel models against the worlds in which their effects were found."""

import json

import mujoco
import numpy as np
import pytest
from gap_models import PENDULUM, QUADRUPED, load, moderate, windows

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import KNOWN_EFFECTS, Candidate, Scales, candidates
from btr_mjx.gap.results import Callback, FoundEffect, MendedModel, mend
from btr_mjx.gap.simulate import Segments, World, simulate

TEXTS = {"pendulum": PENDULUM, "quadruped": QUADRUPED}


def found(candidate: Candidate, values: np.ndarray) -> FoundEffect:
    names = [parameter.name for parameter in candidate.parameters]
    return FoundEffect(candidate.effect.name, candidate.place.label, dict(zip(names, values.tolist(), strict=True)))


def by_hand(mended: MendedModel, segments: Segments, row: int, steps: int) -> np.ndarray:
    """Plain MuJoCo on the mended MJCF, with the callback for terms without MJCF."""
    model = mujoco.MjModel.from_xml_string(mended.xml)
    data = mujoco.MjData(model)
    missing = Callback(model, json.loads(json.dumps(mended.terms)))
    sent = segments.commands[0]
    step = model.opt.timestep
    late = model.actuator_delay.max(initial=0.0)
    # Delays and filters depend on past commands: simulate them, then set the state at the start of the window.
    past = round((0.3 if mended.xml.count("filterexact") or mended.terms or late else 0) / step)
    data.time = segments.start[row] - past * step
    for k in range(-past, steps):
        if k == 0:
            data.qpos[:], data.qvel[:] = segments.qpos[row], segments.qvel[row]
            data.qacc_warmstart[:] = 0
            mujoco.mj_forward(model, data)
        data.ctrl[:] = sent.at(segments.start[row] + k * step)
        missing(model, data)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


@pytest.mark.parametrize("name", TEXTS)
def test_the_mended_model_moves_as_the_world_in_which_it_was_found(name: str) -> None:
    model = load(name)
    segments = windows(model, count=2)
    every = [c for c in candidates(model, Scales.of(model), KNOWN_EFFECTS) if not c.place.members]
    chosen = list({c.effect.name: c for c in every}.values())
    values = {c.name: moderate(c) for c in chosen}
    results = simulate(
        [*((c.apply(World.of(model), values[c.name]), segments) for c in chosen), (World.of(model), segments)]
    )
    for candidate, states in zip(chosen, results[:-1], strict=True):
        mended = mend(TEXTS[name], [found(candidate, values[candidate.name])])
        assert not mended.notes
        assert len(mended.terms) + len(mended.native) == 1
        size = np.abs(states - results[-1])[:, -1].max()
        for row in range(2):
            error = np.abs(by_hand(mended, segments, row, 60) - states[row, -1]).max()
            # MuJoCo's filter acts on the state at the start of a step, the world's in its middle.
            share = 0.1 if candidate.effect.name == "actuator_lag" else 0.03
            assert error < share * size + 2e-4, candidate.name


def test_which_terms_are_native() -> None:
    model = load("quadruped")
    by_name = {c.name: c for c in candidates(model, Scales.of(model), KNOWN_EFFECTS)}
    for label in ("actuator_delay@all", "actuator_lag@all", "viscous_damping@all", "torque_limit@all"):
        mended = mend(QUADRUPED, [found(by_name[label], moderate(by_name[label]))])
        assert mended.native == (label,)
        assert not mended.terms
    for label in ("load_friction@all", "backlash@all", "stribeck_friction@joint:hip0", "constant_force@body:torso"):
        mended = mend(QUADRUPED, [found(by_name[label], moderate(by_name[label]))])
        assert [f"{t['effect']}@{t['location']}" for t in mended.terms] == [label]
        assert mended.terms[0]["equation"]


def test_two_effects_and_refitted_parameters_in_one_file() -> None:
    mended = mend(
        QUADRUPED,
        [
            FoundEffect("viscous_damping", "joint:knee0", {"damping": 0.5}),
            FoundEffect("load_friction", "joint:hip0", {"coefficient": 0.2}),
            FoundEffect("payload", "body:torso", {"mass": 1.0, "x": 0.1, "y": 0.0, "z": 0.05}),
        ],
        believed={"joint:knee1/damping": 0.3, "geom:foot0/friction": 1.3},
    )
    model, base = mujoco.MjModel.from_xml_string(mended.xml), load("quadruped")
    assert model.dof_damping[model.joint("knee0").dofadr[0]] == pytest.approx(0.7)
    assert model.dof_damping[model.joint("knee1").dofadr[0]] == pytest.approx(0.3)
    assert model.geom("foot0").friction[0] == pytest.approx(1.3)
    assert model.body("torso").mass[0] == pytest.approx(base.body("torso").mass[0] + 1.0, rel=1e-5)
    assert [term["effect"] for term in mended.as_json()["terms"]] == ["load_friction"]


def test_a_callback_reverts_its_changes() -> None:
    model = load("quadruped")
    terms = [
        {"effect": "constant_force", "location": "body:torso", "parameters": {"x": 1.0, "y": 2.0, "z": 3.0}},
        {"effect": "load_friction", "location": "all", "parameters": {"coefficient": {"value": 0.2, "low": 0.1}}},
    ]
    missing, data = Callback(model, terms), mujoco.MjData(model)
    data.xfrc_applied[1, 0] = 5.0
    for _ in range(5):
        data.ctrl[:] = 0.3
        missing(model, data)
        np.testing.assert_allclose(data.xfrc_applied[1, :3], [6.0, 2.0, 3.0])
        dofs = model.jnt_dofadr[1:]
        np.testing.assert_allclose(model.dof_frictionloss[dofs], 0.2 * np.abs(data.qfrc_actuator[dofs]))
        mujoco.mj_step(model, data)


def test_a_control_callback_of_mujoco() -> None:
    model = load("quadruped")
    missing = Callback(model, [{"effect": "backlash", "location": "joint:hip0", "parameters": {"play": 0.05}}])
    data = mujoco.MjData(model)

    def control(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.ctrl[:] = 0.3
        missing(model, data)

    mujoco.set_mjcb_control(control)
    try:
        mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_control(None)
    assert data.actuator_force[0] == pytest.approx(60 * (0.3 - 0.05), rel=0.05)


def test_unknown_effects_places_and_parameters_are_named_in_the_error() -> None:
    with pytest.raises(InputError, match="viscous_damping"):
        mend(PENDULUM, [FoundEffect("viscous_dampin", "joint:servo", {"damping": 1.0})])
    with pytest.raises(InputError, match="joint:servo"):
        mend(PENDULUM, [FoundEffect("viscous_damping", "joint:sevro", {"damping": 1.0})])
    with pytest.raises(InputError, match="damping"):
        mend(PENDULUM, [FoundEffect("viscous_damping", "joint:servo", {"d": 1.0})])


def test_a_body_of_simple_inertia_gets_a_payload() -> None:
    """MuJoCo takes a short cut for such bodies, which the search does not."""
    body = '<body name="a"><joint type="slide" axis="1 0 0"/><geom size="0.1"/></body>'
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    before = mujoco.MjModel.from_xml_string(xml)
    assert before.body_simple[1]
    found = FoundEffect("payload", "body:a", {"mass": 0.4, "x": 0.0, "y": 0.0, "z": 0.0})
    after = mujoco.MjModel.from_xml_string(mend(xml, [found]).xml)
    assert after.body_mass[1] == pytest.approx(before.body_mass[1] + 0.4)


@pytest.mark.parametrize("mass", np.linspace(0.1, 0.2, 20))
def test_moments_of_a_flat_body_are_physical_after_rounding(mass: float) -> None:
    """The largest moment of a flat body is the sum of the others, and MuJoCo refuses one that is larger."""
    inertial = '<inertial pos="0 0 0" mass="0.3" diaginertia="0.00123457 0.00234566 0.00358023"/>'
    xml = f'<mujoco><worldbody><body name="a"><joint/>{inertial}</body></worldbody></mujoco>'
    for own in (mass, -mass):  # a rod is left where more inertia is taken than there is
        found = FoundEffect("payload", "body:a", {"mass": own, "x": 0.31 * mass, "y": mass, "z": 0.0})
        mujoco.MjModel.from_xml_string(mend(xml, [found]).xml)


def test_a_finer_time_step_is_written() -> None:
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    finer = model.opt.timestep / 4
    mended = mend(PENDULUM, [], believed={"option/timestep": finer})
    assert mujoco.MjModel.from_xml_string(mended.xml).opt.timestep == pytest.approx(finer)
    assert mujoco.MjModel.from_xml_string(mend(PENDULUM, []).xml).opt.timestep == model.opt.timestep
