"""How a small change of the state carries over from one sample to the next, and where that has changed.

Differentiating every interval of every window is the dearest part of a linearisation. Another hypothesis changes few
intervals, those in which something touches that did not; a single nudge in a random direction tells which. Where that
nudge led is remembered, because near contacts it leads elsewhere than the derivatives say even where nothing changed.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from btr_mjx.gap.simulate import Job, Stretch, World, simulate
from btr_mjx.gap.windows.propagation import jacobian, tame
from btr_mjx.gap.windows.windows import Windows
from btr_mjx.models import integrate

_NUDGE = 0.5
"""Perturbation of a state, in units of the noise: as far as it is unknown. A foot comes down at one time step or at the
next, and smaller nudges see a staircase."""


_STRIDES = 4, 2
"""Time steps of which the longest that does is taken, in units of the model's."""

_ERROR = 0.002
"""Part of a nudge's answer by which such a step may be off, in the median: it adds up over a window."""

_CONTACT_ERROR = 0.15
"""The same where something can touch: which step a foot comes down at changes directions by more."""

_JOLT = 0.9
"""By so much of the nudge three quarters of the answers may be off, at most: light legs are thrown about by touchdowns
that come a step too late."""

_SAMPLE = 64
"""Intervals that this is tried on."""


def stride(windows: Windows, make: Callable[[mujoco.MjModel], World], states: np.ndarray) -> int:
    """How much longer than the model's a time step may be that only tells which directions are unknown.

    Args:
      windows: the data.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.
    """
    interval = float(np.median(np.diff(windows.since, axis=1)))
    every = np.linspace(0, len(windows) * windows.k - 1, _SAMPLE).astype(int)
    window, place = np.unravel_index(np.unique(every), (len(windows), windows.k))
    nudges = np.broadcast_to(_mixed(windows), (len(window), 1, 2 * windows.nv))
    answers: dict[int, np.ndarray] = {}
    for times in (1, *_STRIDES):
        if times == 1 or times * windows.dt <= 1.02 * interval:
            moved = _moved(windows, make, states, window, place, nudges, times)
            answers[times] = moved[:, 0] / (_NUDGE * windows.data.sigma * np.sqrt(2 * windows.nv))
    size = np.maximum(np.linalg.norm(answers[1], axis=1), 1e-12)  # zero where a simulation became invalid
    off = {times: np.linalg.norm(there - answers[1], axis=1) for times, there in answers.items()}
    model = windows.models[0]
    most = _CONTACT_ERROR if model.geom_contype.any() and model.geom_conaffinity.any() else _ERROR
    good = (t for t, e in off.items() if np.median(e / size) <= most and np.quantile(e, 0.75) <= _JOLT)
    return max(good)


