"""Whole recordings, simulated open loop from their first sample, where motion is not chaotic.

Windows say what is missing; their starting states are free and their velocities count. Where no model comes near the
noise, the numbers that are best for windows are not those that follow the whole motion, and the latter are reported.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.hypotheses import unknowns
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.simulate import Counter, Segments, simulate
from btr_mjx.gap.windows import MakeWorld, PreparedData, smooth
from btr_mjx.models import difference

_EVALUATIONS = 8
"""Simulations of the recordings that the numbers may take, beside their derivatives."""


def open_loop(bench: Bench, makes: Sequence[MakeWorld]) -> list[float]:
    """Mean absolute position error over whole held-out recordings [rad or m]; NaN where the robot touches the world.

    Args:
      bench: of the search.
      makes: hypotheses.
    """
    if bench.survey.contact:
        return [float("nan")] * len(makes)
    return [float(np.mean(errors)) for errors in recording_errors(bench.test.windows.data, makes, bench.counter)]


def followed(bench: Bench, hypothesis: Hypothesis) -> Hypothesis:
    """A hypothesis with the numbers that follow the whole recordings to fit best: least squares of their positions.

    They belong to the model's own time step, with which the mended model is used.

    Args:
      bench: of the search, of a robot that does not touch the world.
      hypothesis: where to start.
    """
    data = bench.fit.windows.data
    free = unknowns(hypothesis, bench.joint, bench.contact_sensitive)
    if not len(free.low):
        return hypothesis
    sigma = np.where(data.measured, data.sigma, np.inf)[: bench.fit.windows.nv]

    def errors(many: Sequence[np.ndarray]) -> np.ndarray:
        """(n, N) position errors in units of the noise."""
        found = _errors(data, [free.make(values) for values in many], bench.counter)
        return np.array([np.concatenate([(e / sigma).reshape(-1) for e in row]) for row in found])

    def slopes(values: np.ndarray) -> np.ndarray:
        steps = np.diag(np.where(values + free.step <= free.high, free.step, -free.step))
        moved = errors([values, *(values + steps)])
        return ((moved[1:] - moved[0]) / np.diag(steps)[:, None]).T

    start = np.clip(hypothesis.values(bench.joint), free.low, free.high)
    found = scipy.optimize.least_squares(
        lambda values: errors([values])[0],
        start,
        slopes,
        bounds=(free.low, free.high),
        x_scale=free.high - free.low,
        max_nfev=_EVALUATIONS,
        ftol=1e-3,
    )
    return hypothesis.replaced(found.x, bench.joint)


def following(bench: Bench, judged: Judged) -> Judged:
    """A judged hypothesis with the numbers that follow whole recordings best, judged on the same windows.

    Args:
      bench: of the search, of a robot that does not touch the world.
      judged: what was found.
    """
    hypothesis = followed(bench, judged.hypothesis)
    residual = judged.sides[0].windows.residuals([hypothesis])[0]
    own = bench.free(judged.sides[0], hypothesis).profile(residual, bench.cut)
    values = hypothesis.values(bench.joint)
    refined = replace(judged.refined, values=values, residual=residual, loss=own.loss, chi2=own.chi2)
    return bench.judge([hypothesis], [refined], judged.sides, judged.references)[0]


def recording_errors(data: PreparedData, makes: Sequence[MakeWorld], counter: Counter | None = None) -> np.ndarray:
    """Mean absolute position error of hypotheses over whole recordings (hypotheses, recordings) [rad or m]."""
    errors = _errors(data, makes, counter)
    seen = data.measured[: data.recordings[0].model.nv]
    return np.array([[float(np.mean(np.abs(e[:, seen]))) for e in row] for row in errors])


def _errors(data: PreparedData, makes: Sequence[MakeWorld], counter: Counter | None) -> list[list[np.ndarray]]:
    """Position errors (K, nv) of hypotheses over whole recordings, from the smoothed first sample."""
    starts = []
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        qpos, qvel, _ = smooth(recording.model, track, np.array([0]), data.sigma, data.span)
        act = data.acts[i][:1] if recording.model.na else None
        since = (track.time - track.time[0])[None]
        starts.append(Segments(track.time[:1], qpos, qvel, since, data.commands, np.array([i]), act))
    jobs = [(make(r.model), s) for make in makes for r, s in zip(data.recordings, starts, strict=True)]
    found = simulate(jobs, counter=counter)
    out: list[list[np.ndarray]] = []
    for n, states in enumerate(found):
        i = n % len(data.recordings)
        if i == 0:
            out.append([])
        recording = data.recordings[i]
        away = difference(recording.model, recording.qpos, states[0, :, : recording.model.nq])
        out[-1].append(np.nan_to_num(away, nan=1e3))
    return out
