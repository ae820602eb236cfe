"""Starting states of windows that suit a hypothesis, and what these could explain in its own world.

The starting states of the believed model would judge another one unfairly. They take a few Gauss-Newton steps towards
its own samples, and stay near the smoothed states, which know no model: a wrong one would drag them along.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows.time_steps import step_error
from btr_mjx.gap.windows.windows import Windows
from btr_mjx.models import integrate

STEPS = 3
"""Gauss-Newton steps for another hypothesis; fewer favour the one that the states suited before."""

_MORE = 4
"""Further rounds, for windows whose steps are shortened or still help."""

_BACK = 0.35
"""Factor on a step that did not help: where a foot touches at another time, the linear picture holds nearby only."""

_LEAST = 0.03
"""Part of a Gauss-Newton step below which a window is left where it is."""

_CONTENT = 1.0
"""A window whose chi^2 promises to fall by less is left where it is; what it could still gain is projected out."""

_UNKEPT = 40.0
"""The same of a part of a step, after a whole one did not help, as if of the whole."""


def centred(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    steps: int,
    states: np.ndarray,
    correction: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Newton steps of the starting states; a window keeps a step only if it helps, and else tries a part of it.

    Args:
      windows: with the directions of their starting states.
      make: the hypothesis.
      steps: so many, and `_MORE` at most.
      states: (W, k + 1, nq + nv) of the hypothesis from the starting states of the windows.
      correction: (W, R) of the model's time step.

    Returns:
      Starting states qpos (W, nq), qvel (W, nv), and the states from there (W, k + 1, nq + nv).
    """
    nv, sigma, model = windows.nv, windows.data.sigma, windows.models[0]
    qpos, qvel, states = windows.qpos.copy(), windows.qvel.copy(), states.copy()
    raw = windows.whiten(states) + correction
    smoothed = np.concatenate(windows.smoothed, -1)
    own, share = np.arange(len(windows)), np.ones(len(windows))
    for _ in range(steps + _MORE):
        away = windows.minus(np.concatenate([qpos[own], qvel[own]], -1), smoothed[own])
        pull = (windows.inverse[own] @ raw[own, :, None])[..., 0] * sigma
        move = np.clip(away - share[own, None] * pull, -windows.reach[own], windows.reach[own])
        ahead = raw[own] + (windows.jacobians[own] @ ((move - away) / sigma)[..., None])[..., 0]
        promise = (raw[own] ** 2).sum(1) - (ahead**2).sum(1)
        worth = promise > np.where(share[own] < 1.0, _UNKEPT * share[own], _CONTENT)
        own, move = own[worth], move[worth]
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
        share[own] = np.where(helps, 1.0, _BACK * share[own])
        own = own[share[own] > _LEAST]
    return qpos, qvel, states


def recentred(windows: Windows, make: Callable[[mujoco.MjModel], World], exact: bool = True) -> Windows:
    """A copy of windows whose starting states suit another hypothesis, which is its base for residuals.

    Args:
      windows: linearised.
      make: the hypothesis.
      exact: the error of its time step is found anew, which costs as much as the rest; else that of the base is taken.
    """
    other = windows.copied()
    other.qpos, other.qvel, other.base = centred(windows, make, STEPS, windows.at(make), windows.correction)
    other.maker = make
    if exact:
        other.correction = step_error(other, make, other.base)
    return other


def exactly(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> Windows:
    """A copy of windows with another hypothesis as base, from the same starting states, with its time step's error.

    Args:
      windows: linearised.
      make: the hypothesis.
    """
    other = windows.based(make)
    other.correction = step_error(other, make, other.base)
    return other