def transitions(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    states: np.ndarray,
    wanted: np.ndarray | None = None,
    known: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """How a small change of the state at each sample carries over to the next sample.

    Args:
      windows: the data.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.
      wanted: (W, k) bool: intervals to differentiate; None for all.
      known: what this function returned for the others.

    Returns:
      (W, k, 2 nv, 2 nv), and where the nudge of `strangeness` leads, (W, k, 2 nv).
    """
    size, scale = 2 * windows.nv, _NUDGE * windows.data.sigma
    nudges = np.concatenate([np.diag(scale), _mixed(windows)[None]])
    if wanted is None or known is None:
        wanted = np.ones((len(windows), windows.k), bool)
        known = np.zeros((len(windows), windows.k, size, size)), np.zeros((len(windows), windows.k, size))
    matrices, answers = (array.copy() for array in known)
    window, interval = np.nonzero(wanted)
    moved = _moved(windows, make, states, window, interval, np.broadcast_to(nudges, (len(window), size + 1, size)))
    matrices[window, interval] = np.swapaxes(moved[:, :-1] / scale[:, None], 1, 2)
    answers[window, interval] = moved[:, -1]
    return matrices, answers


def directions(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> tuple[np.ndarray, np.ndarray]:
    """How residuals answer to the starting states: products of transitions, and secants where these would grow wild.

    Args:
      windows: with their transitions.
      make: the hypothesis.

    Returns:
      (W, R, 2 nv), scaled by the noise of the starting state, and which windows are tame (W,).
    """
    found = jacobian(windows)
    calm = tame(found)
    wild = np.flatnonzero(~calm)
    if len(wild):
        found[wild] = secants(windows, make, wild)
    return found, calm


def secants(windows: Windows, make: Callable[[mujoco.MjModel], World], own: np.ndarray) -> np.ndarray:
    """How residuals answer to the starting state, by nudging it and simulating whole windows.

    As dear as the transitions. What is off at a touchdown does not grow from each to the next as in their product, for
    a foot that touches touches.

    Args:
      windows: the data.
      make: the hypothesis.
      own: (N,) which windows.

    Returns:
      (N, R, 2 nv), scaled by the noise of the starting state.
    """
    nq, nv, size = windows.nq, windows.nv, 2 * windows.nv
    nudges = np.concatenate([np.zeros((1, size)), _NUDGE * np.diag(windows.data.sigma)])
    out = np.zeros((len(own), windows.correction.shape[1], size))
    for model, members in windows.groups:
        mine = np.flatnonzero(np.isin(own, members))
        if not len(mine):
            continue
        there = np.repeat(own[mine], len(nudges))
        away = np.tile(nudges, (len(mine), 1))
        qpos = integrate(model, windows.qpos[there], away[:, :nv])
        stretch = windows.stretch(there, qpos, windows.qvel[there] + away[:, nv:], windows.since[there])
        step = windows.stride * windows.dt
        states = simulate([(make(model), stretch)], timestep=step, counter=windows.counter)[0]
        states = states.reshape(len(mine), len(nudges), windows.k + 1, nq + nv)
        moved = windows.scaled(windows.minus(states[:, 1:], states[:, :1]))
        out[mine] = np.swapaxes(moved, 1, 2) / _NUDGE
    return out


def single_intervals(
    windows: Windows, window: np.ndarray, interval: np.ndarray, qpos: np.ndarray, qvel: np.ndarray
) -> Stretch:
    """Some sample intervals as stretches of their own.

    Args:
      windows: the data.
      window: (N,) of each interval.
      interval: (N,) its number within the window.
      qpos: (N, n, nq) states that it is started from.
      qvel: (N, n, nv).
    """
    count = qpos.shape[1]
    window, interval = np.repeat(window, count), np.repeat(interval, count)
    return Stretch(
        start=windows.time[window, interval],
        qpos=qpos.reshape(-1, windows.nq),
        qvel=qvel.reshape(-1, windows.nv),
        samples=(windows.since[window, interval + 1] - windows.since[window, interval])[:, None],
        commands=windows.data.commands,
        recording=windows.recording[window],
        act=windows.act[window, interval] if windows.act.shape[2] else None,
    )


def _mixed(windows: Windows) -> np.ndarray:
    """A nudge (2 nv,) of every coordinate at once, with signs of its own."""
    return np.random.default_rng(0).choice([-1.0, 1.0], 2 * windows.nv) * _NUDGE * windows.data.sigma


def strangeness(windows: Windows, make: Callable[[mujoco.MjModel], World], states: np.ndarray) -> np.ndarray:
    """By how much a hypothesis' transitions differ from those that the windows know.

    Args:
      windows: linearised.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.

    Returns:
      (W, k) root sum square, in units of the noise, of the change of where a nudge by the noise of every coordinate
      leads, with signs of its own; its mean square over signs is the squared norm of the transitions' change.
    """
    window, interval = (i.ravel() for i in np.indices((len(windows), windows.k)))
    nudges = np.broadcast_to(_mixed(windows), (len(window), 1, 2 * windows.nv))
    moved = _moved(windows, make, states, window, interval, nudges)[:, 0]
    error = (moved - windows.answers[window, interval]) / (_NUDGE * windows.data.sigma)
    return np.sqrt((error**2).sum(-1)).reshape(len(windows), windows.k)


def _moved(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    states: np.ndarray,
    window: np.ndarray,
    interval: np.ndarray,
    nudges: np.ndarray,
    times: int | None = None,
) -> np.ndarray:
    """Where nudges (N, n, 2 nv) of the states at N intervals lead to at their ends, (N, n, 2 nv), in long steps."""
    nq, nv = windows.nq, windows.nv
    out = np.zeros(nudges.shape)
    jobs: list[Job] = []
    members = []
    for model, own in windows.groups:
        mine = np.flatnonzero(np.isin(window, own))
        if not len(mine):
            continue
        start = states[window[mine], interval[mine], None]  # (n, 1, nx)
        both = np.concatenate([np.zeros_like(nudges[mine, :1]), nudges[mine]], 1)
        qpos = integrate(model, np.broadcast_to(start[..., :nq], (*both.shape[:2], nq)), both[..., :nv])
        qvel = start[..., nq:] + both[..., nv:]
        jobs.append((make(model), single_intervals(windows, window[mine], interval[mine], qpos, qvel)))
        members.append(mine)
    found = simulate(jobs, timestep=(times or windows.stride) * windows.dt, counter=windows.counter)
    for mine, ends in zip(members, found, strict=True):
        ends = ends.reshape(len(mine), nudges.shape[1] + 1, -1)
        out[mine] = np.nan_to_num(windows.minus(ends[:, 1:], ends[:, :1]))
    return out
