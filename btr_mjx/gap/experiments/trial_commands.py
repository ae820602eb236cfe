"""Candidate commands for the next experiment: random variations of the recorded commands."""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.simulate import Command

_MAX_DURATION = 2.0
"""Longest duration of a command [s]."""

_SPEED_FACTORS = 0.5, 4.0
"""Range of the factor on the speed of a recorded command."""

_AMPLITUDE_FACTORS = 0.3, 1.6
"""Range of the factor on its amplitude."""

_MAX_SPEED_RATIO = 2.0
"""Largest rate of change of a command, in units of the recorded command's."""


def random_commands(dataset: Dataset, rng: np.random.Generator, count: int) -> list[Command]:
    """Variations of the recorded commands in amplitude, speed and phase, channel by channel.

    They stay inside the actuators' control ranges, and within twice the recorded range. Faster commands have a smaller
    amplitude, so that no motor has to move much faster than in the recordings.

    Args:
      dataset: source of the recorded commands.
      rng: generator of the variations.
      count: number of commands.

    Returns:
      The commands, each (K, nu) over at most two seconds.
    """
    model = dataset.model
    out = []
    for _ in range(count):
        recording = dataset.recordings[int(rng.integers(len(dataset.recordings)))]
        time, ctrl = recording.time - recording.time[0], recording.ctrl
        duration = min(float(time[-1]), _MAX_DURATION)
        steps = max(2, int(duration / np.median(np.diff(time))))
        at = np.linspace(0.0, duration, steps)
        speed = float(np.exp(rng.uniform(*np.log(_SPEED_FACTORS))))
        centre = 0.5 * (ctrl.min(0) + ctrl.max(0))
        values = np.empty((steps, model.nu))
        for channel in range(model.nu):
            warped = np.abs((at * speed + rng.uniform(0, 0.2) * time[-1]) % (2 * time[-1]))
            warped = np.where(warped > time[-1], 2 * time[-1] - warped, warped)  # forwards, then backwards in time
            size = min(rng.uniform(*_AMPLITUDE_FACTORS), _MAX_SPEED_RATIO / speed)
            values[:, channel] = centre[channel] + size * (np.interp(warped, time, ctrl[:, channel]) - centre[channel])
        reach = np.ptp(ctrl, axis=0)
        low, high = ctrl.min(0) - 0.5 * reach, ctrl.max(0) + 0.5 * reach
        limited = _limited(model)
        low = np.where(limited, np.maximum(low, _range(model)[0]), low)
        high = np.where(limited, np.minimum(high, _range(model)[1]), high)
        out.append(Command(at, np.clip(values, low, high), recording.interpolation))
    return out


def _limited(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) bool: controls with a range of their own."""
    out = np.zeros(model.nu, bool)
    for actuator, first in enumerate(model.actuator_ctrladr):
        out[first] = bool(model.actuator_ctrllimited[actuator])
    return out


def _range(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Ranges of the controls (nu,), unlimited where they have none."""
    low, high = np.full(model.nu, -np.inf), np.full(model.nu, np.inf)
    for actuator, first in enumerate(model.actuator_ctrladr):
        if model.actuator_ctrllimited[actuator]:
            low[first], high[first] = model.actuator_ctrlrange[actuator]
    return low, high
