"""Forward selection of effects, and backward elimination."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.forces.filtering import Variances, filtered
from btr_mjx.gap.forces.points import Fitted, Point, Side, evaluate, refined, step_of, with_variances
from btr_mjx.gap.forces.scan import Lead, price, scan

_FINALISTS = 5
"""Leads of a scan whose numbers are refined."""


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the search.

    Attributes:
      before: the hypothesis to which one more effect was sought.
      leads: of the scan, best first.
      finalists: refined leads with their scores, best first.
    """

    before: Fitted
    leads: tuple[Lead, ...]
    finalists: tuple[tuple[float, Fitted], ...]


def first_variances(side: Side, base: Hypothesis) -> Variances:
    """A first guess: what the believed model leaves is a random force."""
    from btr_mjx.gap.forces.motion import linearise

    linear = linearise(side.stretches, base, side.counter)
    force = np.einsum("skij,skj->ski", np.linalg.pinv(linear.force), linear.defect)
    interval = float(np.median(linear.interval))
    return Variances(
        side.stretches.sigma**2, (0.02 * interval) ** 2, (force**2).mean((0, 1)) + 1e-18, max(0.1, 4 * interval)
    )


def start(side: Side, base: Hypothesis, note: Callable[[str], None] = lambda _: None) -> Fitted:
    """The believed model with calibration and variances at their best."""
    point = Point(base, (), np.zeros(len(side.library.calibrated)))
    fit = evaluate(side, point, first_variances(side, base))
    fit = with_variances(side, fit)
    return with_variances(side, refined(side, fit.point, fit.variances))


def one_more(side: Side, fit: Fitted) -> Round:
    """Look for one more effect beside a fitted point."""
    library = side.library
    count = fit.whitened.count * len(side.stretches)
    p = fit.point.numbers
    own = fit.columns[..., :p]
    whitened = filtered(fit.linear, np.concatenate([side.columns, own], -1), fit.variances)
    gram = whitened.gram.sum(0)
    c = len(library.numbers)
    given = np.zeros((c + p, p))
    given[c + np.arange(p), np.arange(p)] = 1.0
    calibration = replace(
        library.calibration,
        design=np.concatenate([library.calibration.design, np.zeros((p, len(library.calibrated)))]),
        at=fit.point.calibration,
    )
    padded = [replace(entry) for entry in library.entries if entry.candidate.name not in _named(fit.point)]
    steps = [number.step for number in library.numbers] + [1.0] * p
    base, leads = scan(gram, padded, steps, given, calibration, count)
    finalists = []
    choices = len({entry.candidate.name for entry in library.entries})
    for lead in [lead for lead in leads if lead.score > 0][:_FINALISTS]:
        moved = fit.point.moved(lead.changes, lead.calibration)
        start_at = replace(moved, named=(*moved.named, (lead.candidate, lead.values)))
        found = refined(side, start_at, fit.variances)
        gain = fit.loss - found.loss
        finalists.append((gain - price(len(lead.values), count, choices), found))
    finalists.sort(key=lambda row: -row[0])
    return Round(fit, tuple(leads), tuple(finalists))


def _named(point: Point) -> set[str]:
    return {candidate.name for candidate, _ in point.named}


def select(side: Side, base: Hypothesis, most: int, note: Callable[[str], None]) -> tuple[list[Round], list[Fitted]]:
    """Search for one effect after another.

    Returns:
      The rounds, and the fitted points: the believed model, then with one more effect each.
    """
    note("variances")
    chain, rounds = [start(side, base)], []
    while len(chain) <= most:
        note("one more effect" if rounds else "effects")
        rounds.append(one_more(side, chain[-1]))
        if not rounds[-1].finalists or rounds[-1].finalists[0][0] <= 0:
            break
        chain.append(with_variances(side, rounds[-1].finalists[0][1]))
    return rounds, chain
