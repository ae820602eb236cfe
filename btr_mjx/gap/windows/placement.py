"""Which windows of the recordings are looked at: how long, how many, where.

A robot that touches the world is followed for some tens of milliseconds at a time, because contact breaks the linear
picture; a smooth one for as long as the believed model stays near the data, because slow effects (friction, an offset)
show in long windows only.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import closes_loops
from btr_mjx.gap.simulate import Counter, Stretch, World, simulate
from btr_mjx.gap.windows.coverage import bustle, covering, weights
from btr_mjx.gap.windows.impacts import quiet_windows, touching_samples
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.prepared import Data
from btr_mjx.gap.windows.sensitivity import intervals_per_look
from btr_mjx.gap.windows.state_estimate import smooth
from btr_mjx.models import difference, integrate

CONTACT_SPAN = 0.04
"""Length of a window of a robot that touches the world [s]. At the same cost in simulated steps true effects gained up
to 2.5 times as much in windows of 40 ms as in twice as many of 20 ms, and no more in windows of 60 ms."""

SHORTEST = 0.02
"""No window of another robot is shorter [s]."""

_LONGEST = 1.0
"""No window is longer [s]."""

_STRAY = 0.25
"""A window may be so long that the believed model strays by this part of the motion's own spread."""

_BENT = 1.0, 0.8
"""A window may be so long that the curvature of what a small error of the starting state does stays below this many
standard deviations of the noise, in this part of all windows: starting states are projected out as if it were none."""

_NUDGE = 0.5
"""Such an error, in units of the noise: a state estimate uses several samples."""

_FEWEST = 6
"""Samples of a window after its first, at least."""

_HELD_OUT = 1.0
"""Windows of held-out recordings per window to fit, at most."""

_AROUND = 24
"""Simulations of every window beside those of its transitions: fine passes, starting states, draws of tolerances."""

_JUDGED = 14
"""Hypotheses that are judged on held-out windows, roughly."""

_MANY = 30
"""Numbers of candidates from which on each is looked at in single steps."""

_PlacedWindows = tuple[Data, np.ndarray, np.ndarray, int]
"""Recordings, and windows of them as `place_windows` returns them."""


@dataclass(frozen=True)
class Survey:
    """What the recordings go through.

    Attributes:
      touching: per recording (K,) bool: something is in contact.
      contact: whether the robot touches anything worth mentioning.
      span: length of the windows [s].
    """

    touching: tuple[np.ndarray, ...]
    contact: bool
    span: float


def survey(data: Data, counter: Counter) -> Survey:
    """Evaluate the believed models at the measured states, and choose the windows' length.

    Args:
      data: recordings to fit.
      counter: adds up the simulated steps.
    """
    touching = touching_samples(data, counter)
    contact = float(np.concatenate(touching).mean()) > 0.01
    span = CONTACT_SPAN if contact else _smooth_span(data, counter)
    return Survey(touching, contact, span)


def _smooth_span(data: Data, counter: Counter) -> float:
    """The longest window over which the believed model stays near the data, and follows its starting state evenly.

    A double pendulum that turns over multiplies what is off at the start, so that windows of a second, in which the
    believed model has hardly strayed, left a thousand times the noise with the true model.
    """
    model = data.recordings[0].model
    shortest = min(float(r.time[-1] - r.time[0]) for r in data.recordings)
    longest = min(_LONGEST, 0.48 * shortest)
    marks = np.geomspace(SHORTEST, max(longest, 2 * SHORTEST), 12)
    stray: list[np.ndarray] = []
    bent: list[np.ndarray] = []
    rng = np.random.default_rng(0)
    spread = np.zeros(model.nv)
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        spread = np.maximum(spread, difference(model, track.qpos[:1], track.qpos).std(0))
        last = int(np.searchsorted(track.time, track.time[-1] - marks[-1]))
        first = np.unique(np.linspace(0, max(last - 1, 0), 4).astype(int))
        qpos, qvel, _ = smooth(model, track, first, data.sigma, data.span)
        own = np.full(len(first), i)
        act = data.acts[i][first] if model.na else None
        nudge = _NUDGE * rng.choice([-1.0, 1.0], (len(first), 2 * model.nv)) * data.sigma
        starts = [
            (integrate(model, qpos, s * nudge[:, : model.nv]), qvel + s * nudge[:, model.nv :]) for s in (0, 1, -1)
        ]
        stretches = [Stretch(track.time[first], *start, marks, data.commands, own, act) for start in starts]
        world = World.of(recording.model)
        states, *nudged = simulate([(world, stretch) for stretch in stretches], counter=counter)
        bent.append(_curvature(model, states, nudged) / data.sigma[: model.nv])
        there = track.time[first][:, None] + marks
        nearest = np.clip(np.searchsorted(track.time, there), 0, len(track.time) - 1)
        at = np.minimum(nearest, len(track.time) - 1)
        stray.append(np.abs(difference(model, track.qpos[at], states[..., : model.nq])))
    away = np.nan_to_num(np.concatenate(stray), nan=np.inf)  # (windows, marks, nv)
    typical = np.median(away, axis=0) / np.maximum(spread, 1e-9)
    moving = spread > 10 * data.sigma[: model.nv]
    if not moving.any():
        raise InputError("the recordings hold no motion beyond the noise; nothing can be told from them")
    curved = np.quantile(np.nan_to_num(np.concatenate(bent), nan=np.inf).max(2), _BENT[1], axis=0, method="lower")
    good = (typical[:, moving] < _STRAY).all(1) & (curved < _BENT[0])
    count = int(np.argmin(good)) if not good.all() else len(good)
    return float(marks[max(count - 1, 0)])


