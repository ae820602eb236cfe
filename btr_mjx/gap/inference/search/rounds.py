"""Rounds of the search: who comes first, one more effect beside it, and its rivals beside that."""

from collections.abc import Callable
from dataclasses import replace

from btr_mjx.gap.inference.search.alone import alone
from btr_mjx.gap.inference.search.calibrated import besides, beyond_calibration, limb_of
from btr_mjx.gap.inference.search.closer import closer
from btr_mjx.gap.inference.search.finer import finer
from btr_mjx.gap.inference.search.naming import SECOND_THRESHOLD, acceptable, accepted, within_calibration
from btr_mjx.gap.inference.search.pairs import told_apart
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.runoff import runoff
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged

BEYOND = 35.0
"""Gain beyond calibration of its limb that a first effect needs there. Two of some two hundred simulated robots that
lacked nothing came to 31. Of seven true names, or twins of them, the two weakest had 10 and 14 and the others 29 to
219; a false one, where a lag was not seen, had 77."""

_HARDLY = 60.0, 120.0
"""Score of a first effect below which a search that has cost much, or too much, looks for no second one: what explains
most of all alone would have to hide one that is worth half of it."""

_POLISHED = 3
"""Times that candidates for one more effect are judged again, at most."""

_ABREAST = 2
"""Such candidates that are judged again at once, where they are close."""

DOUBTFUL = 600.0
"""Score of what moves contacts below which calibration of its limb must not explain as much: a simulated robot that
lacked nothing came to 443 where a leg touched early or late all the time."""

_BESIDES = 3, 1
"""Candidates that are judged again beside calibration that explains the leader, at most; and where much has been spent
already."""

_RIVALS = 2, 1
"""Rivals of the first effect that are tried again beside the second; where much has been spent already."""

_RIVALRY = 0.5
"""Part of the first effect's score that they need."""


def search(bench: Bench, most: int, note: Callable[[str], None]) -> tuple[list[list[Judged]], list[Judged]]:
    """Search for one effect after another.

    Args:
      bench: as it was made.
      most: effects that are named.
      note: called with a word on what is being done.

    Returns:
      Judged candidates of every round, best first, and those that are named, each beside those before.
    """
    note("leaders")
    polish = Polisher(bench)
    rounds = [acceptable(bench, polish(bench.find()), None)]
    if rounds[0] and not bench.costly() and not accepted(bench, rounds[0][0], None):
        rounds[0] = acceptable(bench, polish.ground(rounds[0]), None)
    if rounds[0] and (rounds[0][0].name not in bench.delicate or not accepted(bench, rounds[0][0], None)):
        note("a closer look")
        rounds[0] = acceptable(bench, closer(bench, rounds[0]), None)
    if rounds[0]:
        note("sizes")
        rounds[0] = acceptable(bench, finer(polish, rounds[0]), None)
    if rounds[0] and not within_calibration(bench, rounds[0][0]):
        note("run-off")
        rounds[0] = acceptable(bench, runoff(bench, rounds[0]), None)
    if rounds[0] and accepted(bench, rounds[0][0], None):
        rounds[0] = acceptable(bench, told_apart(bench, rounds[0]), None)
    if rounds[0] and rounds[0][0].score < DOUBTFUL and accepted(bench, rounds[0][0], None):
        note("calibration")
        rounds[0] = _calibrated(bench, rounds[0])
    named: list[Judged] = []
    again = False
    while rounds[-1] and accepted(bench, rounds[-1][0], named[-1] if named else None):
        named.append(rounds[-1][0])
        if len(named) == 2:
            rounds, named = _swapped(bench, polish, rounds, named, note)
            first = _enough(bench, *named)
            if first is not None:
                rounds, named = [[first, *rounds[0][1:]], rounds[1]], [first]
                if again or bench.exhausted():
                    break
                again = True
                rounds.pop()
        if len(named) >= most or named[-1].score < (_HARDLY[bench.exhausted()] if bench.costly() else SECOND_THRESHOLD):
            break
        note("one more effect")
        rounds.append(_beside(bench, polish, named[-1]))
    return rounds, named


def _calibrated(bench: Bench, judged: list[Judged]) -> list[Judged]:
    """A first round whose leader is no name if calibration of its limb explains nearly as much.

    Others are held against the calibrated model then: what really is missing may have been hidden behind it.

    Args:
      bench: of the search.
      judged: best first; the first one may be called by name.
    """
    beyond = beyond_calibration(bench, judged[0])
    if beyond.gain >= BEYOND:
        return judged
    leader = replace(judged[0], explained=True)
    others = [j for j in judged[1:] if j.score > 0 and not limb_of(bench, j)][: _BESIDES[bench.costly()]]
    again = acceptable(bench, besides(bench, beyond.calibrated, [j.hypothesis for j in others]), None)
    if not again or not accepted(bench, again[0], None):
        return [leader, *judged[1:]]
    names = {j.name for j in again}
    return [*again, leader, *(j for j in judged[1:] if j.name not in names)]


def _beside(bench: Bench, polish: Polisher, given: Judged) -> list[Judged]:
    """One more effect beside what was found: judged candidates, best first."""
    judged = acceptable(bench, bench.find(given), given, share=0.0)
    # Who was not judged as strictly must not overtake who was.
    for _ in range(_POLISHED):
        if bench.exhausted() and judged and judged[0].score - given.score < SECOND_THRESHOLD:
            break
        again = polish(judged, _ABREAST, given)
        if again == judged:
            break
        judged = acceptable(bench, again, given)
    return judged


def _swapped(
    bench: Bench, polish: Polisher, rounds: list[list[Judged]], named: list[Judged], note: Callable[[str], None]
) -> tuple[list[list[Judged]], list[Judged]]:
    """Two rounds and what they named, or those with another first effect where the two of these explain more.

    What explains most alone may stand for a part of both effects; the right one then comes close behind.

    Args:
      bench: of the search.
      polish: of the search.
      rounds: two.
      named: two.
      note: called with a word on what is being done.
    """
    first, both = named
    candidate, values = both.hypothesis.effects[-1]
    rivals = [
        rival
        for rival in rounds[0][1:]
        if rival.score > _RIVALRY * first.score and rival.name != candidate.name and accepted(bench, rival, None)
    ]
    if not rivals or bench.exhausted():
        return rounds, named
    note("the first effect's rivals")
    joined = [(rival, rival.hypothesis.with_effect(candidate, values)) for rival in rivals[: _RIVALS[bench.costly()]]]
    tries = [(polish.beside(rival, hypothesis), rival) for rival, hypothesis in joined]
    best, rival = max(tries, key=lambda row: row[0].score)
    if best.score <= both.score:
        return rounds, named
    second = _beside(bench, polish, rival)
    if not second or not accepted(bench, second[0], rival) or second[0].score <= both.score:
        return rounds, named
    return [[rival, *(j for j in rounds[0] if j is not rival)], second], [rival, second[0]]


def _enough(bench: Bench, first: Judged, both: Judged) -> Judged | None:
    """The first of two effects alone, where with a better number it leaves the second nothing to say; None otherwise.

    Args:
      bench: of the search.
      first: as it was named.
      both: named as well.
    """
    better, beside = alone(bench, both)
    return better if better.score > first.score and not accepted(bench, beside, better) else None
