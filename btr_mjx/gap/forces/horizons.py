"""Numbers with which the mended model follows recordings over the longest horizon at which it can.

Forces say what is missing. Their numbers carry errors of velocities and accelerations, which a simulation over many
samples does not see; a long simulation in turn says nothing where motion diverges. So numbers are moved, no more than
forces allow, to where simulations are nearest to the data, over horizons that grow while they are followed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.forces.motion import time_step
from btr_mjx.gap.forces.points import ForceSide, Point
from btr_mjx.gap.forces.unknowns import Library
from btr_mjx.gap.simulate import Counter, Segments, simulate
from btr_mjx.gap.windows import PreparedData, smooth
from btr_mjx.models import difference

_SHORTEST = 0.25
"""Shortest horizon [s]."""

_LONGER = 4.0
"""Ratio of horizons that are tried."""

_FOLLOWS = 0.1
"""Error in units of the motion's standard deviation, up to which a simulation follows a recording."""

_STEPS = 3
"""Gauss-Newton steps over a horizon, at most."""

_SAMPLES = 40_000
"""Samples of a horizon's simulations, at most."""


Errors = Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class Horizon:
    """W simulations of recordings over the same time.

    Attributes:
      data: the recordings.
      segments: those of each recording, by index; each with its own starting states.
      target: (W, K, nq) measured positions.
    """

    data: PreparedData
    segments: tuple[tuple[int, Segments], ...]
    target: tuple[np.ndarray, ...]


def follow_horizons(side: ForceSide, point: Point, covariance: np.ndarray, library: Library) -> Point:
    """Move the numbers of named effects to where the model follows recordings best.

    Args:
      side: recordings to fit.
      point: named effects with the numbers of forces.
      covariance: (p, p) of these numbers.
      library: of the search; calibration stays as it is.

    Returns:
      The point with other numbers; the same one where no horizon is followed.
    """
    data = side.stretches.data
    seen = np.flatnonzero(data.measured[: data.recordings[0].model.nv])
    size = np.concatenate([_motion(data, r) for r in range(len(data.recordings))])[:, seen].std(0)
    longest = min(float(np.ptp(r.time)) for r in data.recordings)
    horizon, best = _SHORTEST, point
    while horizon < _LONGER * longest:
        trial = cut_horizons(data, min(horizon, longest))
        square = _exact_errors(trial, [best], library, side.counter)[0][..., seen] ** 2
        rms = np.sqrt(np.median(square.mean(1), 0))
        if not np.all(rms < _FOLLOWS * size):
            break
        best, covariance = _nearest(side, trial, best, covariance, (seen, rms), library)
        horizon *= _LONGER
    return best


