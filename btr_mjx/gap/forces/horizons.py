"""Numbers with which the mended model follows recordings over the longest horizon at which it can.

Forces say what is missing. Their numbers carry errors of velocities and accelerations, which a simulation over many
samples does not see; a long simulation in turn says nothing where motion diverges. So numbers are moved, no more than
forces allow, to where simulations are nearest to the data, over horizons that grow while they are followed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.data import Recording
from btr_mjx.gap.effects import Hypothesis
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

FOLLOWS = 0.1
"""Error in units of the motion's standard deviation, up to which a simulation follows a recording."""

_STEPS = 3
"""Gauss-Newton steps over a horizon, at most."""

_LOST = 1e3
"""Error of a simulation that has diverged [rad or m]."""

SAMPLES = 40_000
"""Samples of a horizon's simulations, at most."""

_NUMBERS = 10
"""Numbers that are moved with all of them; more numbers get fewer samples, since each is simulated."""


@dataclass(frozen=True, eq=False)
class Horizon:
    """Simulations of recordings, W of each over the same time.

    Attributes:
      data: all recordings.
      recordings: those that are simulated.
      segments: those of each recording; each with its own starting states.
      target: (W, K, nq) measured positions of each recording.
    """

    data: PreparedData
    recordings: tuple[Recording, ...]
    segments: tuple[Segments, ...]
    target: tuple[np.ndarray, ...]


def follow_horizons(side: ForceSide, point: Point, covariance: np.ndarray, library: Library) -> Point:
    """Move the numbers of named effects to where the model follows recordings best.

    Args:
      side: recordings to fit.
      point: named effects with the numbers of forces, and calibration; what is 0 of it stays so.
      covariance: (p + n, p + n) of both.
      library: of the search.

    Returns:
      The point with other numbers; the same one where no horizon is followed.
    """
    data = side.stretches.data
    seen = np.flatnonzero(data.measured[: data.recordings[0].model.nv])
    size = motion_size(data)[seen]
    longest = min(float(np.ptp(r.time)) for r in data.recordings)
    numbers = _Numbers.of(point, library)
    if not len(numbers.free):
        return point
    samples = SAMPLES * _NUMBERS // max(_NUMBERS, len(numbers.free))
    covariance = covariance[np.ix_(numbers.free, numbers.free)]
    horizon, best = _SHORTEST, point
    while horizon < _LONGER * longest:
        trial = cut_horizons(data, min(horizon, longest), samples)
        errors, step_errors = _errors_at(trial, best.hypothesis(library), side.counter)
        rms = np.sqrt(np.median(np.concatenate([(e[..., seen] ** 2).mean(1) for e in errors]), 0))
        if not np.all(rms < FOLLOWS * size):
            break
        scale = seen, rms, FOLLOWS * size
        best, covariance = _nearest(side, trial, best, numbers.at(best), covariance, scale, (errors, step_errors))
        horizon *= _LONGER
    return best


