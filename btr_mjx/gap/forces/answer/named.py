"""Named effects with intervals, and the candidates beside them."""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.effects import equation_of
from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.points import QUANTILE, covariance, names
from btr_mjx.gap.forces.search import SearchRound
from btr_mjx.gap.results import (
    Estimate,
    NamedEffect,
    RankedCandidate,
)

ALIKE = 6.0
"""Difference of scores below which two candidates are alike: a factor of twenty in odds."""


def named_by_forces(found: SearchOutcome) -> tuple[NamedEffect, ...]:
    """Named effects with intervals.

    Args:
      found: by the search.
    """
    last = found.chain[-1]
    spread = np.sqrt(np.diag(covariance(found.side, last)))
    scores = [a.loss - b.loss for a, b in zip(found.chain[:-1], found.chain[1:], strict=True)]
    held = float((found.held_out[0].loss - found.held_out[1].loss).sum())
    out, i = [], 0
    for k, (candidate, values) in enumerate(last.point.named):
        parameters = {}
        for own, value in zip(candidate.parameters, values, strict=True):
            half = QUANTILE * spread[i]
            low, high = (float(np.clip(value + s * half, own.low, own.high)) for s in (-1, 1))
            parameters[own.name] = Estimate(value, low, high, own.unit, float(own.null), own.at_edge(value))
            i += 1
        score = scores[min(k, len(scores) - 1)] if scores else 0.0
        rivals = alternatives_of(round_of(found, candidate.name))
        own_names = names(last.point.named)
        out.append(
            NamedEffect(
                candidate.effect.name,
                candidate.place.label,
                parameters,
                float(score),
                held,
                tuple(name for name in rivals if name not in own_names) if candidate.name in rivals else (),
                candidate.effect.excited_by,
                equation_of(candidate, values),
                equation_of(candidate, values, latex=True),
            )
        )
    return tuple(out)


def round_of(found: SearchOutcome, name: str) -> SearchRound:
    """The round in which an effect was chosen.

    Args:
      found: by the search.
      name: of its candidate, "effect@place".
    """
    for of in found.rounds:
        if of.finalists and name in names(of.finalists[0][1].point.named) and name not in names(of.before.point.named):
            return of
    return found.rounds[0]


def alternatives_of(of: SearchRound) -> tuple[str, ...]:
    """Names of finalists that the data cannot tell from the best one, which comes first.

    What every drive has is tried as several effects together: none of them alone is an alternative.

    Args:
      of: the round.
    """
    if not of.finalists:
        return ()
    best = of.finalists[0][0]
    given = set(names(of.before.point.named))
    out: list[str] = []
    for score, fit in of.finalists:
        if score > 0 and best - score <= ALIKE:
            new = [name for name in names(fit.point.named) if name not in given]
            out += new if len(new) == 1 else []
    return tuple(dict.fromkeys(out))


def ranking_by_forces(rounds: Sequence[SearchRound]) -> tuple[RankedCandidate, ...]:
    """Rows of all rounds: refined candidates, then those that were scanned only.

    Args:
      rounds: of the search.
    """
    rows = []
    for of in rounds:
        given = names(of.before.point.named)
        seen: set[str] = set()
        scored = []
        for score, fit in of.finalists:
            new = [(c, v) for c, v in fit.point.named if c.name not in given]
            together = tuple(c.name for c, _ in new) if len(new) > 1 else ()
            scored += [(score, c, v, together) for c, v in new]
        scored += [(lead.score, lead.candidate, lead.values, ()) for lead in of.leads]
        best = max((row[0] for row in scored), default=0.0)
        for score, candidate, values, together in scored:
            if candidate.name in seen:
                continue
            seen.add(candidate.name)
            rows.append(
                RankedCandidate(
                    candidate.effect.name,
                    candidate.place.label,
                    float(score),
                    float(best - score),
                    float(score),
                    None,
                    {p.name: float(v) for p, v in zip(candidate.parameters, values, strict=True)},
                    tuple(given),
                    together,
                )
            )
    return tuple(rows)