def cut_horizons(data: PreparedData, horizon: float) -> Horizon:
    """Cut recordings into simulations over a horizon [s], one behind the other.

    Args:
      data: recordings.
      horizon: no longer than the shortest recording.
    """
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    count = max(1, int(horizon / interval))
    total = sum(len(r.time) // (count + 1) or 1 for r in data.recordings)
    every = max(1, -(-total * (count + 1) // _SAMPLES))
    segments, target = [], []
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        own = min(count, len(recording.time) - 1)
        first = np.arange(0, len(recording.time) - own, own + 1)[::every]
        index = first[:, None] + np.arange(own + 1)
        qpos, qvel, _ = smooth(recording.model, track, first, data.sigma, data.span)
        time = recording.time[index]
        act = data.acts[i][first] if recording.model.na else None
        same = np.full(len(first), i)
        segments.append((i, Segments(time[:, 0], qpos, qvel, time - time[:, :1], data.commands, same, act)))
        target.append(recording.qpos[index])
    return Horizon(data, tuple(segments), tuple(target))


def position_errors(
    trial: Horizon, points: Sequence[Point], library: Library, counter: Counter | None = None, factor: float = 1.0
) -> np.ndarray:
    """Errors (n, W, K, nv) of positions.

    Args:
      trial: what is simulated.
      points: hypotheses.
      library: of the search.
      counter: adds up the simulated steps.
      factor: time steps in units of those of the model.
    """
    recordings = trial.data.recordings
    makes = [point.hypothesis(library) for point in points]
    jobs = [(make(recordings[i].model), segments) for make in makes for i, segments in trial.segments]
    interval = np.concatenate([np.diff(recording.time) for recording in recordings])
    step = time_step(recordings[0].model, interval, factor)
    found = simulate(jobs, timestep=step, threads=1, counter=counter)
    width = max(t.shape[1] for t in trial.target)
    out = []
    for n in range(len(points)):
        rows = found[n * len(trial.segments) : (n + 1) * len(trial.segments)]
        own = []
        for (i, _), states, target in zip(trial.segments, rows, trial.target, strict=True):
            model = recordings[i].model
            away = np.nan_to_num(difference(model, target, states[..., : model.nq]), nan=1e3, posinf=1e3, neginf=-1e3)
            own.append(np.pad(away, ((0, 0), (0, width - away.shape[1]), (0, 0))))
        out.append(np.concatenate(own))
    return np.array(out)


def _exact_errors(
    trial: Horizon, points: Sequence[Point], library: Library, counter: Counter | None = None
) -> np.ndarray:
    """Errors (n, W, K, nv) at vanishing time steps: numbers are not to make up for those of the simulation."""
    whole, half = (position_errors(trial, points, library, counter, factor) for factor in (1.0, 0.5))
    return 2 * half - whole


def _motion(data: PreparedData, r: int) -> np.ndarray:
    """(K, nv) positions of a recording beside its first."""
    recording = data.recordings[r]
    return difference(recording.model, recording.qpos[:1], recording.qpos)


def _numbers(point: Point) -> list[tuple[float, float, float, float]]:
    """Bounds, step and value of every number."""
    return [
        (p.low, p.high, 0.1 * abs(p.step), v)
        for candidate, values in point.named
        for p, v in zip(candidate.parameters, values, strict=True)
    ]


def _nearest(
    side: ForceSide,
    trial: Horizon,
    point: Point,
    covariance: np.ndarray,
    scale: tuple[np.ndarray, np.ndarray],
    library: Library,
) -> tuple[Point, np.ndarray]:
    """The point nearest to the data over one horizon, and the covariance of its numbers.

    Args:
      side: counts the steps.
      trial: the horizon.
      point: what forces and shorter horizons say.
      covariance: (p, p) of its numbers.
      scale: coordinates that were measured, and the size of their errors.
      library: of the search.
    """
    low, high, step, start = (np.array(x) for x in zip(*_numbers(point), strict=True))
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T
    seen, rms = scale

    def residuals(many: Sequence[np.ndarray], simulated: Errors = _exact_errors) -> np.ndarray:
        """(n, N): each simulation counts as one measured value per joint, since its errors go together."""
        tried = [point.moved(values - start, point.calibration) for values in many]
        errors = simulated(trial, tried, library, side.counter)[..., seen] / rms
        own = (errors / np.sqrt(errors.shape[2])).reshape(len(many), -1)
        return np.concatenate([own, (np.array(many) - start) @ root.T], 1)

    at, own = start, residuals([start])[0]
    steps = np.diag(np.where(start + step <= high, step, -step))
    # One set of derivatives, of the usual time step, serves all steps: numbers move by little.
    moved = residuals([start, *(start + steps)], position_errors)
    slopes = ((moved[1:] - moved[0]) / np.diag(steps)[:, None]).T
    for _ in range(_STEPS):
        trial_at = np.clip(at - np.linalg.lstsq(slopes, own)[0], low, high)
        after = residuals([trial_at])[0]
        if not after @ after < own @ own:
            break
        at, own = trial_at, after
    return point.moved(at - start, point.calibration), np.linalg.inv(slopes.T @ slopes)
