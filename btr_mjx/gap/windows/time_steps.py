"""Time step of windows: choice of the step, correction of its discretisation error, uncertainty of that of the data.

The discretisation error of a first-order integrator acts like damping. Residuals are corrected to a fine time step: the
difference between the chosen and a fine step is simulated once per base hypothesis and added (`step_error`). With
contacts this correction depends on the starting state; if it exceeds the noise, the step is divided (`refinement`).

Measured data have no time step, simulated data have a short one. With stiff servos a difference of some tens of
microseconds is visible, so that the step of the data is a nuisance parameter (`step_uncertainty`).
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows.window_fits import project
from btr_mjx.gap.windows.windows import Windows

_FINE = 1.25e-4
"""Target of the fine time step [s]; it divides that of the model by 4 to 10."""

_DATA_STEP = 1e-4
_DATA_STEP_SIGMA = 1e-4
"""Assumed time step of the data, and its standard deviation [s]: measured data have none, and implicit and explicit
integrators have errors of opposite sign."""

_MAX_EFFECT, _MAX_RATIO = 3.0, 3.0
"""Largest RMS effect of this uncertainty on a window: in units of the noise, and relative to the median window."""

_LONG_WINDOW = 400
"""Number of steps above which the fine step divides by 4 only; the rest is extrapolated."""

_MAX_STEP = 1e-3
"""Longest time step that replaces a shorter one of the model [s]."""

_MAX_STEP_ERROR = 0.7
"""RMS error of a time step, in units of the noise, above which a longer step is not used, or a step is divided."""

_DIVISORS = 2, 16
"""Smallest and largest divisor of the time step of the model for contacts."""

_MAX_DIVIDED_ERROR = 2.8
"""Target of the RMS error of a divided step, in units of the noise; errors are of first order in the step. With half of
it quadrupeds cost twice as much and are named no better (`benchmarks/gate.py --suites quadruped`)."""


def fine_step(windows: Windows) -> float:
    """The fine time step to which residuals are corrected [s]."""
    if windows.since[:, -1].max() > _LONG_WINDOW * windows.dt:
        return windows.dt / 4
    return windows.dt / float(np.clip(round(windows.dt / _FINE), 4, 10))


def step_error(windows: Windows, make: Callable[[mujoco.MjModel], World], base: np.ndarray) -> np.ndarray:
    """Correction of the discretisation error of the time step.

    The error is of first order in the step: the difference to the fine step is extrapolated linearly to the time step
    of the data.

    Args:
      windows: with their time step.
      make: the hypothesis.
      base: (W, k + 1, nq + nv) its states with this step.

    Returns:
      (W, R) in units of the noise, to be added to the residual.
    """
    fine = fine_step(windows)
    rest = (windows.step - min(fine, _DATA_STEP)) / (windows.step - fine)
    return rest * (windows.whiten(windows.states([make], timestep=fine)[0]) - windows.whiten(base))


def step_uncertainty(windows: Windows, make: Callable[[mujoco.MjModel], World] = World.of) -> np.ndarray:
    """Change of the residual for one standard deviation of the time step of the data.

    For models with a Runge-Kutta integrator, the error of a first-order integrator is simulated instead, as it is the
    likely one of simulated data.

    Args:
      windows: linearised.
      make: the hypothesis around which they are linearised.

    Returns:
      (W, R) in units of the noise, with the starting states projected out.
    """
    return project(_step_uncertainty(windows, make), windows.basis)


def reliable_windows(windows: Windows, make: Callable[[mujoco.MjModel], World], contact: bool) -> Windows:
    """Windows in which the time step has little effect; with contact, all of them.

    Motion near an unstable equilibrium amplifies the discretisation error, so that a single parameter for the time step
    does not describe all windows.

    Args:
      windows: linearised.
      make: the hypothesis around which they are linearised.
      contact: whether the robot has contacts.

    Returns:
      The subset, or `windows` itself if all are reliable.
    """
    if contact:
        return windows
    size = np.sqrt((_step_uncertainty(windows, make) ** 2).mean(1))
    even = size <= max(_MAX_EFFECT, _MAX_RATIO * float(np.median(size)))
    return windows if even.all() else windows.some(np.flatnonzero(even))


def _step_uncertainty(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> np.ndarray:
    fine = fine_step(windows)
    if windows.models[0].opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        simple, own = (windows.whiten(windows.states([one], timestep=fine)[0]) for one in (_FirstOrder(make), make))
        return _DATA_STEP_SIGMA / fine * (simple - own)
    return _DATA_STEP_SIGMA / (windows.step - min(fine, _DATA_STEP)) * windows.correction


@dataclass(frozen=True)
class _FirstOrder:
    """A hypothesis with the first-order integrator "implicitfast"."""

    make: Callable[[mujoco.MjModel], World]

    def __call__(self, model: mujoco.MjModel) -> World:
        world = self.make(model)
        other = copy.copy(world.model)
        other.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        return replace(world, model=other)


def choose_time_step(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> tuple[np.ndarray, np.ndarray]:
    """Choose the time step of windows: twice `windows.dt` if its error is below the noise, else `windows.dt`.

    Args:
      windows: `step` is set in place.
      make: a hypothesis.

    Returns:
      States (W, k + 1, nq + nv) of the hypothesis, and their `step_error` (W, R).
    """
    interval = float(np.median(np.diff(windows.since, axis=1)))
    for times in (2, 1):
        windows.step = times * windows.dt
        if times > 1 and windows.step > 1.02 * min(_MAX_STEP, interval):
            continue
        base = windows.states([make])[0]
        error = step_error(windows, make, base)
        if times == 1 or np.median((error**2).mean(1)) <= _MAX_STEP_ERROR**2:
            break
    return base, error


def refinement(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> int:
    """Divisor of the time step of the model that windows with contacts need.

    At touchdowns the discretisation error depends on the starting state, so that its correction leaves a part of it.

    Args:
      windows: `step` is set in place.
      make: a hypothesis.

    Returns:
      1 if the error is small, else a power of two.
    """
    _, error = choose_time_step(windows, make)
    rough = float(np.sqrt(np.median((error**2).mean(1))))
    return (
        1 if rough <= _MAX_STEP_ERROR else int(np.clip(2 ** np.ceil(np.log2(rough / _MAX_DIVIDED_ERROR)), *_DIVISORS))
    )
