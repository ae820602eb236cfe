"""Preflight: faults of datasets are found before any fit; valid datasets give no errors or warnings."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hidden_cases import case_robot

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.preflight import Finding, preflight, refuse_errors
from btr_mjx.models import PathParameter, part_names

ROBOT = case_robot("arm")


def simulated(seed: int, still: bool = False) -> Recording:
    """The arm as believed, with noise, at 250 Hz."""
    rng, model = np.random.default_rng(seed), ROBOT.model
    data, motion = mujoco.MjData(model), ROBOT.draw_motion(rng)
    time = np.arange(0, 1.5, 0.004)
    ctrl = np.zeros((len(time), model.nu)) if still else motion(time)
    qpos, qvel = np.empty((2, len(time), model.nv))
    if still:
        data.qpos[:] = 0.1
    for k in range(len(time)):
        qpos[k], qvel[k] = data.qpos, data.qvel
        data.ctrl[:] = ctrl[k]
        if not still:
            mujoco.mj_step(model, data, 4)
    sigma = ROBOT.sigma(model)
    qpos += sigma[0] * rng.normal(size=qpos.shape)
    qvel += sigma[1] * rng.normal(size=qvel.shape)
    split = "test" if seed == 2 else "fit"
    return Recording(f"r{seed}", time, ctrl, qpos, qvel, np.ones(model.nv, bool), split, model)


SOUND = Dataset(Path("arm"), ROBOT.model, Path("arm.xml"), ROBOT.xml, (), tuple(simulated(i) for i in range(3)))


def changed(change: Callable[[Recording], Recording]) -> Dataset:
    return dataclasses.replace(SOUND, recordings=tuple(change(r) for r in SOUND.recordings))


def scaled(name: str, joint: int, factor: float) -> Callable[[Recording], Recording]:
    def change(recording: Recording) -> Recording:
        values = getattr(recording, name).copy()
        values[:, joint] *= factor
        return dataclasses.replace(recording, **{name: values})

    return change


def of_level(findings: list[Finding], level: str) -> list[str]:
    return [finding.message for finding in findings if finding.level == level]


def test_valid_data_give_no_errors_or_warnings() -> None:
    findings = preflight(SOUND)
    assert not of_level(findings, "error") + of_level(findings, "warning")
    refuse_errors(findings)
    assert any("250.0 samples per second" in message for message in of_level(findings, "note"))
    assert not any("ground_friction" in message for message in of_level(findings, "note"))
    assert not any("actuator_delay" in message for message in of_level(findings, "note"))


def test_notes_name_their_recordings_unless_these_are_all() -> None:
    notes = {one.name: ("of all", "of one") if one is SOUND.recordings[0] else ("of all",) for one in SOUND.recordings}
    found = of_level(preflight(changed(lambda one: dataclasses.replace(one, notes=notes[one.name]))), "note")
    assert [line for line in found if line.startswith("of ")] == ["of all", "of one (r0)"]


DEGREES = 180 / np.pi


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("qpos", 2, DEGREES), r"qpos/elbow looks like degrees"),
        (scaled("qvel", 2, DEGREES), r"qvel/elbow looks like degrees"),
        (scaled("ctrl", 2, DEGREES), r"ctrl/elbow looks like degrees"),
        (lambda r: scaled("qvel", 2, DEGREES)(scaled("qpos", 2, DEGREES)(r)), r"qpos/elbow looks like degrees"),
        (lambda r: dataclasses.replace(r, time=1000 * r.time), r"4 s apart, which looks like milliseconds"),
    ],
)
def test_wrong_units_are_errors(change: Callable[[Recording], Recording], message: str) -> None:
    findings = preflight(changed(change))
    with pytest.raises(InputError, match=message):
        refuse_errors(findings)


def test_degrees_of_short_recordings_are_detected_from_limits_and_turns() -> None:
    """Recordings that are too short for predictions."""

    def short(change: Callable[[Recording], Recording]) -> Dataset:
        cut = changed(lambda r: change(r).part(slice(100, 120), r.split, r.name))
        return dataclasses.replace(cut, recordings=cut.recordings[1:])

    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    model.jnt_limited[:], model.jnt_range[:] = 1, (-1.5, 1.5)
    data = dataclasses.replace(short(scaled("qpos", 2, 10 * DEGREES)), model=model)
    assert any("its limit in the model is 1.5 rad" in message for message in of_level(preflight(data), "error"))
    found = of_level(preflight(short(scaled("ctrl", 2, 10 * DEGREES))), "error")
    assert any("joint 'elbow' has a command that reaches" in message for message in found)


def test_velocities_wait_for_the_unit_of_positions() -> None:
    """Beside degrees, revolutions per minute look like revolutions per second."""

    def all_degrees(recording: Recording) -> Recording:
        cut = recording.part(slice(100, 160), recording.split, recording.name)
        rpm = cut.qvel * 60 / 2 / np.pi
        return dataclasses.replace(cut, qpos=10 * DEGREES * cut.qpos, qvel=10 * rpm, ctrl=10 * DEGREES * cut.ctrl)

    errors = of_level(preflight(changed(all_degrees)), "error")
    assert any("looks like degrees" in message for message in errors)
    assert not any("qvel" in message for message in errors)


def test_no_excitation_is_an_error() -> None:
    data = dataclasses.replace(SOUND, recordings=tuple(simulated(i, still=True) for i in range(3)))
    with pytest.raises(InputError, match="no excitation"):
        refuse_errors(preflight(data))


def test_gaps_and_constant_channels_are_warnings() -> None:
    def change(recording: Recording) -> Recording:
        time, ctrl, qpos = recording.time.copy(), recording.ctrl.copy(), recording.qpos.copy()
        time[100:] += 0.1
        ctrl[:, 0], qpos[:, 4] = 0.3, 0.0
        qpos[:, 1] = np.minimum(qpos[:, 1], np.percentile(qpos[:, 1], 70))
        return dataclasses.replace(recording, time=time, ctrl=ctrl, qpos=qpos)

    warnings = " | ".join(of_level(preflight(changed(change)), "warning"))
    assert "1 gaps of more than three intervals" in warnings
    assert "commands that never change: yaw" in warnings
    assert "position never changes; is the sensor connected?: roll" in warnings
    assert "qpos/shoulder stays at its extreme for" in warnings


def test_commands_after_responses_are_refused() -> None:
    """Commands logged late follow the response; a velocity that is another joint's does not fit its position."""

    def change(recording: Recording) -> Recording:
        late = np.stack([np.interp(recording.time - 0.12, recording.time, c) for c in recording.ctrl.T], 1)
        qvel = recording.qvel[:, [0, 1, 3, 3, 4]]
        return dataclasses.replace(recording, ctrl=late, qvel=qvel)

    findings = preflight(changed(change))
    (early,) = [finding for finding in findings if finding.level == "error"]
    assert early.message.startswith("positions come before their commands")
    assert early.evidence["shift"] == pytest.approx(-0.12, abs=8e-3)  # commands are held for a step of the log
    warnings = " | ".join(of_level(findings, "warning"))
    assert "qvel/elbow does not follow the slope" in warnings


