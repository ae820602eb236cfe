"""What is done where no leader comes near the noise: all kinds of effects are tried, and leaders refined further.

Far from the truth the linear picture misleads about kinds, and still more about places: rotors that are three times as
heavy as believed look like springs, and the best six of a scan may all be springs.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.inference.scoring.refine import Refined
from btr_mjx.gap.inference.scoring.scanner import Lead, Scanner
from btr_mjx.gap.inference.search.search_records import Side, Started
from btr_mjx.gap.windows import Fit, Options, Survey

_FAR = 3.0
"""Chi^2 per degree of freedom of the best leader above which this is done."""

_TIMES, _NEARER = 4, 0.7
"""Times that leaders are refined again where none comes near the noise, and what each of them must leave of chi^2 for
another one. A delay of 6 ms was 6.7 ms, and 69 was left of 932 where 2 is, after the first time."""


class Searching(Protocol):
    """What is needed of a `search.Bench`."""

    base: Hypothesis
    candidates: list[Candidate]
    dispersion: float
    fit: Side
    options: Options
    reference: tuple[Fit, Fit]
    scanner: Scanner
    survey: Survey

    @property
    def joint(self) -> bool:
        """See `Bench`."""
        ...

    def settle(self, best: Any) -> None:
        """See `Bench`."""
        ...

    def started(self, start: Hypothesis, candidate: Candidate, values: Sequence[np.ndarray]) -> Started:
        """See `Bench`."""
        ...

    def refined(self, side: Side, hypotheses: Sequence[Started], count: Sequence[int], reference: Fit) -> list[Refined]:
        """See `Bench`."""
        ...

    def linearise_around(self, hypothesis: Hypothesis) -> None:
        """See `Bench`."""
        ...


def nearer(
    bench: Searching,
    leads: Sequence[Lead],
    hypotheses: Sequence[Started],
    found: list[Refined],
) -> tuple[list[Started], list[Refined]]:
    """Leaders of the first round after more has been done to come near the noise, if they were far from it.

    The dispersion of the bench is what is left in the end.

    Args:
      bench: of the search.
      leads: of the linear scan, best first.
      hypotheses: the leaders with their starts.
      found: what their refinement led to.

    Returns:
      Leaders with their starts, more of them perhaps, and what their refinement led to.
    """
    hypotheses = list(hypotheses)
    if bench.dispersion <= _FAR:
        return hypotheses, found
    kinds = {own.effects[-1][0].effect.name for own, _ in hypotheses}
    more = []
    for lead in leads:
        candidate = bench.scanner.screened.entries[lead.index].candidate
        if candidate.effect.name not in kinds and lead.gain > 0:
            kinds.add(candidate.effect.name)
            more.append(bench.started(bench.base, candidate, [lead.values]))
    hypotheses, found = _with(bench, hypotheses, found, more)
    if not bench.survey.contact:
        found = _refined_further(bench, hypotheses, found)
    best = min(range(len(found)), key=lambda i: found[i].loss)
    leader = hypotheses[best][0].replaced(found[best].values, bench.joint)
    return _with(bench, hypotheses, found, _at_other_places(bench, leader))


def _with(
    bench: Searching, hypotheses: list[Started], found: list[Refined], more: list[Started]
) -> tuple[list[Started], list[Refined]]:
    """Leaders and more of them, refined, each candidate once; the dispersion is that of the best."""
    rows = {own.name: (own, refined) for (own, _), refined in zip(hypotheses, found, strict=True)}
    starts = {own.name: values for own, values in [*more, *hypotheses]}
    again = bench.refined(bench.fit, more, [bench.options.iterations] * len(more), bench.reference[0])
    for (own, _), refined in zip(more, again, strict=True):
        if own.name not in rows or refined.loss < rows[own.name][1].loss:
            rows[own.name] = own, refined
    bench.settle(min((refined for _, refined in rows.values()), key=lambda refined: refined.loss).chi2)
    return [(own, starts[own.name]) for own, _ in rows.values()], [refined for _, refined in rows.values()]


def _at_other_places(bench: Searching, leader: Hypothesis) -> list[Started]:
    """The leader's effect at places that share joints with its own, with its numbers there."""
    candidate, values = leader.effects[-1]
    moved = [(other, transferred(candidate, values, other)) for other in bench.candidates if other is not candidate]
    return [bench.started(bench.base, other, [start]) for other, start in moved if start is not None]


def transferred(candidate: Candidate, values: Sequence[float], other: Candidate) -> np.ndarray | None:
    """Numbers of an effect at one place as numbers of it at another; None where the places share nothing.

    Args:
      candidate: an effect at a place.
      values: its numbers.
      other: another candidate.

    Returns:
      (p,) numbers of the other one: those of single joints or actuators, or their mean over a group.
    """
    labels = candidate.place.members or (candidate.place.label,)
    theirs = other.place.members or (other.place.label,)
    if other.effect is not candidate.effect or set(labels).isdisjoint(theirs):
        return None
    if not candidate.place.parts and not other.place.parts:
        return np.array(values)
    known = dict(zip(labels, values if candidate.place.parts else np.full(len(labels), values[0]), strict=True))
    nulls = other.null if other.place.parts else np.full(len(theirs), other.null[0])
    moved = np.array([known.get(label, null) for label, null in zip(theirs, nulls, strict=True)])
    return moved if other.place.parts else moved[[label in known for label in theirs]].mean(keepdims=True)


def _refined_further(bench: Searching, hypotheses: Sequence[Started], found: list[Refined]) -> list[Refined]:
    """Leaders refined on, each time in windows that are linearised around the best, of a robot that touches nothing.

    A few steps from far away do not lead to the best size, starting states of the believed model tell little beside
    it, and while nothing comes near the noise what is left passes for noise, which makes every further step look small.
    """
    for _ in range(_TIMES):
        before = bench.dispersion
        if before <= _FAR:
            break
        best = min(range(len(found)), key=lambda i: found[i].loss)
        bench.linearise_around(hypotheses[best][0].replaced(found[best].values, bench.joint))
        starts = [(own, [refined.values]) for (own, _), refined in zip(hypotheses, found, strict=True)]
        found = bench.refined(bench.fit, starts, [bench.options.iterations] * len(starts), bench.reference[0])
        bench.settle(min(found, key=lambda refined: refined.loss).chi2)
        if bench.dispersion > _NEARER * before:
            break
    return found
