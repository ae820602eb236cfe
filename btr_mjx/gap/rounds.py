"""Rounds of the search: who may be called by name, one more effect beside it, and its rivals beside that.

A name needs a score beyond its price on all data, a gain on held-out recordings, and a size beyond what calibration
leaves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from btr_mjx.gap.alone import alone
from btr_mjx.gap.calibrated import besides, beyond_calibration, limb_of
from btr_mjx.gap.closer import closer
from btr_mjx.gap.finer import finer
from btr_mjx.gap.held_out import foreseen, likely, unmoved, vouched
from btr_mjx.gap.outcome import alike
from btr_mjx.gap.pairs import told_apart
from btr_mjx.gap.places import WORLD
from btr_mjx.gap.polish import Polisher
from btr_mjx.gap.runoff import runoff
from btr_mjx.gap.screening import tolerance_of
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Judged

THRESHOLD = 15.0
"""Score, beyond the price of its numbers, that a name needs."""

CONTACT_THRESHOLD = 100.0
"""The same of what moves contacts, whose directions are found anew: near a touchdown these are a matter of chance. The
best such candidate of a simulated robot that lacked no such thing came to 70."""

LIMB_THRESHOLD = 40.0
"""The same where calibration of a limb is asked whether it explains as much."""

BEYOND = 35.0
"""Gain beyond calibration of its limb that a first effect needs there. Two of some two hundred simulated robots that
lacked nothing came to 31. Of seven true names, or twins of them, the two weakest had 10 and 14 and the others 29 to
219; a false one, where a lag was not seen, had 77."""

GROUND_THRESHOLD = 40.0
"""The same of what changes the ground for all feet: of a thousand simulated robots that lacked no such thing one came
to more than 15, and its ground was 13 % more slippery, as calibration had left it."""

SECOND_THRESHOLD = 25.0
"""What one more effect needs; what the first one's linearisation leaves must not count as a second one."""

_HARDLY = 60.0, 120.0
"""Score of a first effect below which a search that has cost much, or too much, looks for no second one: what explains
most of all alone would have to hide one that is worth half of it."""

SECOND_CONTACT_THRESHOLD = 120.0
"""The same of what moves contacts. The best such candidate beside an effect that was all that could be seen, met while
this was settled, came to 85."""

SECOND_PART = 0.01
"""Part of the first one's score that a second effect needs: a number that is a little off leaves as much."""

SECOND_SHARE = 0.02
"""The same where either moves contacts."""

SECOND_ENOUGH = 60.0
"""What is enough of these two for what moves no contacts: beside thirty first effects that were all there was, with
scores of 2,000 to 67,000, the best of it came to -7."""

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

HELD_OUT = 3.0
"""Gain that a name needs on held-out recordings, and on those that were fitted."""

HELD_OUT_SHARE = 0.08
"""Part of the gain per window to fit that held-out windows must show as well."""

CONTACT_SHARE = 0.4
"""The same of what moves contacts, as a first effect: of what scored 60 to 700 most true ones had 0.55 and more of it,
three false names of four 0.3 and less."""

GROUND_SHARE = 0.25
"""The same of what changes the ground for all feet: of 345 simulated robots that lacked nothing none had such a leader
with a score that is worth a name."""

HELD_OUT_ENOUGH = 30.0
"""Gain on held-out recordings that is enough in any case: a limit may be reached in few of them. True ones had 44
beside 1128 and 47 beside 1004."""

CONTACT_ENOUGH = 45.0
"""The same of what moves contacts: few feet may touch where it matters. A true offset had 55 beside 407."""

TOLERANCES = 4.0
"""Size that a name needs, in tolerances of its parameter."""

COARSE = 5.0
"""Dispersion beyond which no model of this kind reaches the noise: real machines have a hundred small effects."""

COARSE_SECOND = 0.1
"""Part of the first one's score that a second effect needs there."""

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


