"""Numbers of what was named, from all recordings, and intervals that do not assume a good fit.

What was held out has done its work when a name stands: the numbers that are reported may use it, too. One Gauss-Newton
step over all windows leads to them from those that were fitted, and is taken where true simulation agrees. Starting
states that suit one size still speak for it, so that smaller and larger ones are tried with starting states of their
own, which they then share. Intervals are those of the same linearised fit on resampled windows.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import answers, nudges
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, nearest
from btr_mjx.gap.inference.search.walks import scaled
from btr_mjx.gap.results import Estimate
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Evidence, fit, regularised, window_weight

_DRAWS = 200
_QUANTILES = (0.05, 0.95)

_SHARES = 1.0, 0.4
"""Parts of a step that are tried."""

_SIZES = 0.8, 1.25
"""Factors on an effect's size at which it is tried as well."""

_BEYOND = 0.2
"""Part of the range of these by which a better one may lie outside."""

_STRONG = 400.0
"""Gain beyond which these sizes differ by more than chance does."""

_MANY = 6
"""So many recordings to fit are drawn as a whole."""


def intervals(bench: Bench, judged: Judged, rng: np.random.Generator, settled: bool = False) -> list[Estimate]:
    """Estimates of all numbers of a hypothesis' effects, in order.

    Windows are drawn again with repetition, whole recordings together where there are enough of them, and the fit is
    solved again with the tolerances; what the tolerances' prior leaves open is added.

    Args:
      bench: of the search.
      judged: the hypothesis.
      rng: for the draws.
      settled: its numbers are reported as they are.
    """
    data, precision, w = _evidence(bench, judged)
    size, count = len(judged.refined.values), len(w)
    own, far = (side.windows.recording for side in judged.sides)
    labels = np.concatenate([own, own.max() + 1 + far]) if len(np.unique(own)) >= _MANY else np.arange(count)
    blocks = [np.flatnonzero(labels == label) for label in np.unique(labels)]

    def solve(share: np.ndarray) -> np.ndarray:
        normal = np.tensordot(share * w, data.gram, 1)
        return np.linalg.solve(regularised(normal + np.diag(precision)), -((share * w) @ data.moment))[:size]

    centre = solve(np.ones(count))
    draws = np.empty((_DRAWS, size))
    for i in range(_DRAWS):
        picked = rng.integers(0, len(blocks), len(blocks))
        share = np.zeros(count)
        for block in picked:
            share[blocks[block]] += 1.0
        draws[i] = solve(share) - centre
    normal = (np.tensordot(w, data.gram, 1) + np.diag(precision)) / bench.dispersion
    shown = np.diag(normal)[:size] > 0
    posterior = np.linalg.inv(regularised(normal))[:size, :size]
    extra = np.sqrt(np.maximum(np.diag(posterior), 0.0)) * rng.standard_normal((_DRAWS, size))
    spread = draws + extra
    final = judged.hypothesis
    if not settled and not bench.joint:  # believed numbers would move along
        final = _stepped(bench, judged, centre)
        if judged.gain + judged.held_out > _STRONG and not bench.costly():
            final = _sized(bench, judged, final)
    out, first = [], size - final.numbers
    for candidate, values in final.effects:
        for parameter, value in zip(candidate.parameters, values, strict=True):
            low, high = np.quantile(spread[:, first], _QUANTILES) if shown[first] else (-np.inf, np.inf)
            out.append(
                Estimate(
                    float(value),
                    float(np.clip(value + low, parameter.low, parameter.high)),
                    float(np.clip(value + high, parameter.low, parameter.high)),
                    parameter.unit,
                    float(parameter.null),
                    parameter.at_edge(float(value)),
                )
            )
            first += 1
    return out


def _evidence(bench: Bench, judged: Judged) -> tuple[Evidence, np.ndarray, np.ndarray]:
    """Of both sides of the split, on a hypothesis' numbers, then the nuisances; their precisions, and weights (W,)."""
    free = unknowns(judged.hypothesis, bench.joint, bench.delicate)
    values = judged.hypothesis.values(bench.joint)
    steps = nudges(free, values)
    found = judged.sides[1].windows.residuals([free.make(values + step) for step in steps])
    columns = answers(free, judged.residual, found, steps)
    data = _both(bench, judged, (judged.refined.residual, judged.residual), (judged.refined.columns, columns))
    precision = np.concatenate([np.zeros(len(values)), bench.free(judged.sides[0], judged.hypothesis).precision])
    return data, precision, window_weight(np.concatenate([judged.refined.chi2, judged.fits[1].chi2]), bench.cut)


