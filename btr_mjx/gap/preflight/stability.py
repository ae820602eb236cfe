"""Numerical stability of the believed model at its own time step.

A servo that is stiff relative to the inertia of its link needs a short time step, or an integrator that treats damping
implicitly. No diagnosis is possible with an unstable model.
"""

import copy

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.simulate import Command, command_phase
from btr_mjx.models import difference

_SEGMENTS = 8
"""Segments that are simulated, spread evenly over the recordings."""

_SECONDS = 0.25
_STEPS = 500
"""Length of a segment [s], and its largest number of steps."""

_BAD = mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC


def stability(dataset: Dataset) -> list[Finding]:
    """Simulate short segments from measured states with plain MuJoCo steps.

    One error if at least half of the segments become unstable, one warning if fewer do.
    """
    ends: list[tuple[Recording, float | None]] = []
    for i in range(_SEGMENTS):
        which, share = divmod(i * len(dataset.recordings) / _SEGMENTS, 1.0)
        recording = dataset.recordings[int(which)]
        command = Command(*recording.commands, recording.interpolation)
        ends.append((recording, instability_time(recording, int(share * (len(recording.time) - 2)), command)))
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


def instability_time(recording: Recording, row: int, command: Command) -> float | None:
    """Time [s] at which MuJoCo reports an invalid state or acceleration, from the state of a row on; None if never."""
    model = copy.copy(recording.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data = mujoco.MjData(model)
    data.time = recording.time[row]
    data.qpos[:] = recording.qpos[row]
    slope = difference(model, recording.qpos[row], recording.qpos[row + 1]) / np.diff(recording.time[row : row + 2])
    data.qvel[:] = np.where(np.isfinite(recording.qvel[row]), recording.qvel[row], slope)
    step, phase = model.opt.timestep, command_phase(model)
    last = min(data.time + _SECONDS, recording.time[-1])
    for _ in range(min(_STEPS, int((last - data.time) / step))):
        data.ctrl[:] = command.over_step(data.time, step, phase)
        mujoco.mj_step(model, data)
        if any(data.warning[int(kind)].number for kind in _BAD):
            return float(data.time)
    return None
