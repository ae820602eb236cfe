"""Checks of a dataset before any fit: units, channels, parameter bounds, excitation.

    findings = preflight(dataset)

Levels: "error" makes the data unusable (wrong units, no excitation), "warning" degrades results, "note" is
information (rates, delays, effects that these data cannot show).
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, Noise, base_unmeasured, counted, listed, noise_of
from btr_mjx.gap.preflight.balances import carried_weight, idle_drives
from btr_mjx.gap.preflight.conventions import position_conventions
from btr_mjx.gap.preflight.drive_strength import drive_strength
from btr_mjx.gap.preflight.excitation import NO_GROUND, JointTrack, joint_tracks, moves, unexcited_effects
from btr_mjx.gap.preflight.findings import DEGREES_REMEDY, Finding, Level
from btr_mjx.gap.preflight.imu import imu_conventions
from btr_mjx.gap.preflight.repeats import angle_jumps, held_commands, held_positions
from btr_mjx.gap.preflight.reported_torques import reported_torques
from btr_mjx.gap.preflight.stability import stability
from btr_mjx.gap.preflight.timing.choices import timed
from btr_mjx.gap.preflight.timing.drift import clock_drift
from btr_mjx.gap.preflight.timing.sampling import response_delays, sampling
from btr_mjx.gap.preflight.undecided import undecided_signs
from btr_mjx.gap.preflight.velocities import velocity_conventions
from btr_mjx.models import part_names

_FEW_VALUES = 20
"""Different positions of a joint below which its resolution is called coarse."""

_BETWEEN = {
    "hold": "the last one is held until the next",
    "linear": "a straight line from one to the next",
    "cubic": "a cubic spline through all",
}
_FAULTS_OF_DATA = ("convention", "units", "repeats", "wrap", "clocks")
"""Topics of errors that the data, rather than the robot, are to blame for."""


_NO_MOTION = (
    "the pose of the base was not measured, and its IMU and the feet contradict each other, so that its motion cannot "
    "be estimated: correct the units and axes of the IMU, or record the pose"
)


def preflight(dataset: Dataset, effects: Sequence[str] | None = None) -> list[Finding]:
    """Findings of `checked`."""
    return checked(dataset, effects)[1]


def checked(dataset: Dataset, effects: Sequence[str] | None = None) -> tuple[Dataset, list[Finding]]:
    """Run all checks.

    Args:
      dataset: the dataset.
      effects: names of the effects whose excitation is checked; None for all of `excitation.unexcited_effects`.

    Returns:
      The dataset as it is to be searched: with commands between samples, and a time step of its models, as short
      predictions choose them where nothing is said. And findings, errors first, then warnings, then notes.
    """
    noise = noise_of(dataset)
    joints = joint_tracks(dataset)
    findings = list[Finding]()
    for line in dataset.notes:
        odd = "unknown key" in line or "they are left out" in line or line.startswith("assumed")
        findings.append(Finding("warning" if odd else "note", "loading", line))
    for line in dict.fromkeys(note for recording in dataset.recordings for note in recording.notes):
        names = [r.name for r in dataset.recordings if line in r.notes]
        of = "" if len(names) == len(dataset.recordings) else f" ({listed(names)})"
        estimated = line.startswith("joints without an encoder")
        level: Level = "warning" if estimated else "note"
        findings.append(Finding(level, "loading", line + of))
    findings += sampling(dataset)
    findings += held_positions(dataset) + held_commands(dataset) + angle_jumps(dataset)
    imu = [] if any(finding.level == "error" for finding in findings) else imu_conventions(dataset)
    # Where an IMU stands in for a pose, all predictions start from what it says.
    findings += [finding for finding in imu if finding.level == "error"]
    findings += _conventions(dataset, joints, noise, findings)
    findings += _channels(dataset, joints, noise)
    findings += reported_torques(dataset)
    findings += _parameter_bounds(dataset)
    findings += _excitation(dataset, joints, effects)
    if all(finding.level != "error" for finding in findings):
        findings += imu
        findings += [Finding("error", "base", _NO_MOTION)] if any(map(base_unmeasured, dataset.recordings)) else []
    if all(finding.level != "error" for finding in findings):
        findings += undecided_signs(dataset, noise) + drive_strength(dataset, noise)
        findings += carried_weight(dataset) + idle_drives(dataset, noise) + stability(dataset)
    if all(finding.level != "error" for finding in findings):
        dataset, found = timed(dataset, noise)
        delays = response_delays(dataset, joints)
        late = any(finding.topic == "clocks" for finding in found)
        findings += found + [finding for finding in delays if not late or finding.level == "note"]
    if all(finding.level != "error" for finding in findings):
        findings += clock_drift(dataset, noise)
    findings = [Finding("note", "data", line) for line in _summary(dataset)] + findings
    order = {"error": 0, "warning": 1, "note": 2}
    return dataset, sorted(findings, key=lambda finding: order[finding.level])


def refuse_errors(findings: Sequence[Finding]) -> None:
    """Raise if the dataset is unusable.

    Raises:
      InputError: with the message of the first error.
    """
    errors = [finding for finding in findings if finding.level == "error"]
    if errors:
        first = errors[0]
        start = "fix the data first: " if first.topic in _FAULTS_OF_DATA else ""
        more = f" (and {len(errors) - 1} more errors: --check lists them)" if len(errors) > 1 else ""
        raise InputError(f"{start}{first.message}{more}", lines=first.lines)


def _summary(dataset: Dataset) -> list[str]:
    model, times = dataset.model, [r.time for r in dataset.recordings]
    seconds = sum(float(t[-1] - t[0]) for t in times)
    between = []
    for kind in sorted({r.interpolation for r in dataset.recordings}):
        names = list(dict.fromkeys(r.log or r.name for r in dataset.recordings if r.interpolation == kind))
        of = "" if len({r.interpolation for r in dataset.recordings}) == 1 else f" of {listed(names)}"
        said = f'{_BETWEEN[kind]} ("{kind}"; interpolation in [control] of dataset.toml changes it)'
        between.append(f"commands{of} between samples: {said}")
    return [
        f"{counted(len(dataset.fit), 'recording')} to fit and {len(dataset.test)} held out, {seconds:.1f} s, "
        f"{sum(map(len, times))} samples of {counted(model.njnt, 'joint')} and {counted(model.nu, 'command')}",
        "held out: " + listed([r.name for r in dataset.test]),
        *(between if model.nu else []),
    ]


def _conventions(
    dataset: Dataset, joints: Sequence[JointTrack], noise: Noise, before: Sequence[Finding]
) -> list[Finding]:
    """Signs, units, order and frames; only in data whose time and rows are sound."""
    if any(finding.level == "error" for finding in before):
        return []
    found = position_conventions(dataset, noise)
    # Velocities are compared with the slopes of positions, whose units decide what theirs look like.
    for check in (lambda: _units(joints), lambda: velocity_conventions(dataset, noise)):
        found += [] if any(finding.level == "error" for finding in found) else check()
    return found


def _units(joints: Sequence[JointTrack]) -> list[Finding]:
    findings: list[Finding] = []
    for joint in joints:
        if not joint.hinge:
            continue
        peak = float(np.percentile(np.abs(joint.qpos), 98))
        limit = np.inf if joint.limits is None else float(np.abs(joint.limits).max())
        if peak > 5 * limit + 1:
            text = f"reaches {peak:.4g}, its limit in the model is {limit:.4g} rad"
        elif joint.servo and peak > 15:
            text = f"reaches {peak:.4g}, more than two turns of a position servo"
        elif joint.servo and np.ptp(joint.ctrl) > 30 * max(np.ptp(joint.qpos), 1e-9) and np.abs(joint.ctrl).max() > 6:
            most = np.abs(joint.ctrl).max()
            text = f"has a command that reaches {most:.4g} while it moves by {np.ptp(joint.qpos):.3g}"
        else:
            continue
        message = f"joint {joint.name!r} {text}; this looks like degrees; {DEGREES_REMEDY}"
        findings.append(Finding("error", "units", message))
    return findings


def _channels(dataset: Dataset, joints: Sequence[JointTrack], noise: Noise) -> list[Finding]:
    model, actuators = dataset.model, part_names(dataset.model, "actuator")
    ctrl = np.concatenate([r.ctrl for r in dataset.recordings])
    still = [name for name, column in zip(actuators, ctrl.T, strict=False) if np.ptp(column) == 0]
    frozen = [j.name for j in joints if np.ptp(j.qpos) == 0]
    sigma = dict(zip(part_names(model, "joint"), noise.qpos[model.jnt_dofadr], strict=True))
    quiet = [j.name for j in joints if 0 < np.ptp(j.qpos) < 8 * sigma[j.name]]
    findings = []
    if len(still) == len(actuators) and len(frozen) + len(quiet) == len(joints) and not moves(dataset):
        message = "no excitation: every command is constant and no joint moves beyond its noise; record motions"
        findings.append(Finding("error", "excitation", message))
    odd = [
        f"{text}: {listed(names)}"
        for names, text in (
            (still, "commands that never change"),
            (frozen, "joints whose position never changes; is the sensor connected?"),
            (quiet, "joints that move no further than their noise"),
        )
        if names
    ]
    for joint in joints:
        values, counts = np.unique(joint.qpos, return_counts=True)
        stuck = max(counts[0], counts[-1]) / len(joint.qpos)
        if stuck > 0.05 and len(values) > _FEW_VALUES:
            odd.append(f"qpos/{joint.name} stays at its extreme for {stuck:.0%} of the samples")
        if 1 < len(values) <= _FEW_VALUES:
            apart = float(np.median(np.diff(values)))
            odd.append(
                f"qpos/{joint.name} takes only {len(values)} different values, {apart:.3g} apart: its "
                "resolution is coarse beside its motion; velocities and friction are hard to see"
            )
    for name, column, limited, (low, high) in zip(
        actuators, ctrl.T, model.actuator_ctrllimited, model.actuator_ctrlrange, strict=False
    ):
        beyond = float(np.mean((column <= low) | (column >= high)))
        if limited and beyond > 0.02:
            odd.append(f"ctrl/{name} is at or beyond its ctrlrange in {beyond:.0%} of the samples")
    return findings + [Finding("warning", "channels", message) for message in odd]


def _parameter_bounds(dataset: Dataset) -> list[Finding]:
    findings = []
    for believed in dataset.parameters:
        value, room = believed.value(dataset.model), 0.01 * (believed.high - believed.low)
        if not believed.low + room <= value <= believed.high - room:
            bounds = f"{value:.6g} of [{believed.low}, {believed.high}]"
            message = f"parameter {believed.name!r} starts at its bound: {bounds}"
            findings.append(Finding("warning", "parameters", message))
    return findings


def _excitation(dataset: Dataset, joints: Sequence[JointTrack], effects: Sequence[str] | None) -> list[Finding]:
    """A note for each effect that these data do not excite, though the model could have it."""
    return [
        Finding("note", "excitation", f"these data cannot show {name}: {reason}")
        for name, reason in unexcited_effects(dataset, joints).items()
        if reason not in ("", NO_GROUND) and (effects is None or name in effects)
    ]
