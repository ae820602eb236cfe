"""Fit of the starting states of windows to a hypothesis, by damped Gauss-Newton steps.

Starting states fitted with one model favour it in comparisons, so each hypothesis gets its own. They stay within bounds
around the smoothed states, which do not depend on a model.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows.time_steps import step_error
from btr_mjx.gap.windows.windows import Windows
from btr_mjx.models import integrate

STEPS = 3
"""Gauss-Newton steps for another hypothesis; fewer would favour the hypothesis of the initial states."""

_EXTRA_STEPS = 4
"""Additional iterations, for windows with reduced steps or without convergence."""

_STEP_REDUCTION = 0.35
"""Factor on a step that was rejected."""

_MIN_SHARE = 0.03
"""Fraction of a Gauss-Newton step below which the iteration of a window stops."""

_MIN_GAIN = 1.0
"""Predicted decrease of chi^2 below which the iteration of a window stops; the rest is projected out."""

_MIN_GAIN_REDUCED = 40.0
"""The same for reduced steps, per unit fraction of the step."""


def fit_starting_states(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    steps: int,
    states: np.ndarray,
    correction: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit starting states by Gauss-Newton steps; a rejected step is retried with a reduced length.

    Args:
      windows: with the Jacobians of the starting states.
      make: the hypothesis.
      steps: number of steps, plus up to `_EXTRA_STEPS`.
      states: (W, k + 1, nq + nv) states of the hypothesis from the current starting states.
      correction: (W, R) correction of the time step, see `time_steps.step_error`.

    Returns:
      Starting states qpos (W, nq) and qvel (W, nv), and simulated states from these (W, k + 1, nq + nv).
    """
    nv, sigma, model = windows.nv, windows.data.sigma, windows.models[0]
    qpos, qvel, states = windows.qpos.copy(), windows.qvel.copy(), states.copy()
    raw = windows.whiten(states) + correction
    smoothed = np.concatenate(windows.smoothed, -1)
    own, share = np.arange(len(windows)), np.ones(len(windows))
    for _ in range(steps + _EXTRA_STEPS):
        away = windows.minus(np.concatenate([qpos[own], qvel[own]], -1), smoothed[own])
        pull = (windows.inverse[own] @ raw[own, :, None])[..., 0] * sigma
        move = np.clip(away - share[own, None] * pull, -windows.reach[own], windows.reach[own])
        ahead = raw[own] + (windows.jacobians[own] @ ((move - away) / sigma)[..., None])[..., 0]
        predicted = (raw[own] ** 2).sum(1) - (ahead**2).sum(1)
        active = predicted > np.where(share[own] < 1.0, _MIN_GAIN_REDUCED * share[own], _MIN_GAIN)
        own, move = own[active], move[active]
        if not len(own):
            break
        start = qpos.copy(), qvel.copy()
        start[0][own] = integrate(model, windows.smoothed[0][own], move[:, :nv])
        start[1][own] = windows.smoothed[1][own] + move[:, nv:]
        moved = windows.states([make], start=start, own=own)[0]
        trial = windows.whiten(moved, own) + correction[own]
        gain = (raw[own] ** 2).sum(1) - (trial**2).sum(1)
        helps = gain > 0
        better = own[helps]
        qpos[better], qvel[better] = start[0][better], start[1][better]
        states[better], raw[better] = moved[helps], trial[helps]
        share[own] = np.where(helps, 1.0, _STEP_REDUCTION * share[own])
        own = own[share[own] > _MIN_SHARE]
    return qpos, qvel, states


def with_fitted_states(windows: Windows, make: Callable[[mujoco.MjModel], World], exact: bool = True) -> Windows:
    """A copy of windows with another hypothesis as base and starting states fitted to it.

    Args:
      windows: linearised.
      make: the hypothesis.
      exact: compute the correction of the time step for the hypothesis; else that of `windows` is used.
    """
    other, states = windows.copied(), windows.at(make)
    before = windows.states([make], start=windows.smoothed)[0]
    anew = (windows.whiten(before) ** 2).sum(1) < (windows.whiten(states) ** 2).sum(1)
    # States that another hypothesis was settled at are no better a beginning than the smoothed ones.
    other.qpos, other.qvel = (
        np.where(anew[:, None], smoothed, own)
        for smoothed, own in zip(windows.smoothed, (windows.qpos, windows.qvel), strict=True)
    )
    states = np.where(anew[:, None, None], before, states)
    other.qpos, other.qvel, other.base = fit_starting_states(other, make, STEPS, states, windows.correction)
    other.make_base = make
    if exact:
        other.correction = step_error(other, make, other.base)
    return other