def test_parameters_at_bounds_are_warnings() -> None:
    data = dataclasses.replace(SOUND, parameters=(PathParameter("elbow damping", ("joint:elbow/damping",), 0.3, 2.0),))
    assert any("'elbow damping' starts at its bound" in message for message in of_level(preflight(data), "warning"))


def test_single_frequency_does_not_excite_lag() -> None:
    def change(recording: Recording) -> Recording:
        sine = np.sin(20 * recording.time[:, None] + np.arange(5))
        return dataclasses.replace(recording, ctrl=sine)

    notes = " | ".join(of_level(preflight(changed(change)), "note"))
    assert "cannot show actuator_lag: every command is one sine" in notes


def with_unstable_servo(servo: int, share: float = 1.0) -> Dataset:
    """A dataset in which a servo is unstable with explicit steps, in a share of the recordings."""
    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.actuator_biasprm[servo, 2] = -1e4 * model.dof_M0[servo]
    some = round(share * len(SOUND.recordings))
    recordings = [dataclasses.replace(r, model=model) if i < some else r for i, r in enumerate(SOUND.recordings)]
    return dataclasses.replace(SOUND, recordings=tuple(recordings))


@pytest.mark.parametrize(("armature", "chatters"), [(0.0, True), (1.0, False)])
def test_a_servo_that_jumps_between_its_limits_is_told(armature: float, chatters: bool) -> None:
    """At its force limit MuJoCo integrates a servo's damping explicitly; with the inertia of a drive it is stable."""
    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    model.actuator_biasprm[4, 2] = -1e4 * model.dof_M0[4]
    model.actuator_forcelimited[4], model.actuator_forcerange[4] = 1, [-5, 5]
    model.dof_armature[4] += armature * 1e4 * model.dof_M0[4] * model.opt.timestep
    recordings = tuple(dataclasses.replace(r, model=model) for r in SOUND.recordings)
    warnings = of_level(preflight(dataclasses.replace(SOUND, model=model, recordings=recordings)), "warning")
    told = [one for one in warnings if "jumps from one limit to the other" in one]
    assert bool(told) == chatters
    assert all(part_names(model, "actuator")[4] in one for one in told)


