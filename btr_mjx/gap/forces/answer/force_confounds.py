"""Confounds: what would leave almost the same traces as a named effect."""

import numpy as np

from btr_mjx.gap.forces.kalman_filter import filtered
from btr_mjx.gap.forces.points import Fitted, ForceSide, names
from btr_mjx.gap.forces.search import library_columns
from btr_mjx.gap.forces.unknowns import BELIEVED
from btr_mjx.gap.results import Confound, confound_sentence

_LEAST = 0.9
"""Correlation from which on a candidate is a confound."""

_LISTED = 3
"""Confounds that are listed for an effect."""


def confounds_of(side: ForceSide, fit: Fitted) -> tuple[Confound, ...]:
    """Candidates whose traces resemble those of named effects, after calibration has taken what it can.

    Args:
      side: the recordings to fit.
      fit: with named effects.
    """
    p = fit.point.numbers
    if fit.stretches.time.shape != side.stretches.time.shape or not p:
        return ()
    every = np.concatenate([library_columns(side, fit), fit.columns[..., :p]], -1)
    gram = filtered(fit.linear, every, fit.variances).gram.sum(0)[1:, 1:]
    c, prior = len(side.library.numbers), side.library.calibration
    believed = [e.candidate.effect.name.startswith(BELIEVED) for e in side.library.calibrated]
    others = ~np.array(believed, bool)
    taken = np.pad(prior.design[:, others], ((0, p), (0, 0)))
    block = taken.T @ gram @ taken + prior.precision[np.ix_(others, others)]
    rest = gram - gram @ taken @ np.linalg.solve(block, taken.T @ gram)
    out: list[Confound] = []
    first = c
    named = {name.partition("@")[0] for name in names(fit.point.named)}
    entries = [e for e in side.library.entries if e.candidate.effect.name not in named]
    entries += [e for e, is_believed in zip(side.library.calibrated, believed, strict=True) if is_believed]
    for candidate, values in fit.point.named:
        signature = np.zeros(len(rest))
        signature[first : first + len(values)] = np.array(values) - candidate.null
        first += len(values)
        # Of an effect the place with fewest numbers: more numbers always fit a little better.
        found: dict[str, tuple[int, float, Confound]] = {}
        size = float(signature @ rest @ signature)
        for entry in entries:
            columns = np.pad(entry.design(c), ((0, p), (0, 0)))
            inner = columns.T @ rest @ columns
            across = columns.T @ rest @ signature
            weights = np.linalg.lstsq(inner, across, rcond=1e-9)[0]
            correlation = float(np.sqrt(max(across @ weights, 0.0) / max(size, 1e-300)))
            if correlation < _LEAST:
                continue
            effect, label = entry.candidate.effect.name, entry.candidate.place.label
            is_believed = effect.startswith(BELIEVED)
            other = effect.removeprefix(BELIEVED) if is_believed else entry.candidate.name
            shown = other if is_believed else effect
            text = confound_sentence(shown, "" if is_believed else label, float(weights[0]), min(correlation, 1.0))
            rank = -len(entry.columns), correlation
            if effect not in found or found[effect][:2] < rank:
                found[effect] = (*rank, Confound(candidate.name, other, min(correlation, 1.0), text))
        best = sorted(found.values(), key=lambda row: -row[1])[:_LISTED]
        out += [confound for _, _, confound in best]
    return tuple(out)
