"""Leaders judged again, with starting states that suit each of them.

Linear directions of the starting states, found in the believed model, judge a hypothesis that moves contacts worse than
nothing although it is true: a foot touches at another time. Such leaders get directions of their own, and several
starting values, because derivatives through a touchdown lead nowhere.
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.refine import refine
from btr_mjx.gap.score import Fit
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Judged, Side

_HOPELESS = -5.0
"""Where the best score is lower, no better starting states will make a name of it."""

_CLOSE = 40.0
"""Leaders whose scores differ by less are judged again."""

_MOVING = 3
"""Candidates that move contacts, beyond the leaders, that are looked at again."""

_PROMISE = 0.5
"""Part of the best gain that these must then have to be judged again."""

_FACTORS = (1.0, 0.7, 0.85, 1.15, 1.3)
"""Factors on the size of a candidate that moves contacts, from which its refinement starts again."""

_AGAIN = 2
"""Times that a candidate that moves contacts may be linearised anew."""


class Polisher:
    """Judges leaders of a search again.

    Attributes:
      bench: of the search.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._polished_sides: dict[bool, tuple[Side, Side]] = {}

    def __call__(self, judged: Sequence[Judged], most: int = 3) -> list[Judged]:
        """Judge the leaders again, with starting states that suit each of them, and directions where contacts move.

        Args:
          judged: best first.
          most: so many leaders at most, and as many candidates again that move contacts.

        Returns:
          All of them, best first.
        """
        bench = self.bench
        if not judged:
            return []
        best = judged[0].score
        close = [j for j in judged if best - j.score <= max(_CLOSE, 0.1 * best) and best > _HOPELESS][:most]
        close += self._promising([j for j in judged if j not in close], max(judged[0].gain, _CLOSE))
        if not close:
            return list(judged)
        out = [j for j in judged if j not in close]
        references = self._polished(any(j.hypothesis.effects[-1][0].name in bench.delicate for j in close))
        for own in close:
            hypothesis, anew = own.hypothesis, any(c.name in bench.delicate for c, _ in own.hypothesis.effects)
            for _ in range(_AGAIN):
                side = bench.fit.recentred(hypothesis, anew)
                free = unknowns(hypothesis, bench.joint, bench.delicate)
                refined = refine(
                    side.windows, bench.free(side), bench.cut, [(free, self._around(hypothesis))], 2, references[0]
                )[0]
                before, hypothesis = hypothesis, hypothesis.replaced(refined.values, bench.joint)
                if not self._moved(before, hypothesis):
                    break
            sides = side, bench.test.recentred(hypothesis, anew)
            out += bench.judge([hypothesis], [refined], sides, references)
        return sorted(out, key=lambda j: -j.score)

    def _around(self, hypothesis: Hypothesis) -> list[np.ndarray]:
        """Starting values of a refinement: where contacts move, derivatives alone do not lead to the best value."""
        bench = self.bench
        candidate, own = hypothesis.effects[-1]
        values = hypothesis.values(bench.joint)
        if candidate.name not in bench.delicate:
            return [values]
        place, null = len(values) - len(own), candidate.parameters[0].null
        out = []
        for factor in _FACTORS:
            trial = values.copy()
            trial[place] = null + factor * (own[0] - null)
            out.append(trial)
        return out

    def _promising(self, judged: Sequence[Judged], best: float) -> list[Judged]:
        """Candidates that move contacts and may come near the best gain, on a part of the windows, linearised anew."""
        bench = self.bench
        moving = [j for j in judged if j.gain > 0 and j.hypothesis.effects[-1][0].name in bench.delicate][:_MOVING]
        index = np.arange(0, len(bench.fit.windows), 3)
        few = bench.fit.some(index)
        reference = bench.free(few).profile(few.windows.residual, bench.cut)
        out = []
        for own in moving:
            side = few.recentred(own.hypothesis, anew=True)
            gain = bench.fall(reference, bench.free(side).profile(side.windows.residual, bench.cut))
            if len(bench.fit.windows) / len(index) * gain > _PROMISE * best:
                out.append(own)
        return out

    def _moved(self, before: Hypothesis, after: Hypothesis) -> bool:
        """Whether contacts have moved so far that the windows' directions are of yesterday."""
        bench = self.bench
        candidate, values = after.effects[-1]
        first = candidate.parameters[0]
        if candidate.name not in bench.delicate:
            return False
        return abs(values[0] - before.effects[-1][1][0]) > 0.15 * abs(values[0] - first.null) + abs(first.step)

    def _polished(self, anew: bool) -> tuple[Fit, Fit]:
        """Fits of the believed model with starting states polished as those of leaders are.

        Args:
          anew: directions as well; the better of both is taken, because near contacts they are a matter of chance.
        """
        bench = self.bench
        for kind in (False, True)[: 1 + anew]:
            if kind not in self._polished_sides:
                self._polished_sides[kind] = (
                    bench.fit.recentred(bench.base, kind),
                    bench.test.recentred(bench.base, kind),
                )
        first, second = (
            min((bench.nuisance(s).profile(s.windows.residual, bench.cut) for s in sides), key=lambda f: f.loss)
            for sides in zip(*self._polished_sides.values(), strict=True)
        )
        return first, second
