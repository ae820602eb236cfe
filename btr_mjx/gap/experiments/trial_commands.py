"""Commands that could be tried next: variations of those that were recorded."""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.simulate import Command

_DURATION = 2.0
"""Longest command that is tried [s]."""

_SPEEDS = 0.5, 4.0
"""Factors on the speed of a recorded command."""

_SIZES = 0.3, 1.6
"""Factors on its excursion."""

_BRISK = 2.0
"""A command may change so many times as fast as the recorded one, at most."""


def random_commands(dataset: Dataset, rng: np.random.Generator, count: int) -> list[Command]:
    """Variations of the recorded commands: other amplitudes, faster or slower, other channels in step.

    They stay inside the actuators' control ranges, and within twice the recorded range where there is none; what is
    commanded faster is commanded smaller, so that no motor has to move much faster than it did.

    Args:
      dataset: what commands look like.
      rng: for the variations.
      count: commands to make.
    """
    model = dataset.model
    out = []
    for _ in range(count):
        recording = dataset.recordings[int(rng.integers(len(dataset.recordings)))]
        time, ctrl = recording.time - recording.time[0], recording.ctrl
        duration = min(float(time[-1]), _DURATION)
        steps = max(2, int(duration / np.median(np.diff(time))))
        at = np.linspace(0.0, duration, steps)
        speed = float(np.exp(rng.uniform(*np.log(_SPEEDS))))
        centre = 0.5 * (ctrl.min(0) + ctrl.max(0))
        values = np.empty((steps, model.nu))
        for channel in range(model.nu):
            warped = np.abs((at * speed + rng.uniform(0, 0.2) * time[-1]) % (2 * time[-1]))
            warped = np.where(warped > time[-1], 2 * time[-1] - warped, warped)  # there and back again
            size = min(rng.uniform(*_SIZES), _BRISK / speed)
            values[:, channel] = centre[channel] + size * (np.interp(warped, time, ctrl[:, channel]) - centre[channel])
        reach = np.ptp(ctrl, axis=0)
        low, high = ctrl.min(0) - 0.5 * reach, ctrl.max(0) + 0.5 * reach
        limited = _limited(model)
        low = np.where(limited, np.maximum(low, _range(model)[0]), low)
        high = np.where(limited, np.minimum(high, _range(model)[1]), high)
        out.append(Command(at, np.clip(values, low, high), dataset.interpolation))
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
