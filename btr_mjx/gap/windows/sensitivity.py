"""Signatures: how the residual of every window answers to a small change of the world, for hundreds of worlds at once.

A candidate is not simulated over whole windows. Between two samples it adds a little to the state; the base world's
transitions, which the windows know already, carry that on to the window's end. The addition is measured over the
whole interval between two samples, or by a single step in its middle where an interval has many steps. That misses what
is late of a command that is held, and in closed loops, whose forces follow a step later.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from btr_mjx.gap.simulate import Job, Stretch, World, abreast, simulate
from btr_mjx.gap.windows.propagation import carry
from btr_mjx.gap.windows.transitions import single_intervals
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_HOLD = 0.005
"""What a world adds is evaluated once in so long a time [s], or once in every sample interval if that is longer."""

_CHUNK = 64
"""Signatures that are projected at once."""


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
      makes: worlds that differ a little from it.
      single: one step in the middle of each interval, or of a few short ones, instead of all steps.

    Returns:
      (C, W, R) projected signatures in units of the noise, float32; zero where windows are not tame.
    """
    if single:
        # A held command changes at samples only: the middle of an interval sees nothing of a delay.
        late = [i for i, make in enumerate(makes) if _delays_what_is_held(windows, make)]
        if late:
            rest = [i for i in range(len(makes)) if i not in set(late)]
            out = np.zeros((len(makes), *windows.residual.shape), np.float32)
            for chosen, own in ((late, False), (rest, True)):
                if chosen:
                    out[chosen] = _signatures(windows, base, [makes[i] for i in chosen], own)
            return out
    return _signatures(windows, base, makes, single)


def _delays_what_is_held(windows: Windows, make: MakeWorld) -> bool:
    held = any(command.interpolation == "hold" for command in windows.data.commands)
    return held and bool(make(windows.models[0]).command_edits)


def _signatures(windows: Windows, base: MakeWorld, makes: Sequence[MakeWorld], single: bool) -> np.ndarray:
    out, telling = np.zeros((len(makes), *windows.residual.shape), np.float32), windows.tame[:, None]
    hold = intervals_per_look(float(np.median(np.diff(windows.since, axis=1)))) if single else 1
    pieces = _middles(windows, base, hold) if single else _intervals(windows)

    def look(first: int) -> None:
        chunk = list(makes[first : first + _CHUNK])
        worlds = [[make(model) for model in windows.models] for make in [base, *chunk]]
        found = _ends(windows, worlds, pieces)
        change = np.nan_to_num(windows.minus(found[1:], found[:1]))
        if single:
            pushed = np.repeat(change[..., windows.nv :] / windows.dt, hold, axis=2)[:, :, : windows.k]
            change = _spread(windows, pushed)
        out[first : first + len(chunk)] = telling * carry(windows, change)

    abreast([partial(look, first) for first in range(0, len(makes), _CHUNK)])
    return out


def force_signatures(windows: Windows, inverse: np.ndarray, bins: int) -> np.ndarray:
    """Signatures of unknown generalised forces: one per degree of freedom and part of the window.

    Args:
      windows: linearised.
      inverse: (W, k, nv, nv) inverse inertia at the base states.
      bins: parts of a window, see `parts`.

    Returns:
      (nv * bins, W, R) signatures of 1 N m or N, degree of freedom first.
    """
    part = parts(windows.k, bins)
    nv = windows.nv
    change = np.zeros((nv, bins, len(windows), windows.k, 2 * nv))
    pushed = np.moveaxis(inverse, 3, 0)  # (nv, W, k, nv): accelerations of a unit of each force
    spread = _spread(windows, pushed)
    for b in range(bins):
        change[:, b][:, :, part == b] = spread[:, :, part == b]
    flat = change.reshape(nv * bins, len(windows), windows.k, 2 * nv)
    out = np.zeros((len(flat), *windows.residual.shape), np.float32)
    for first in range(0, len(flat), _CHUNK):
        out[first : first + _CHUNK] = carry(windows, flat[first : first + _CHUNK])
    return out


def parts(k: int, bins: int) -> np.ndarray:
    """The part of the window (k,) that each sample interval belongs to."""
    return np.minimum(np.arange(k) * bins // k, bins - 1)


def _spread(windows: Windows, acceleration: np.ndarray) -> np.ndarray:
    """Additions (C, W, k, 2 nv) at the ends of intervals of accelerations (C, W, k, nv) that last through them."""
    half = 0.5 * np.diff(windows.since, axis=1)[:, :, None] * acceleration
    carried = np.einsum("wkij,cwkj->cwki", windows.transitions[..., windows.nv :], half, optimize=True)
    carried[..., windows.nv :] += half
    return carried


def _intervals(windows: Windows) -> list[tuple[np.ndarray, Stretch]]:
    """Each group's windows and its sample intervals, from the base states."""
    out = []
    for _, own in windows.groups:
        states = windows.base[own][:, :-1].reshape(len(own) * windows.k, 1, -1)
        window, interval = np.repeat(own, windows.k), np.tile(np.arange(windows.k), len(own))
        start = states[..., : windows.nq], states[..., windows.nq :]
        out.append((own, single_intervals(windows, window, interval, *start)))
    return out


def intervals_per_look(interval: float) -> int:
    """Sample intervals of some length [s] that share one evaluation of what a world adds."""
    return max(1, int(_HOLD / interval + 1e-6))


def _middles(windows: Windows, base: MakeWorld, hold: int) -> list[tuple[np.ndarray, Stretch]]:
    """Each group's windows and one step around the middle of every `hold` sample intervals."""
    out = []
    first = np.arange(0, windows.k, hold)
    last = np.minimum(first + hold, windows.k)
    middle = 0.5 * (windows.since[:, first] + windows.since[:, last]) - 0.5 * windows.dt
    middle = np.maximum(middle, 0.0)
    for model, own in windows.groups:
        stretch = windows.stretch(own, windows.qpos[own], windows.qvel[own], middle[own])
        states = simulate([(base(model), stretch)], timestep=windows.dt, counter=windows.counter)[0]
        act = 0.5 * (windows.act[own][:, first] + windows.act[own][:, last])
        count = len(own) * len(first)
        out.append(
            (
                own,
                Stretch(
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


def _ends(
    windows: Windows, worlds: Sequence[Sequence[World]], pieces: Sequence[tuple[np.ndarray, Stretch]]
) -> np.ndarray:
    """States at the ends of the pieces in each world, (C, W, pieces of a window, nq + nv)."""
    jobs: list[Job] = []
    for own_worlds in worlds:
        jobs += [(world, stretch) for world, (_, stretch) in zip(own_worlds, pieces, strict=True)]
    found = simulate(jobs, timestep=windows.dt, counter=windows.counter)
    each = len(pieces[0][1]) // len(pieces[0][0])
    out = np.empty((len(worlds), len(windows), each, windows.nq + windows.nv))
    for i in range(len(worlds)):
        for j, (own, _) in enumerate(pieces):
            out[i, own] = found[i * len(pieces) + j].reshape(len(own), each, -1)
    return out
