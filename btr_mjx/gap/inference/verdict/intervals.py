"""Numbers of what was named, from all recordings, and intervals that do not assume a good fit.

What was held out has done its work when a name stands: the numbers that are reported may use it, too. One Gauss-Newton
step over all windows leads to them from those that were fitted, and is taken where true simulation agrees. Intervals
are those of the same linearised fit on resampled windows.
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.hypotheses import unknowns
from btr_mjx.gap.inference.scoring.refine import answers, nudges
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.results import Estimate
from btr_mjx.gap.windows import Evidence, fit, regularised, window_weight

_DRAWS = 200
_QUANTILES = (0.05, 0.95)

_SHARES = 1.0, 0.4
"""Parts of a step that are tried."""

_MANY = 6
"""So many recordings to fit are drawn as a whole."""


def intervals(bench: Bench, judged: Judged, rng: np.random.Generator) -> list[Estimate]:
    """Estimates of all numbers of a hypothesis' effects, in order.

    Windows are drawn again with repetition, whole recordings together where there are enough of them, and the fit is
    solved again with the tolerances; what the tolerances' prior leaves open is added.

    Args:
      bench: of the search.
      judged: the hypothesis.
      rng: for the draws.
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
    if not bench.joint:  # believed numbers would move along
        final = _stepped(bench, judged, centre)
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
    free = unknowns(judged.hypothesis, bench.joint, bench.contact_sensitive)
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
    free = unknowns(judged.hypothesis, bench.joint, bench.contact_sensitive)
    before = _loss(bench, judged, (judged.refined.residual, judged.residual))
    for share in _SHARES:
        values = np.clip(judged.refined.values + share * step, free.low, free.high)
        there = judged.hypothesis.replaced(values, bench.joint)
        if _loss(bench, judged, [side.windows.residuals([there])[0] for side in judged.sides]) < before:
            return there
    return judged.hypothesis
