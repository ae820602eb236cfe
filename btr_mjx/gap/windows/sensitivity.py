"""Signatures: finite-difference derivatives of the residuals of all windows with respect to changes of the world.

A changed world is not simulated over whole windows. Its difference to the base world is simulated over each sample
interval, and propagated to the end of the window by the transition matrices of the base world. If an interval has many
steps, the difference is evaluated with a single step in its middle; this is not valid for delays of held commands and
for closed kinematic loops, whose constraint forces follow one step later.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from btr_mjx.gap.simulate import Job, Segments, World, run_in_threads, simulate
from btr_mjx.gap.windows.propagation import propagate_additions
from btr_mjx.gap.windows.transitions import single_intervals
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_EVALUATION_INTERVAL = 0.005
"""Time between single-step evaluations [s]; at least one sample interval."""

_CHUNK = 64
"""Number of signatures that are computed at once."""


def signatures(
    windows: Windows,
    base: MakeWorld,
    makes: Sequence[MakeWorld],
    single: bool,
) -> np.ndarray:
    """Signatures of worlds.

    Args:
      windows: linearised around `base`.
      base: the base world.
      makes: worlds that differ a little from the base.
      single: evaluate a single step in the middle of an interval, or of a few short ones, instead of all steps.

    Returns:
      (C, W, R) differences of the projected residuals in units of the noise, float32.
    """
    if single:
        # A held command changes at samples only: a delay has no effect in the middle of an interval.
        late = [i for i, make in enumerate(makes) if _delays_held_command(windows, make)]
        if late:
            rest = [i for i in range(len(makes)) if i not in set(late)]
            out = np.zeros((len(makes), *windows.residual.shape), np.float32)
            for chosen, own in ((late, False), (rest, True)):
                if chosen:
                    out[chosen] = _signatures(windows, base, [makes[i] for i in chosen], own)
            return out
    return _signatures(windows, base, makes, single)


def _delays_held_command(windows: Windows, make: MakeWorld) -> bool:
    held = any(command.interpolation == "hold" for command in windows.data.commands)
    return held and bool(make(windows.models[0]).command_edits)


def _signatures(windows: Windows, base: MakeWorld, makes: Sequence[MakeWorld], single: bool) -> np.ndarray:
    out = np.zeros((len(makes), *windows.residual.shape), np.float32)
    hold = intervals_per_evaluation(float(np.median(np.diff(windows.since, axis=1)))) if single else 1
    pieces = _middle_steps(windows, base, hold) if single else _intervals(windows)

    def evaluate_chunk(first: int) -> None:
        chunk = list(makes[first : first + _CHUNK])
        worlds = [[make(model) for model in windows.models] for make in [base, *chunk]]
        found = _end_states(windows, worlds, pieces)
        change = np.nan_to_num(windows.minus(found[1:], found[:1]))
        if single:
            acceleration = np.repeat(change[..., windows.nv :] / windows.dt, hold, axis=2)[:, :, : windows.k]
            change = _integrate_acceleration(windows, acceleration)
        out[first : first + len(chunk)] = propagate_additions(windows, change)

    run_in_threads([partial(evaluate_chunk, first) for first in range(0, len(makes), _CHUNK)])
    return out


def force_signatures(windows: Windows, inverse: np.ndarray, bins: int) -> np.ndarray:
    """Signatures of generalised forces that are constant within each part of a window.

    Args:
      windows: linearised.
      inverse: (W, k, nv, nv) inverse mass matrix at the base states.
      bins: number of parts of a window, see `window_parts`.

    Returns:
      (nv * bins, W, R) signatures of unit forces (1 N m or N), degree of freedom first.
    """
    part = window_parts(windows.k, bins)
    nv = windows.nv
    change = np.zeros((nv, bins, len(windows), windows.k, 2 * nv))
    acceleration = np.moveaxis(inverse, 3, 0)  # (nv, W, k, nv): accelerations by unit forces
    spread = _integrate_acceleration(windows, acceleration)
    for b in range(bins):
        change[:, b][:, :, part == b] = spread[:, :, part == b]
    flat = change.reshape(nv * bins, len(windows), windows.k, 2 * nv)
    out = np.zeros((len(flat), *windows.residual.shape), np.float32)
    for first in range(0, len(flat), _CHUNK):
        out[first : first + _CHUNK] = propagate_additions(windows, flat[first : first + _CHUNK])
    return out


def window_parts(k: int, bins: int) -> np.ndarray:
    """Part (k,) of the window, 0 to bins - 1, of each of its k sample intervals."""
    return np.minimum(np.arange(k) * bins // k, bins - 1)


def _integrate_acceleration(windows: Windows, acceleration: np.ndarray) -> np.ndarray:
    """State changes (C, W, k, 2 nv) at the ends of intervals by accelerations (C, W, k, nv) constant within them."""
    half = 0.5 * np.diff(windows.since, axis=1)[:, :, None] * acceleration
    carried = np.einsum("wkij,cwkj->cwki", windows.transitions[..., windows.nv :], half, optimize=True)
    carried[..., windows.nv :] += half
    return carried


def _intervals(windows: Windows) -> list[tuple[np.ndarray, Segments]]:
    """For each group of windows its indices, and its sample intervals as segments from the base states."""
    out = []
    for _, own in windows.groups:
        states = windows.base[own][:, :-1].reshape(len(own) * windows.k, 1, -1)
        window, interval = np.repeat(own, windows.k), np.tile(np.arange(windows.k), len(own))
        start = states[..., : windows.nq], states[..., windows.nq :]
        out.append((own, single_intervals(windows, window, interval, *start)))
    return out


def intervals_per_evaluation(interval: float) -> int:
    """Number of sample intervals [s] that share one single-step evaluation."""
    return max(1, int(_EVALUATION_INTERVAL / interval + 1e-6))


def _middle_steps(windows: Windows, base: MakeWorld, hold: int) -> list[tuple[np.ndarray, Segments]]:
    """For each group of windows its indices, and one step around the middle of every `hold` intervals, as segments."""
    out = []
    first = np.arange(0, windows.k, hold)
    last = np.minimum(first + hold, windows.k)
    middle = 0.5 * (windows.since[:, first] + windows.since[:, last]) - 0.5 * windows.dt
    middle = np.maximum(middle, 0.0)
    for model, own in windows.groups:
        segments = windows.segments(own, windows.qpos[own], windows.qvel[own], middle[own])
        states = simulate([(base(model), segments)], timestep=windows.dt, counter=windows.counter)[0]
        act = 0.5 * (windows.act[own][:, first] + windows.act[own][:, last])
        count = len(own) * len(first)
        out.append(
            (
                own,
                Segments(
                    start=(windows.time[own, :1] + middle[own]).reshape(-1),
                    qpos=states[..., : windows.nq].reshape(count, -1),
                    qvel=states[..., windows.nq :].reshape(count, -1),
                    samples=np.full((count, 1), windows.dt),
                    commands=windows.data.commands,
                    recording=np.repeat(windows.recording[own], len(first)),
                    act=act.reshape(count, -1) if act.shape[2] else None,
                ),
            )
        )
    return out


def _end_states(
    windows: Windows, worlds: Sequence[Sequence[World]], pieces: Sequence[tuple[np.ndarray, Segments]]
) -> np.ndarray:
    """States (C, W, segments of a window, nq + nv) at the ends of the segments in each world."""
    jobs: list[Job] = []
    for own_worlds in worlds:
        jobs += [(world, segments) for world, (_, segments) in zip(own_worlds, pieces, strict=True)]
    found = simulate(jobs, timestep=windows.dt, counter=windows.counter)
    each = len(pieces[0][1]) // len(pieces[0][0])
    out = np.empty((len(worlds), len(windows), each, windows.nq + windows.nv))
    for i in range(len(worlds)):
        for j, (own, _) in enumerate(pieces):
            out[i, own] = found[i * len(pieces) + j].reshape(len(own), each, -1)
    return out
