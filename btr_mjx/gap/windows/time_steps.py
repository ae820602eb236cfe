"""Time steps of windows: which one residuals are simulated with, and what it does to them.

The simulator's own error looks like damping, so residuals belong to a fine time step. Few simulations take it: what a
longer one does is found once, around a hypothesis, and taken off. That is why a longer one than the model's will do,
where its error is small enough to be known. Where feet touch the ground and a step of the model's own moves states by
several standard deviations, what it does depends on the starting state, and the step is divided (`refinement`).

Data have a time step of their own: none where a machine was measured, a short one where it was simulated. A stiff servo
shows tens of microseconds of it, as damping of all joints, so a small change of it is fitted along with all else.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows.likelihood import project
from btr_mjx.gap.windows.windows import Windows

_FINE = 1.25e-4
"""Time step of the fine pass, roughly [s]: it divides the model's by 4 to 10."""

_DATA = 1e-4
_DOUBT = 1e-4
"""Time step that residuals belong to, and how well that of the data is known (1 sigma) [s]. A machine has none, an
implicit integrator errs the other way than an explicit one, and both are simulated in tenths of a millisecond."""

_UNEVEN, _USUAL = 3.0, 3.0
"""What that does to a window, root mean square in units of the noise, and beside the median of all windows, at most."""

_LONG = 400
"""Windows of more steps are divided by 4 only; the rest is extrapolated."""

_COARSE = 1e-3
"""Longest time step that is taken instead of a shorter one of the model [s]."""

_ROUGH = 0.7
"""Root mean square, in units of the noise, of what such a step does, beyond which the model's own is taken."""

_FINER = 4, 16
"""By so much the model's time step is divided where feet need it, at least and at most. Half of it was not enough: with
0.5 instead of 1 ms what is left of its error still looked like damping of all joints of a quadruped (a score of 152
where nothing was missing)."""

_LEFT = 1.4
"""Root mean square, as above, of what such a divided step may do: errors are of first order."""


def fine_step(windows: Windows) -> float:
    """Time step of the fine pass [s]."""
    if windows.since[:, -1].max() > _LONG * windows.dt:
        return windows.dt / 4
    return windows.dt / float(np.clip(round(windows.dt / _FINE), 4, 10))


def step_error(windows: Windows, make: Callable[[mujoco.MjModel], World], base: np.ndarray) -> np.ndarray:
    """What the time step does to states of a hypothesis.

    The error of a step is of first order in its length. What the fine pass leaves of it looks like a delay of half a
    fine step, and is extrapolated to the step that data are taken to have.

    Args:
      windows: with their time step.
      make: the hypothesis.
      base: (W, k + 1, nq + nv) its states.

    Returns:
      (W, R) in units of the noise, to be added to a residual.
    """
    fine = fine_step(windows)
    rest = (windows.step - min(fine, _DATA)) / (windows.step - fine)
    return rest * (windows.whiten(windows.states([make], timestep=fine)[0]) - windows.whiten(base))


def step_doubt(windows: Windows, make: Callable[[mujoco.MjModel], World] = World.of) -> np.ndarray:
    """What one standard deviation of the data's own time step does to residuals.

    A Runge-Kutta scheme errs in another direction, next to nowhere, than the schemes of first order do that most data
    of simulations come from: what these do is simulated for it.

    Args:
      windows: linearised.
      make: the hypothesis that they are linearised around.

    Returns:
      (W, R) in units of the noise, with directions of the starting state projected out.
    """
    return project(_doubt(windows, make), windows.basis)


def kept(windows: Windows, make: Callable[[mujoco.MjModel], World], contact: bool) -> Windows:
    """Windows in which the linear picture holds, see `Windows.calm`; without contacts, in which a step does little.

    What turns over near an unstable balance multiplies all that is off before, a tenth of a millisecond to twenty
    times the noise. One number for all windows no longer describes that.

    Args:
      windows: linearised.
      make: the hypothesis that they are linearised around.
      contact: whether the robot touches anything.
    """
    windows = windows.calm()
    if contact:
        return windows
    size = np.sqrt((_doubt(windows, make) ** 2).mean(1))
    even = size <= max(_UNEVEN, _USUAL * float(np.median(size)))
    return windows if even.all() else windows.some(np.flatnonzero(even))


def _doubt(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> np.ndarray:
    fine = fine_step(windows)
    if windows.models[0].opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        simple, own = (windows.whiten(windows.states([one], timestep=fine)[0]) for one in (_FirstOrder(make), make))
        return _DOUBT / fine * (simple - own)
    return _DOUBT / (windows.step - min(fine, _DATA)) * windows.correction


@dataclass(frozen=True)
class _FirstOrder:
    """A hypothesis, integrated by a scheme of first order."""

    make: Callable[[mujoco.MjModel], World]

    def __call__(self, model: mujoco.MjModel) -> World:
        world = self.make(model)
        other = copy.copy(world.model)
        other.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        return replace(world, model=other)


def paced(
    windows: Windows, make: Callable[[mujoco.MjModel], World], step: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the time step of windows: the model's, or twice that where it does little that sensors could see.

    Args:
      windows: whose `step` is set.
      make: a hypothesis.
      step: that of windows which these are to be joined to [s]; None to choose one.

    Returns:
      Its states (W, k + 1, nq + nv), and what the step does to them, see `step_error`.
    """
    interval = float(np.median(np.diff(windows.since, axis=1)))
    for times in (2, 1) if step is None else (step / windows.dt,):
        windows.step = times * windows.dt
        if step is None and times > 1 and windows.step > 1.02 * min(_COARSE, interval):
            continue
        base = windows.states([make])[0]
        error = step_error(windows, make, base)
        if step is not None or times == 1 or np.median((error**2).mean(1)) <= _ROUGH**2:
            break
    return base, error


def refinement(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> int:
    """By what the model's time step is to be divided.

    What a step does is taken off as far as the fine pass knows it from one starting state. Where a foot comes down on
    the ground that changes with the starting state, and a step that moves states by several standard deviations leaves
    as much as a strong effect.

    Args:
      windows: whose `step` is set.
      make: a hypothesis.

    Returns:
      1 where it does little enough, else a power of two.
    """
    _, error = paced(windows, make)
    rough = float(np.sqrt(np.median((error**2).mean(1))))
    return 1 if rough <= _ROUGH else int(np.clip(2 ** np.ceil(np.log2(rough / _LEFT)), *_FINER))
