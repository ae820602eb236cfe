"""Transition matrices between samples by finite differences, and detection of changed ones.

Differentiating all intervals is the most expensive part of a linearisation. Another hypothesis changes few of them,
those with other contacts. These are detected with a single random perturbation per interval, whose result is stored:
near contacts it differs from that of the transition matrix even if nothing changed.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from btr_mjx.gap.simulate import Job, Segments, World, simulate
from btr_mjx.gap.windows.propagation import jacobian, linearisation_holds
from btr_mjx.gap.windows.windows import Windows
from btr_mjx.models import integrate

_PERTURBATION = 0.5
"""Perturbation of a state for finite differences, in units of the noise, the uncertainty of the state. Smaller ones
see the discontinuity of touchdowns between time steps."""

_STRIDES = 4, 2
"""Candidates for the time step of derivatives, in units of `windows.dt`."""

_ERROR = 0.002
"""Largest median relative error of the perturbed states with such a step; it accumulates over a window."""

_CONTACT_ERROR = 0.15
"""The same for models with contacts, where the step of a touchdown has a larger influence."""

_MAX_ERROR = 0.9
"""Largest 0.75 quantile of the error relative to the perturbation: touchdowns accelerate light legs strongly."""

_SAMPLE = 64
"""Number of intervals used to choose the step."""


def stride(windows: Windows, make: Callable[[mujoco.MjModel], World], states: np.ndarray) -> int:
    """Longest time step for derivatives, as a multiple of `windows.dt`.

    Args:
      windows: the windows.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.

    Returns:
      1 or an element of `_STRIDES`.
    """
    interval = float(np.median(np.diff(windows.since, axis=1)))
    every = np.linspace(0, len(windows) * windows.k - 1, _SAMPLE).astype(int)
    window, place = np.unravel_index(np.unique(every), (len(windows), windows.k))
    perturbations = np.broadcast_to(_random_perturbation(windows), (len(window), 1, 2 * windows.nv))
    ends_by_stride: dict[int, np.ndarray] = {}
    for times in (1, *_STRIDES):
        if times == 1 or times * windows.dt <= 1.02 * interval:
            moved = _perturbed_ends(windows, make, states, window, place, perturbations, times)
            ends_by_stride[times] = moved[:, 0] / (_PERTURBATION * windows.data.sigma * np.sqrt(2 * windows.nv))
    size = np.maximum(np.linalg.norm(ends_by_stride[1], axis=1), 1e-12)  # zero if a simulation is invalid
    off = {times: np.linalg.norm(there - ends_by_stride[1], axis=1) for times, there in ends_by_stride.items()}
    model = windows.models[0]
    most = _CONTACT_ERROR if model.geom_contype.any() and model.geom_conaffinity.any() else _ERROR
    good = (t for t, e in off.items() if np.median(e / size) <= most and np.quantile(e, 0.75) <= _MAX_ERROR)
    return max(good)


def transitions(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    states: np.ndarray,
    wanted: np.ndarray | None = None,
    known: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrices of the state from each sample to the next, by finite differences.

    Args:
      windows: the windows.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.
      wanted: (W, k) bool: intervals to differentiate; None for all.
      known: previous result, for the other intervals.

    Returns:
      Matrices (W, k, 2 nv, 2 nv), and change of the state (W, k, 2 nv) by the perturbation of `transition_change`.
    """
    size, scale = 2 * windows.nv, _PERTURBATION * windows.data.sigma
    perturbations = np.concatenate([np.diag(scale), _random_perturbation(windows)[None]])
    if wanted is None or known is None:
        wanted = np.ones((len(windows), windows.k), bool)
        known = np.zeros((len(windows), windows.k, size, size)), np.zeros((len(windows), windows.k, size))
    matrices, ends = (array.copy() for array in known)
    window, interval = np.nonzero(wanted)
    moved = _perturbed_ends(
        windows, make, states, window, interval, np.broadcast_to(perturbations, (len(window), size + 1, size))
    )
    matrices[window, interval] = np.swapaxes(moved[:, :-1] / scale[:, None], 1, 2)
    ends[window, interval] = moved[:, -1]
    return matrices, ends


def state_jacobians(windows: Windows, make: Callable[[mujoco.MjModel], World]) -> np.ndarray:
    """Jacobians of residuals with respect to the starting state.

    Products of transition matrices; finite differences of whole windows where the linearisation does not hold.

    Args:
      windows: with their transitions.
      make: the hypothesis.

    Returns:
      (W, R, 2 nv) in units of the noise.
    """
    found = jacobian(windows)
    nonlinear = np.flatnonzero(~linearisation_holds(found))
    if len(nonlinear):
        found[nonlinear] = simulated_jacobians(windows, make, nonlinear)
    return found


