"""What may be called by name.

A name needs a score beyond its price on all data, a gain on held-out recordings, and a size beyond what calibration
leaves.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.effects import WORLD
from btr_mjx.gap.inference.scoring.screening import tolerance_of
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.outcome import alike

THRESHOLD = 15.0
"""Score, beyond the price of its numbers, that a name needs."""

CONTACT_THRESHOLD = 100.0
"""The same of what moves contacts, whose directions are found anew: near a touchdown these are a matter of chance. The
best such candidate of a simulated robot that lacked no such thing came to 70."""

GROUND_THRESHOLD = 40.0
"""The same of what changes the ground for all feet: of a thousand simulated robots that lacked no such thing one came
to more than 15, and its ground was 13 % more slippery, as calibration had left it."""

SECOND_THRESHOLD = 25.0
"""What one more effect needs; what the first one's linearisation leaves must not count as a second one."""

SECOND_CONTACT_THRESHOLD = 120.0
"""The same of what moves contacts. The best such candidate beside an effect that was all that could be seen, met while
this was settled, came to 85."""

SECOND_PART = 0.01
"""Part of the first one's score that a second effect needs: a number that is a little off leaves as much."""

SECOND_SHARE = 0.02
"""The same where either moves contacts."""

SECOND_ENOUGH = 60.0
"""What is enough of these two for what moves no contacts: beside thirty first effects that were all there was, with
scores of 1,600 to 67,000, the best of it came to -7."""

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
    close = alike(judged, bench.contact_sensitive) if judged else []
    if not given:
        usual = next((j for j in close if within_calibration(bench, j)), None)
        if usual is not None:
            return [usual, *(j for j in judged if j is not usual)]
    moving = (j.hypothesis.effects[-1][0].name in bench.contact_sensitive for j in judged)
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
    score = judged.score - (given.score if given else 0.0)
    gain = judged.gain - (given.gain if given else 0.0)
    held_out = judged.held_out - (given.held_out if given else 0.0)
    expected = gain * len(bench.test.windows) / len(bench.fit.windows)
    needed, part, most = SECOND_THRESHOLD if given else THRESHOLD, HELD_OUT_SHARE, HELD_OUT_ENOUGH
    candidate = judged.hypothesis.effects[-1][0]
    if given:
        moving = any(own.name in bench.contact_sensitive for own, _ in judged.hypothesis.effects)
        left = max(SECOND_PART, share if moving else 0.0) * given.score
        needed = max(needed, left if candidate.name in bench.contact_sensitive else min(left, SECOND_ENOUGH))
    if candidate.name in bench.contact_sensitive:
        # Beside another effect few windows held out need have a foot that touches or leaves where it matters.
        alone = GROUND_THRESHOLD if candidate.place == WORLD else CONTACT_THRESHOLD
        part, most = 0.0 if given else GROUND_SHARE if candidate.place == WORLD else CONTACT_SHARE, CONTACT_ENOUGH
        needed = max(needed, SECOND_CONTACT_THRESHOLD if given else alone)
    if score < needed or gain < HELD_OUT:
        return False
    enough = max(HELD_OUT, min(part * expected, most))
    return held_out >= enough and not within_calibration(bench, judged)


def within_calibration(bench: Bench, judged: Judged) -> bool:
    """Whether the last effect is no larger than what calibration leaves, or than any simulation of its kind errs.

    Of a number for each member of a group one may be a little larger by chance: what the members explain beyond their
    calibration must be worth a name.
    """
    candidate, values = judged.hypothesis.effects[-1]
    most = [TOLERANCES * tolerance_of(single, bench.dataset.tolerances) for single in candidate.singles]
    # A slope may be along either axis.
    rows = list(zip(values, candidate.parameters, itertools.cycle(most), strict=False))
    beyond = [
        0.0 if p.shape else max(abs(value - p.null) - max(tolerance, p.negligible), 0.0) for value, p, tolerance in rows
    ]
    if not any(beyond):
        return True
    if len(candidate.singles) == 1:
        return False
    back = [-size if value > p.null else size for size, (value, p, _) in zip(beyond, rows, strict=True)]
    refined = judged.refined
    residual = refined.residual + np.tensordot(back, refined.columns[-len(back) :], 1)
    within = bench.free(judged.sides[0], judged.hypothesis).profile(residual, bench.cut)
    return bool(bench.fall(within, judged.fits[0]) < THRESHOLD)