def _both(bench: Bench, judged: Judged, residuals: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> Evidence:
    """Evidence of both sides' residuals on columns of theirs, followed by the nuisances, which they share."""
    nuisances = bench.free(judged.sides[0], judged.hypothesis), bench.nuisance(judged.sides[1], judged.hypothesis)
    own, far = (n.evidence(r, c) for n, r, c in zip(nuisances, residuals, columns, strict=True))
    more = own.n - far.n  # what may be refitted is refitted on the one side only
    moment, gram = np.pad(far.moment, ((0, 0), (0, more))), np.pad(far.gram, ((0, 0), (0, more), (0, more)))
    pairs = (own.energy, far.energy), (own.moment, moment), (own.gram, gram)
    return Evidence(*(np.concatenate(pair) for pair in pairs))


def _loss(bench: Bench, judged: Judged, residuals: Sequence[np.ndarray]) -> float:
    """Of both sides' residuals, with what is fitted along."""
    nothing = [np.zeros((0, *residual.shape)) for residual in residuals]
    return fit(
        _both(bench, judged, residuals, nothing), bench.free(judged.sides[0], judged.hypothesis).precision, bench.cut
    ).loss


def _stepped(bench: Bench, judged: Judged, step: np.ndarray) -> Hypothesis:
    """The hypothesis after a step of its numbers, or as it was where all recordings say less of it then."""
    free = unknowns(judged.hypothesis, bench.joint, bench.delicate)
    before = _loss(bench, judged, (judged.refined.residual, judged.residual))
    for share in _SHARES:
        values = np.clip(judged.refined.values + share * step, free.low, free.high)
        there = judged.hypothesis.replaced(values, bench.joint)
        if _loss(bench, judged, [side.windows.residuals([there])[0] for side in judged.sides]) < before:
            return there
    return judged.hypothesis


def _sized(bench: Bench, judged: Judged, hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with each effect at a better size; what moves contacts has been through sizes before."""
    for index, (candidate, _) in enumerate(hypothesis.effects):
        if candidate.name not in bench.delicate:
            hypothesis = _resized(bench, judged, hypothesis, index)
    return hypothesis


def _resized(bench: Bench, judged: Judged, hypothesis: Hypothesis, index: int) -> Hypothesis:
    """The hypothesis with one effect at the size, of those around it, that all recordings say most of.

    Where a size goes, what the time step does goes along: it is found anew for each.
    """
    tries: list[Hypothesis] = []
    pools: tuple[list[Side], list[Side]] = [], []

    def attempt(factor: float) -> None:
        own = scaled(hypothesis, factor, index)

        def suited(side: Side, pool: list[Side]) -> Side:
            start = nearest([other.based(own) for other in pool or [side]])
            return nearest([start, start.recentred(own)])

        found = run_in_threads([partial(suited, side, pool) for side, pool in zip(judged.sides, pools, strict=True)])
        for pool, side in zip(pools, found, strict=True):
            pool.append(side)
        tries.append(own)

    def losses() -> list[float]:
        def loss(i: int) -> float:
            # Those before it were looked at already.
            pair = [nearest([pool[i], *(later.based(tries[i]) for later in pool[i + 1 :])]) for pool in pools]
            return _loss(bench, judged, [side.windows.residual for side in pair])

        return run_in_threads([partial(loss, i) for i in range(len(tries))])

    for factor in (1.0, *_SIZES):
        attempt(factor)
    attempt(lowest((1.0, *_SIZES), losses()))
    return tries[int(np.argmin(losses()))]


def lowest(at: Sequence[float], losses: Sequence[float]) -> float:
    """Where a parabola through three points is lowest, not far beyond them; the lowest of them where it is not bent."""
    a, b, _ = np.polyfit(at, losses, 2)
    reach = _BEYOND * (max(at) - min(at))
    if a <= 0:
        return at[int(np.argmin(losses))]
    return float(np.clip(-b / (2 * a), min(at) - reach, max(at) + reach))
