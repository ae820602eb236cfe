"""Placement of windows: length, number and position.

With contact, windows last some tens of milliseconds, as the linearisation holds no longer. Without contact they are as
long as the believed model stays close to the data, because slow effects (friction, offsets) need long windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import has_closed_loops
from btr_mjx.gap.simulate import Counter, Segments, World, simulate
from btr_mjx.gap.windows.coverage import activity, activity_weights, greedy_cover
from btr_mjx.gap.windows.impacts import contact_samples, impact_free_windows
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.prepared import PreparedData
from btr_mjx.gap.windows.sensitivity import intervals_per_evaluation
from btr_mjx.gap.windows.state_estimate import smooth
from btr_mjx.models import difference, integrate

CONTACT_SPAN = 0.04
"""Length of a window with contact [s]. At equal cost shorter windows give smaller gains of true effects, and longer
ones no larger gains."""

MIN_SPAN = 0.02
"""Shortest window without contact [s]."""

_MAX_SPAN = 1.0
"""Longest window [s]."""

_MAX_STRAY = 0.25
"""Largest median deviation of the believed model in a window, relative to the standard deviation of the motion."""

_MAX_CURVATURE = 1.0, 0.8
"""Largest second-order effect of an error of the starting state, in standard deviations of the noise, and the quantile
of windows for which it must hold: the projection of starting states neglects it."""

_PERTURBATION = 0.5
"""Error of the starting state for this test, in units of the noise (a state estimate averages several samples)."""

_MIN_SAMPLES = 6
"""Smallest number of samples of a window after its first."""

_HELD_OUT = 1.0
"""Largest number of held-out windows per window to fit."""

_OTHER_SIMULATIONS = 24
"""Simulations per window besides its transitions: fine time steps, starting states, draws of tolerances."""

_HELD_OUT_HYPOTHESES = 14
"""Approximate number of hypotheses that are evaluated on held-out windows."""

_MIN_COUNT_SINGLE = 30
"""Number of candidate parameters above which signatures are evaluated with single steps."""

_PlacedWindows = tuple[PreparedData, np.ndarray, np.ndarray, int]
"""Recordings, and the result of `place_windows` for them."""


@dataclass(frozen=True)
class Survey:
    """Contact in the recordings, and length of the windows.

    Attributes:
      contact: whether more than 1 % of all samples have a contact.
      span: length of the windows [s].
    """

    contact: bool
    span: float


def survey(data: PreparedData, counter: Counter) -> Survey:
    """Detect contacts with the believed models at the measured states, and choose the length of the windows.

    Args:
      data: recordings to fit.
      counter: adds up the simulated steps.

    Raises:
      InputError: there is no motion beyond the noise.
    """
    touching = contact_samples(data, counter)
    contact = float(np.concatenate(touching).mean()) > 0.01
    span = CONTACT_SPAN if contact else _smooth_span(data, counter)
    return Survey(contact, span)


def _smooth_span(data: PreparedData, counter: Counter) -> float:
    """Longest window in which the believed model stays close to the data and depends linearly on its starting state.

    The second condition excludes windows in which unstable motion amplifies errors of the starting state.
    """
    model = data.recordings[0].model
    shortest = min(float(r.time[-1] - r.time[0]) for r in data.recordings)
    longest = min(_MAX_SPAN, 0.48 * shortest)
    marks = np.geomspace(MIN_SPAN, max(longest, 2 * MIN_SPAN), 12)
    stray: list[np.ndarray] = []
    curvatures: list[np.ndarray] = []
    rng = np.random.default_rng(0)
    spread = np.zeros(model.nv)
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        spread = np.maximum(spread, difference(model, track.qpos[:1], track.qpos).std(0))
        last = int(np.searchsorted(track.time, track.time[-1] - marks[-1]))
        first = np.unique(np.linspace(0, max(last - 1, 0), 4).astype(int))
        qpos, qvel, _ = smooth(model, track, first, data.sigma, data.span)
        own = np.full(len(first), i)
        act = data.acts[i][first] if model.na else None
        perturbation = _PERTURBATION * rng.choice([-1.0, 1.0], (len(first), 2 * model.nv)) * data.sigma
        starts = [
            (integrate(model, qpos, s * perturbation[:, : model.nv]), qvel + s * perturbation[:, model.nv :])
            for s in (0, 1, -1)
        ]
        segment_sets = [Segments(track.time[first], *start, marks, data.commands, own, act) for start in starts]
        world = World.of(recording.model)
        states, *perturbed = simulate([(world, segments) for segments in segment_sets], counter=counter)
        curvatures.append(_curvature(model, states, perturbed) / data.sigma[: model.nv])
        there = track.time[first][:, None] + marks
        nearest = np.clip(np.searchsorted(track.time, there), 0, len(track.time) - 1)
        at = np.minimum(nearest, len(track.time) - 1)
        stray.append(np.abs(difference(model, track.qpos[at], states[..., : model.nq])))
    away = np.nan_to_num(np.concatenate(stray), nan=np.inf)  # (windows, marks, nv)
    typical = np.median(away, axis=0) / np.maximum(spread, 1e-9)
    moving = (spread > 10 * data.sigma[: model.nv]) & data.measured[: model.nv]
    if not moving.any():
        raise InputError("the recordings hold no motion beyond the noise; nothing can be told from them")
    curved = np.quantile(
        np.nan_to_num(np.concatenate(curvatures), nan=np.inf).max(2), _MAX_CURVATURE[1], axis=0, method="lower"
    )
    good = (typical[:, moving] < _MAX_STRAY).all(1) & (curved < _MAX_CURVATURE[0])
    count = int(np.argmin(good)) if not good.all() else len(good)
    return float(marks[max(count - 1, 0)])


def _curvature(model: mujoco.MjModel, states: np.ndarray, perturbed: Sequence[np.ndarray]) -> np.ndarray:
    """Second-order effect on positions (W, K, nv): half the sum of the changes by two opposite perturbations."""
    there, back = (difference(model, states[..., : model.nq], other[..., : model.nq]) for other in perturbed)
    return 0.5 * np.abs(there + back)


def plan_windows(
    data: PreparedData, held: PreparedData, span: float, count: int, options: Options, counter: Counter
) -> tuple[_PlacedWindows, _PlacedWindows, bool]:
    """Windows of fit and held-out recordings, as many as the budget allows.

    Args:
      data: recordings to fit.
      held: recordings held out.
      span: length of a window [s].
      count: total number of parameters of the candidates whose signatures are simulated.
      options: budget.
      counter: adds up the simulated steps.

    Returns:
      Windows to fit, held-out windows, and whether signatures are evaluated with single steps, see
      `sensitivity.signatures`.

    Raises:
      InputError: a recording is too short for a window.
    """
    model = data.recordings[0].model
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    steps = max(1, round(interval / step_of(data)))
    single = steps >= 3 and count > _MIN_COUNT_SINGLE and not has_closed_loops(model)
    screening = count / steps / intervals_per_evaluation(interval) if single else count
    # Estimate: derivatives may take longer steps (`transitions.stride`), which is known only once there are windows.
    state = (2 * model.nv + 1) * (0.5 if steps >= 4 else 1.0) + _OTHER_SIMULATIONS
    per_step = state + screening + 4.0 * (options.leaders + options.contact_leaders)
    share = 0.7 if len(data.recordings) >= len(held.recordings) else 0.6
    budget = options.budget(model.nv)
    fit = place_windows(data, span, share * budget, per_step, counter=counter)
    most = max(1, round(_HELD_OUT * len(fit[1]) / len(held.recordings)))
    test = place_windows(held, span, (1 - share) * budget, state + _HELD_OUT_HYPOTHESES + screening / 3, most, counter)
    return (data, *fit), (held, *test), single


def step_of(data: PreparedData) -> float:
    """Time step of the simulations [s]."""
    return float(data.recordings[0].model.opt.timestep) / data.step_divisor


def place_windows(
    data: PreparedData,
    span: float,
    budget: float,
    per_step: float,
    most: int | None = None,
    counter: Counter | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Windows that do not overlap: all that fit, or those chosen by `coverage.greedy_cover`.

    Args:
      data: the recordings.
      span: length of a window [s].
      budget: number of simulated steps.
      per_step: simulated steps of the whole analysis per step of a window.
      most: largest mean number of windows per recording; None for no limit.
      counter: adds up the simulated steps.

    Returns:
      Recording index (W,), first sample (W,), and number of samples of a window after its first.

    Raises:
      InputError: a recording is too short for a window.
    """
    own, start, k = tile_windows(data, span)
    model = data.recordings[0].model
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    steps = max(1.0, k * interval / step_of(data))
    affordable = budget / (per_step * steps) / len(data.recordings)
    count = int(np.clip(round(affordable), 1, most)) * len(data.recordings)
    if count < len(start):
        busy = activity(data, counter or Counter())
        shares = np.stack([busy[i][a : a + k].mean(0) for i, a in zip(own, start, strict=True)])
        chosen = np.sort(greedy_cover(shares, activity_weights(model.nv), own, count))
        own, start = own[chosen], start[chosen]
    return own, start, k


def tile_windows(data: PreparedData, span: float) -> tuple[np.ndarray, np.ndarray, int]:
    """All windows that fit without overlap, and without impacts where these are known.

    Args:
      data: the recordings.
      span: length of a window [s].

    Returns:
      Recording index (W,), first sample (W,), and number of samples of a window after its first.

    Raises:
      InputError: a recording is too short for a window.
    """
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    k = max(_MIN_SAMPLES, round(span / interval))
    room = [(len(r.time) - 1 - data.span.half) // k for r in data.recordings]
    if min(room) < 1:
        r = data.recordings[int(np.argmin(room))]
        raise InputError(f"recording {r.name!r}: {len(r.time)} samples are too short for a window of {k + 1} samples")
    recording, first = [], []
    for i, (r, fits) in enumerate(zip(data.recordings, room, strict=True)):
        last = len(r.time) - 1 - k
        earliest = min(data.span.half, last)
        if data.impacts is None:
            first.append(np.unique(np.linspace(earliest, last, fits).astype(int)))
        else:
            first.append(impact_free_windows(data.impacts[i], earliest, last, k))
        recording.append(np.full(len(first[-1]), i))
    return np.concatenate(recording), np.concatenate(first), k
