"""Numerical stability of the believed model at its own time step.

A servo that is stiff relative to the inertia of its link needs a short time step, or an integrator that treats damping
implicitly. No diagnosis is possible with an unstable model. A servo at its force limit is integrated explicitly by
every integrator: with hardly any inertia its force jumps from one limit to the other, and the joint stands still.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording, listed
from btr_mjx.gap.effects import joint_of
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.simulate import Command, command_phase
from btr_mjx.models import difference, part_names

_SEGMENTS = 8
"""Segments that are simulated, spread evenly over the recordings."""

_SECONDS = 0.25
_STEPS = 500
"""Length of a segment [s], and its largest number of steps."""

_BAD = mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC


_JUMPS = 20
"""Steps in a row at which a force jumps from one limit to the other, from which on its servo chatters. Longest on the
field cases of `benchmarks/field_faults.py --check`: 2, and 60 to 124 on the arm whose joints lack an armature."""


def stability(dataset: Dataset) -> list[Finding]:
    """Simulate short segments from measured states with plain MuJoCo steps.

    One error if at least half of the segments become unstable, one warning if fewer do; a warning for each servo whose
    force jumps between its limits.
    """
    ends: list[tuple[Recording, float | None]] = []
    jumps = []
    for i in range(_SEGMENTS):
        which, share = divmod(i * len(dataset.recordings) / _SEGMENTS, 1.0)
        recording = dataset.recordings[int(which)]
        command = Command(*recording.commands, recording.interpolation)
        found = simulated_segment(recording, int(share * (len(recording.time) - 2)), command)
        ends.append((recording, found.unstable_at))
        jumps.append(found.jumps)
    return [*_unstable(dataset, ends), *_chattering(dataset, np.array(jumps))]


def _chattering(dataset: Dataset, jumps: np.ndarray) -> list[Finding]:
    """A warning that names the servos that chatter, given the jumps (segments, actuators) of their forces."""
    model, rows = dataset.model, []
    drives, joints = part_names(model, "actuator"), part_names(model, "joint")
    for actuator in np.flatnonzero((jumps >= _JUMPS).any(0)).tolist():
        if (joint := joint_of(model, actuator)) is not None:
            count, inertia = (jumps[:, actuator] >= _JUMPS).sum(), model.dof_M0[model.jnt_dofadr[joint]]
            rows.append(f"{drives[actuator]} (in {count} of {len(jumps)}, inertia {inertia:.2g} at {joints[joint]})")
    if not rows:
        return []
    remedy = "give the joint the armature of its drive"
    message = (
        f"{dataset.model_file.name}: in stretches simulated from measured states, the force jumps from one limit to "
        f"the other at every time step, and the joint does not follow its command: {listed(rows)}; its inertia is too "
        f"small for the damping of its servo; {remedy}"
    )
    return [Finding("warning", "stability", message, remedy)]


def _unstable(dataset: Dataset, ends: list[tuple[Recording, float | None]]) -> list[Finding]:
    """An error or a warning if segments become unstable, given the times at which they do."""
    bad = [(recording, time) for recording, time in ends if time is not None]
    if not bad:
        return []
    recording, time = bad[0]
    step = recording.model.opt.timestep
    text = (
        f"{dataset.model_file.name}: the believed model is unstable at its time step of {step:g} s: {len(bad)} of "
        f"{len(ends)} stretches simulated from measured states blow up, the first in {recording.name!r} at {time:.4g} s"
    )
    remedy = "choose a smaller timestep in <option>"
    if recording.model.opt.integrator in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4):
        remedy += ', or integrator="implicitfast"'
    return [Finding("error" if 2 * len(bad) >= len(ends) else "warning", "stability", f"{text}; {remedy}")]


@dataclass(frozen=True, eq=False)
class Segment:
    """A short simulation with plain MuJoCo steps.

    Attributes:
      unstable_at: time at which MuJoCo reports an invalid state or acceleration [s]; None if it never does.
      jumps: (actuators,) longest number of steps in a row at which a force jumps from one of its limits to the other.
    """

    unstable_at: float | None
    jumps: np.ndarray


def simulated_segment(recording: Recording, row: int, command: Command) -> Segment:
    """Simulate from the state of a row on."""
    model = copy.copy(recording.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data = mujoco.MjData(model)
    data.time = recording.time[row]
    data.qpos[:] = recording.qpos[row]
    slope = difference(model, recording.qpos[row], recording.qpos[row + 1]) / np.diff(recording.time[row : row + 2])
    data.qvel[:] = np.where(np.isfinite(recording.qvel[row]), recording.qvel[row], slope)
    step, phase = model.opt.timestep, command_phase(model)
    last = min(data.time + _SECONDS, recording.time[-1])
    side = np.zeros(len(model.actuator_forcelimited))
    current, longest = np.zeros_like(side, int), np.zeros_like(side, int)
    for _ in range(min(_STEPS, int((last - data.time) / step))):
        data.ctrl[:] = command.over_step(data.time, step, phase)
        mujoco.mj_step(model, data)
        if any(data.warning[int(kind)].number for kind in _BAD):
            return Segment(float(data.time), longest)
        before, side = side, _at_limit(model, data)
        current = np.where(side * before < 0, current + 1, 0)
        longest = np.maximum(longest, current)
    return Segment(None, longest)


def _at_limit(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(actuators,) 1 where a force is at its upper limit, -1 at its lower one, else 0."""
    low, high = model.actuator_forcerange.T
    return np.where(
        model.actuator_forcelimited, 1.0 * (data.actuator_force >= high) - (data.actuator_force <= low), 0.0
    )
