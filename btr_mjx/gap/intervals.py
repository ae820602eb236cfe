"""Intervals of parameters that do not assume a good fit: the refined fit, linearised, on resampled windows."""

import numpy as np

from btr_mjx.gap.diagnosis import Estimate
from btr_mjx.gap.score import weight
from btr_mjx.gap.search import Bench, Judged

_DRAWS = 200
_QUANTILES = (0.05, 0.95)


def intervals(bench: Bench, judged: Judged, rng: np.random.Generator) -> list[Estimate]:
    """Estimates of all numbers of a hypothesis' effects, in order.

    Windows are drawn again with repetition, whole recordings together where there are enough of them, and the fit is
    solved again with the tolerances; what the tolerances' prior leaves open is added.

    Args:
      bench: of the search.
      judged: the hypothesis.
      rng: for the draws.
    """
    windows = judged.sides[0].windows
    nuisance = bench.free(judged.sides[0])
    data = nuisance.evidence(judged.refined.residual, judged.refined.columns)
    size, count = len(judged.refined.values), len(windows)
    precision = np.concatenate([np.zeros(size), nuisance.precision])
    w = weight(judged.refined.chi2, bench.cut)
    labels = windows.recording if len(np.unique(windows.recording)) >= 6 else np.arange(count)
    blocks = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    ridge = 1e-9 * np.eye(data.n)

    def solve(share: np.ndarray) -> np.ndarray:
        normal = np.tensordot(share * w, data.gram, 1)
        normal = normal + np.diag(precision) + ridge * np.trace(normal)
        return np.linalg.solve(normal, -((share * w) @ data.moment))[:size]

    centre = solve(np.ones(count))
    draws = np.empty((_DRAWS, size))
    for i in range(_DRAWS):
        picked = rng.integers(0, len(blocks), len(blocks))
        share = np.zeros(count)
        for block in picked:
            share[blocks[block]] += 1.0
        draws[i] = solve(share) - centre
    normal = (np.tensordot(w, data.gram, 1) + np.diag(precision)) / bench.dispersion
    posterior = np.linalg.inv(normal + ridge * np.trace(normal))[:size, :size]
    extra = np.sqrt(np.maximum(np.diag(posterior), 0.0)) * rng.standard_normal((_DRAWS, size))
    spread = draws + extra
    out, first = [], size - judged.hypothesis.numbers
    for candidate, values in judged.hypothesis.effects:
        for parameter, value in zip(candidate.parameters, values, strict=True):
            low, high = np.quantile(spread[:, first], _QUANTILES)
            out.append(
                Estimate(
                    float(value),
                    float(np.clip(value + low, parameter.low, parameter.high)),
                    float(np.clip(value + high, parameter.low, parameter.high)),
                    parameter.unit,
                    float(parameter.null),
                )
            )
            first += 1
    return out