def _curvature(model: mujoco.MjModel, states: np.ndarray, nudged: Sequence[np.ndarray]) -> np.ndarray:
    """Half of what two opposite nudges do together to positions (W, K, nv)."""
    there, back = (difference(model, states[..., : model.nq], other[..., : model.nq]) for other in nudged)
    return 0.5 * np.abs(there + back)


def plan_windows(
    data: Data, held: Data, span: float, count: int, options: Options, counter: Counter
) -> tuple[_PlacedWindows, _PlacedWindows, bool]:
    """Windows of both sides of the split, as many as may be afforded.

    Args:
      data: recordings to fit.
      held: recordings held out.
      span: length of a window [s].
      count: numbers of all candidates that are screened.
      options: how much is spent.
      counter: adds up the simulated steps.

    Returns:
      Windows to fit, windows held out, and whether candidates are looked at in single steps, see
      `sensitivity.signatures`.
    """
    model = data.recordings[0].model
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    steps = max(1, round(interval / step_of(data)))
    single = steps >= 3 and count > _MANY and not closes_loops(model)
    screening = count / steps / intervals_per_look(interval) if single else count
    # Directions take longer steps where that does, which cannot be known before there are windows.
    state = (2 * model.nv + 1) * (0.5 if steps >= 4 else 1.0) + _AROUND
    per_step = state + screening + 4.0 * (options.leaders + options.contact_leaders)
    share = 0.7 if len(data.recordings) >= len(held.recordings) else 0.6
    budget = options.budget(model.nv)
    fit = place_windows(data, span, share * budget, per_step, counter=counter)
    most = max(1, round(_HELD_OUT * len(fit[1]) / len(held.recordings)))
    test = place_windows(held, span, (1 - share) * budget, state + _JUDGED + screening / 3, most, counter)
    return (data, *fit), (held, *test), single


def step_of(data: Data) -> float:
    """Time step that simulations take [s]."""
    return float(data.recordings[0].model.opt.timestep) / data.finer


def place_windows(
    data: Data,
    span: float,
    budget: float,
    per_step: float,
    most: int | None = None,
    counter: Counter | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Windows that do not overlap: all there is room for, or those that hold much of everything, see `coverage`.

    Args:
      data: the recordings.
      span: length of a window [s].
      budget: simulated steps that may be spent.
      per_step: simulated steps that the analysis costs per step of a window.
      most: windows of a recording, at most, on average.
      counter: adds up the simulated steps.

    Returns:
      Recording (W,), first sample (W,) and samples of a window after its first.

    Raises:
      InputError: a recording is too short for a window.
    """
    own, start, k = grid(data, span)
    model = data.recordings[0].model
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    steps = max(1.0, k * interval / step_of(data))
    affordable = budget / (per_step * steps) / len(data.recordings)
    count = int(np.clip(round(affordable), 1, most)) * len(data.recordings)
    if count < len(start):
        busy = bustle(data, counter or Counter())
        shares = np.stack([busy[i][a : a + k].mean(0) for i, a in zip(own, start, strict=True)])
        chosen = np.sort(covering(shares, weights(model.nv), own, count))
        own, start = own[chosen], start[chosen]
    return own, start, k


def grid(data: Data, span: float) -> tuple[np.ndarray, np.ndarray, int]:
    """All windows there is room for that do not overlap, and hold no blow where these are known.

    Args:
      data: the recordings.
      span: length of a window [s].

    Returns:
      Recording (W,), first sample (W,) and samples of a window after its first.

    Raises:
      InputError: a recording is too short for a window.
    """
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    k = max(_FEWEST, round(span / interval))
    room = [(len(r.time) - 1 - data.span.half) // k for r in data.recordings]
    if min(room) < 1:
        r = data.recordings[int(np.argmin(room))]
        raise InputError(f"recording {r.name!r}: {len(r.time)} samples are too short for a window of {k + 1} samples")
    recording, first = [], []
    for i, (r, fits) in enumerate(zip(data.recordings, room, strict=True)):
        last = len(r.time) - 1 - k
        earliest = min(data.span.half, last)
        if data.blows is None:
            first.append(np.unique(np.linspace(earliest, last, fits).astype(int)))
        else:
            first.append(quiet_windows(data.blows[i], earliest, last, k))
        recording.append(np.full(len(first[-1]), i))
    return np.concatenate(recording), np.concatenate(first), k