def simulated_jacobians(windows: Windows, make: Callable[[mujoco.MjModel], World], own: np.ndarray) -> np.ndarray:
    """Jacobians of residuals with respect to the starting state, by finite differences of whole windows.

    Unlike products of transition matrices they do not grow without bound over several touchdowns.

    Args:
      windows: the windows.
      make: the hypothesis.
      own: (N,) indices of windows.

    Returns:
      (N, R, 2 nv), both sides in units of the noise.
    """
    nq, nv, size = windows.nq, windows.nv, 2 * windows.nv
    perturbations = np.concatenate([np.zeros((1, size)), _PERTURBATION * np.diag(windows.data.sigma)])
    out = np.zeros((len(own), windows.correction.shape[1], size))
    for model, members in windows.groups:
        mine = np.flatnonzero(np.isin(own, members))
        if not len(mine):
            continue
        there = np.repeat(own[mine], len(perturbations))
        away = np.tile(perturbations, (len(mine), 1))
        qpos = integrate(model, windows.qpos[there], away[:, :nv])
        segments = windows.segments(there, qpos, windows.qvel[there] + away[:, nv:], windows.since[there])
        step = windows.stride * windows.dt
        states = simulate([(make(model), segments)], timestep=step, counter=windows.counter)[0]
        states = states.reshape(len(mine), len(perturbations), windows.k + 1, nq + nv)
        moved = windows.scaled(windows.minus(states[:, 1:], states[:, :1]))
        out[mine] = np.swapaxes(moved, 1, 2) / _PERTURBATION
    return out


def single_intervals(
    windows: Windows, window: np.ndarray, interval: np.ndarray, qpos: np.ndarray, qvel: np.ndarray
) -> Segments:
    """Sample intervals as segments, from n starting states each.

    Args:
      windows: the windows.
      window: (N,) window of each interval.
      interval: (N,) its index within the window.
      qpos: (N, n, nq) starting configurations.
      qvel: (N, n, nv) starting velocities.

    Returns:
      N * n segments.
    """
    count = qpos.shape[1]
    window, interval = np.repeat(window, count), np.repeat(interval, count)
    return Segments(
        start=windows.time[window, interval],
        qpos=qpos.reshape(-1, windows.nq),
        qvel=qvel.reshape(-1, windows.nv),
        samples=(windows.since[window, interval + 1] - windows.since[window, interval])[:, None],
        commands=windows.data.commands,
        recording=windows.recording[window],
        act=windows.act[window, interval] if windows.act.shape[2] else None,
    )


def _random_perturbation(windows: Windows) -> np.ndarray:
    """A perturbation (2 nv,) of all coordinates with random signs, the same in every call."""
    return np.random.default_rng(0).choice([-1.0, 1.0], 2 * windows.nv) * _PERTURBATION * windows.data.sigma


def transition_change(windows: Windows, make: Callable[[mujoco.MjModel], World], states: np.ndarray) -> np.ndarray:
    """Difference between the transitions of a hypothesis and those of the windows, estimated with one perturbation.

    Args:
      windows: linearised.
      make: the hypothesis.
      states: (W, k + 1, nq + nv) its states.

    Returns:
      (W, k) norm, in units of the noise, of the change of the perturbed state at the end of each interval. Its mean
      square over random signs is the squared Frobenius norm of the change of the whitened transition matrix.
    """
    window, interval = (i.ravel() for i in np.indices((len(windows), windows.k)))
    perturbations = np.broadcast_to(_random_perturbation(windows), (len(window), 1, 2 * windows.nv))
    moved = _perturbed_ends(windows, make, states, window, interval, perturbations)[:, 0]
    error = (moved - windows.perturbed_ends[window, interval]) / (_PERTURBATION * windows.data.sigma)
    return np.sqrt((error**2).sum(-1)).reshape(len(windows), windows.k)


def _perturbed_ends(
    windows: Windows,
    make: Callable[[mujoco.MjModel], World],
    states: np.ndarray,
    window: np.ndarray,
    interval: np.ndarray,
    perturbations: np.ndarray,
    times: int | None = None,
) -> np.ndarray:
    """Changes (N, n, 2 nv) of the states at the ends of N intervals by perturbations (N, n, 2 nv) at their starts."""
    nq, nv = windows.nq, windows.nv
    out = np.zeros(perturbations.shape)
    jobs: list[Job] = []
    members = []
    for model, own in windows.groups:
        mine = np.flatnonzero(np.isin(window, own))
        if not len(mine):
            continue
        start = states[window[mine], interval[mine], None]  # (n, 1, nx)
        both = np.concatenate([np.zeros_like(perturbations[mine, :1]), perturbations[mine]], 1)
        qpos = integrate(model, np.broadcast_to(start[..., :nq], (*both.shape[:2], nq)), both[..., :nv])
        qvel = start[..., nq:] + both[..., nv:]
        jobs.append((make(model), single_intervals(windows, window[mine], interval[mine], qpos, qvel)))
        members.append(mine)
    found = simulate(jobs, timestep=(times or windows.stride) * windows.dt, counter=windows.counter)
    for mine, ends in zip(members, found, strict=True):
        ends = ends.reshape(len(mine), perturbations.shape[1] + 1, -1)
        out[mine] = np.nan_to_num(windows.minus(ends[:, 1:], ends[:, :1]))
    return out