def cut_horizons(data: PreparedData, horizon: float, samples: float = np.inf) -> Horizon:
    """Cut recordings into simulations over a horizon [s], as many as fit one behind the other.

    Where there is room, the first one begins where the smoothed state has samples on either side: at the end of a
    recording a polynomial is extrapolated, whose velocity errs by many times the noise. So they may overlap a little.

    Args:
      data: recordings.
      horizon: recordings that are shorter are simulated as a whole.
      samples: of all simulations at most; of more, some are left out, evenly.
    """
    interval = float(np.median(np.concatenate([np.diff(r.time) for r in data.recordings])))
    count = max(1, round(min(horizon / interval, max(len(r.time) for r in data.recordings))))
    lengths = [min(count, len(r.time) - 1) for r in data.recordings]
    lasts = [len(r.time) - 1 - n for r, n in zip(data.recordings, lengths, strict=True)]
    firsts = [
        np.linspace(min(data.span.half, last), last, last // (n + 1) + 1).astype(int)
        for last, n in zip(lasts, lengths, strict=True)
    ]
    total = sum(len(first) * (n + 1) for first, n in zip(firsts, lengths, strict=True))
    every, passed = max(1, int(np.ceil(total / samples))), 0
    recordings, segments, target = [], [], []
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        own, first = lengths[i], firsts[i][-passed % every :: every]
        passed += len(firsts[i])
        if not len(first):
            continue
        index = first[:, None] + np.arange(own + 1)
        qpos, qvel, _ = smooth(recording.model, track, first, data.sigma, data.span)
        time = recording.time[index]
        act = data.acts[i][first] if recording.model.na else None
        same = np.full(len(first), i)
        segments.append(Segments(time[:, 0], qpos, qvel, time - time[:, :1], data.commands, same, act))
        target.append(recording.qpos[index])
        recordings.append(recording)
    return Horizon(data, tuple(recordings), tuple(segments), tuple(target))


def position_errors(
    trial: Horizon, makes: Sequence[Hypothesis], counter: Counter | None = None, factor: float = 1.0
) -> list[list[np.ndarray]]:
    """Errors of positions, a list for each hypothesis, with an array (W, K, nv) for each recording.

    Args:
      trial: what is simulated.
      makes: hypotheses.
      counter: adds up the simulated steps.
      factor: time steps in units of those of the model.
    """
    recordings = trial.recordings
    jobs = [(make(r.model), own) for make in makes for r, own in zip(recordings, trial.segments, strict=True)]
    step = time_step(recordings[0].model, np.concatenate([np.diff(r.time) for r in recordings]), factor)
    found = simulate(jobs, timestep=step, threads=1, counter=counter)
    errors = []
    for n, states in enumerate(found):
        r = n % len(recordings)
        model = recordings[r].model
        away = difference(model, trial.target[r], states[..., : model.nq])
        errors.append(np.nan_to_num(away, nan=_LOST, posinf=_LOST, neginf=-_LOST))
    return [errors[n : n + len(recordings)] for n in range(0, len(errors), len(recordings))]


def steady_errors(trial: Horizon) -> list[np.ndarray]:
    """The same of constant velocity, an array (W, K, nv) for each recording."""
    out = []
    for recording, own, target in zip(trial.recordings, trial.segments, trial.target, strict=True):
        travelled = own.samples[..., None] * own.qvel[:, None]
        out.append(difference(recording.model, target, own.qpos[:, None]) + travelled)
    return out


def _errors_at(trial: Horizon, make: Hypothesis, counter: Counter | None) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Errors of a hypothesis at vanishing time steps, and those that the steps of the simulation make.

    Numbers are not to make up for the time step of a simulation, whose errors are of first order.
    """
    whole, half = (position_errors(trial, [make], counter, factor)[0] for factor in (1.0, 0.5))
    steps = [2 * (a - b) for a, b in zip(whole, half, strict=True)]
    return [a - own for a, own in zip(whole, steps, strict=True)], steps


def motion_size(data: PreparedData) -> np.ndarray:
    """(nv,) standard deviation of positions beside the first of each recording [rad or m]."""
    return np.concatenate([difference(r.model, r.qpos[:1], r.qpos) for r in data.recordings]).std(0)


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Numbers that are moved: those of named effects, then calibration, without what is 0 of it.

    Attributes:
      free: (m,) their indices among all p + n.
      low, high, step, value: (m,) bounds, step of differences, and value of each.
    """

    free: np.ndarray
    low: np.ndarray
    high: np.ndarray
    step: np.ndarray
    value: np.ndarray

    @classmethod
    def of(cls, point: Point, library: Library) -> "_Numbers":
        rows = [
            (p.low, p.high, 0.1 * abs(p.step), v)
            for candidate, values in point.named
            for p, v in zip(candidate.parameters, values, strict=True)
        ]
        for entry, reach, v in zip(library.calibrated, library.calibration.reach, point.calibration, strict=True):
            rows.append((-reach, reach, 0.1 * abs(library.numbers[entry.columns[0][0]].step), v))
        low, high, step, value = np.array(rows).reshape(-1, 4).T
        free = np.flatnonzero((np.arange(len(rows)) < point.numbers) | (value != 0))
        return cls(free, low[free], high[free], step[free], value[free])

    def at(self, point: Point) -> "_Numbers":
        """The same numbers with their values at a point."""
        values = np.concatenate([*(own for _, own in point.named), point.calibration])
        return replace(self, value=values[self.free])

    def moved(self, point: Point, values: np.ndarray) -> Point:
        """A point with values (m,) instead of those of this one."""
        change, p = np.zeros(point.numbers + len(point.calibration)), point.numbers
        change[self.free] = values - self.value
        return point.moved(change[:p], point.calibration + change[p:])


def _nearest(
    side: ForceSide,
    trial: Horizon,
    point: Point,
    numbers: _Numbers,
    covariance: np.ndarray,
    scale: tuple[np.ndarray, np.ndarray, np.ndarray],
    errors: tuple[list[np.ndarray], list[np.ndarray]],
) -> tuple[Point, np.ndarray]:
    """The point nearest to the data over one horizon, and the covariance of its numbers.

    Args:
      side: counts the steps.
      trial: the horizon.
      point: what forces and shorter horizons say.
      numbers: of the point, which are moved.
      covariance: (m, m) of them.
      scale: coordinates that were measured, the size of their errors, and the largest error of what is followed.
      errors: of the point, see `_errors_at`; those of the time steps stay, since numbers move by little.
    """
    low, high, step, start = numbers.low, numbers.high, numbers.step, numbers.value
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T
    seen, rms, most = scale

    # A simulation that is lost, as a pendulum that passes its top on the other side, counts as one at the bound.
    lost = [((e[..., seen] / most) ** 2).mean((1, 2), keepdims=True) for e in errors[0]]
    weights = [1 / np.sqrt(np.maximum(own, 1.0)) for own in lost]

    def residual(values: np.ndarray, found: Sequence[np.ndarray]) -> np.ndarray:
        """(N,): each simulation counts as one measured value per joint, since its errors go together."""
        pairs = zip(found, weights, strict=True)
        own = [(e[..., seen] * w / rms / np.sqrt(e.shape[1])).ravel() for e, w in pairs]
        return np.concatenate([*own, root @ (values - start)])

    def residuals(many: Sequence[np.ndarray]) -> list[np.ndarray]:
        hypotheses = [numbers.moved(point, values).hypothesis(side.library) for values in many]
        rows = position_errors(trial, hypotheses, side.counter)
        exact = ([a - own for a, own in zip(row, errors[1], strict=True)] for row in rows)
        return [residual(values, own) for values, own in zip(many, exact, strict=True)]

    at, own = start, residual(start, errors[0])
    steps = np.where(start + step <= high, step, -step)
    # One set of derivatives serves all steps: numbers move by little.
    slopes = (np.array(residuals(list(start + np.diag(steps)))) - own).T / steps
    for _ in range(_STEPS):
        trial_at = np.clip(at - np.linalg.lstsq(slopes, own)[0], low, high)
        (after,) = residuals([trial_at])
        if not after @ after < own @ own:
            break
        at, own = trial_at, after
    return numbers.moved(point, at), np.linalg.inv(slopes.T @ slopes)