def acceptable(
    bench: Bench, judged: Sequence[Judged], given: Judged | None, share: float = SECOND_SHARE
) -> list[Judged]:
    """One round, with what may be called by name in front of what may not, where the data cannot tell the two apart.

    Where they cannot tell a first effect from something that is no larger than calibration leaves, the latter comes
    first: the feet of a robot that lacks nothing come down a little early or late, too, and its joints rub a little.

    What moves contacts and may not be called by name stands in nobody's way either, its score is a matter of chance up
    to its threshold: beside what was found before, and of a first effect that held-out recordings say more of.

    Args:
      bench: of the search.
      judged: best first.
      given: what was found before.
      share: of the first one's score that a second one needs where contacts move.
    """
    close = alike(judged, bench.delicate) if judged else []
    if not given:
        usual = next((j for j in close if within_calibration(bench, j)), None)
        if usual is not None:
            return [usual, *(j for j in judged if j is not usual)]
    moving = (j.hypothesis.effects[-1][0].name in bench.delicate for j in judged)
    ahead = next((i for i, moves in enumerate(moving) if not moves), len(judged))
    if given:
        close += list(judged)[: ahead + 1]
    elif 0 < ahead < len(judged) and judged[ahead].held_out > max(j.held_out for j in judged[:ahead]):
        close.append(judged[ahead])
    first = next((j for j in close if accepted(bench, j, given, share)), None)
    return list(judged) if first is None else [first, *(j for j in judged if j is not first)]


def accepted(bench: Bench, judged: Judged, given: Judged | None, share: float = SECOND_SHARE) -> bool:
    """Whether a candidate may be called by name.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
      given: what was found before.
      share: of the first one's score that a second one needs where contacts move.
    """
    if judged.explained:
        return False
    score = judged.score - (given.score if given else 0.0)
    gain = judged.gain - (given.gain if given else 0.0)
    held_out = judged.held_out + judged.fresh - (given.held_out if given else 0.0)
    expected = gain * len(bench.test.windows) / len(bench.fit.windows)
    needed, part, most = SECOND_THRESHOLD if given else THRESHOLD, HELD_OUT_SHARE, HELD_OUT_ENOUGH
    candidate = judged.hypothesis.effects[-1][0]
    if given:
        moving = any(own.name in bench.delicate for own, _ in judged.hypothesis.effects)
        left = max(SECOND_PART, share if moving else 0.0) * given.score
        needed = max(needed, left if candidate.name in bench.delicate else min(left, SECOND_ENOUGH))
    if given and bench.dispersion > COARSE:
        needed = max(needed, COARSE_SECOND * given.score)
    if candidate.name in bench.delicate:
        # Beside another effect few windows held out need have a foot that touches or leaves where it matters.
        alone = GROUND_THRESHOLD if candidate.place == WORLD else CONTACT_THRESHOLD
        part, most = 0.0 if given else GROUND_SHARE if candidate.place == WORLD else CONTACT_SHARE, CONTACT_ENOUGH
        if not given and len(limb_of(bench, judged)) > 1:
            alone, part = LIMB_THRESHOLD, HELD_OUT_SHARE
        needed = max(needed, SECOND_CONTACT_THRESHOLD if given else alone)
    if score < needed or gain + judged.fresh < HELD_OUT:
        return False
    enough = max(HELD_OUT, min(part * expected, most))
    if held_out < enough and not (unmoved(judged, HELD_OUT) and vouched(bench, judged, THRESHOLD)):
        if candidate.name in bench.delicate:
            return False
        hope = foreseen(bench, judged)
        # Where hardly anything is to be expected of them it is enough that they do not speak against it.
        agreed = hope < HELD_OUT and held_out >= 0 and vouched(bench, judged, THRESHOLD)
        if held_out < max(HELD_OUT, min(enough, likely(hope))) and not agreed:
            return False
    return not within_calibration(bench, judged)


def within_calibration(bench: Bench, judged: Judged) -> bool:
    """Whether the last effect is no larger than what calibration leaves, or than any simulation of its kind errs."""
    candidate, values = judged.widest.hypothesis.effects[-1]
    most = TOLERANCES * tolerance_of(candidate, bench.dataset.tolerances)
    # A slope may be along either axis.
    sizes = [(abs(value - p.null), p) for value, p in zip(values, candidate.parameters, strict=True) if not p.shape]
    return all(size <= max(most, p.least) for size, p in sizes)