def test_unstable_model_is_an_error() -> None:
    findings = preflight(with_unstable_servo(0))
    with pytest.raises(InputError, match=r"arm.xml: the believed model is unstable at its time step of .* integrator"):
        refuse_errors(findings)
    assert any("unstable" in text for text in of_level(preflight(with_unstable_servo(0, 1 / 3)), "warning"))
    assert not any("unstable" in finding.message for finding in preflight(SOUND))


def test_each_recording_has_a_rate_of_its_own() -> None:
    """A recording that is sampled more slowly than the others has no gaps."""
    slow = SOUND.recordings[0].part(slice(None, None, 5), "fit", "slow")
    findings = preflight(dataclasses.replace(SOUND, recordings=(slow, *SOUND.recordings[1:])))
    assert not of_level(findings, "warning") + of_level(findings, "error")
    assert any("50.0 to 250.0 samples per second" in message for message in of_level(findings, "note"))


@pytest.mark.parametrize(
    ("factor", "start", "words"),
    [
        (1e3, 0.0, "looks like milliseconds; the column time is in seconds: divide by 1e+03"),
        (1e6, 0.0, "looks like microseconds"),
        (1e9, 0.0, "looks like nanoseconds"),
        (1e9, 1.7e9, "looks like nanoseconds since 1970"),
    ],
)
def test_units_of_time_are_named(factor: float, start: float, words: str) -> None:
    """Of one recording among others in seconds."""
    first = SOUND.recordings[0]
    strange = dataclasses.replace(first, time=factor * (first.time + start))
    data = dataclasses.replace(SOUND, recordings=(strange, *SOUND.recordings[1:]))
    with pytest.raises(InputError, match=r"fix the data first: r0: time: samples are .* s apart, which") as caught:
        refuse_errors(preflight(data))
    assert words in str(caught.value)


def test_advice_is_not_what_the_model_has_already() -> None:
    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    model.opt.timestep = 0.5
    data = dataclasses.replace(SOUND, recordings=tuple(dataclasses.replace(r, model=model) for r in SOUND.recordings))
    for finding in preflight(data):
        assert "implicitfast" not in finding.message


def test_a_joint_that_hardly_moves_gets_no_advice_on_its_sign() -> None:
    """A gripper that creeps: the slope of its positions is noise, which its velocity does not follow."""
    rng = np.random.default_rng(5)

    def creeping(recording: Recording) -> Recording:
        qpos, qvel = recording.qpos.copy(), recording.qvel.copy()
        sigma = [values[2] for values in ROBOT.sigma(ROBOT.model)]
        qpos[:, 2] = np.linspace(0, 30 * sigma[0], len(qpos)) + sigma[0] * rng.normal(size=len(qpos))
        qvel[:, 2] = sigma[1] * rng.normal(size=len(qvel))
        return dataclasses.replace(recording, qpos=qpos, qvel=qvel)

    def about_sign(data: Dataset) -> bool:
        return any("opposite sign" in finding.message for finding in preflight(data))

    assert not about_sign(changed(creeping))
    assert about_sign(changed(scaled("qvel", 2, -1.0)))
