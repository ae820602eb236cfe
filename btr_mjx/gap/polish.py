"""Leaders judged again, with starting states that suit each of them.

Linear directions of the starting states, found in the believed model, judge a hypothesis that moves contacts worse than
nothing although it is true: a foot touches at another time. Such leaders get directions of their own, found anew while
their size is walked over, because derivatives through a touchdown lead nowhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.refine import Nuisance, refine
from btr_mjx.gap.score import Fit
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Judged, Side
from btr_mjx.gap.windows import MakeWorld

_HOPELESS = -5.0
"""Where the best score is lower, no better starting states will make a name of it."""

_CLOSE = 40.0
"""Leaders whose scores differ by less are judged again."""

_WALKS = 4
"""Candidates that move contacts that are looked at again, leaders included."""

_HOPE = 0.25
"""Part of the best gain that such a candidate must have before its size is walked over."""

_PROMISE = 0.5
"""Part of the best gain that it must have afterwards to be judged again."""

_LEAST = 5.0
"""Gain after the walk of a leader, at least, to be judged again."""


class Polisher:
    """Judges leaders of a search again.

    Attributes:
      bench: of the search.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._polished_sides: dict[bool, tuple[Side, ...]] = {}

    def __call__(self, judged: Sequence[Judged], most: int = 3) -> list[Judged]:
        """Judge the leaders again, with starting states that suit each of them, and directions where contacts move.

        Args:
          judged: best first.
          most: so many leaders at most, beside candidates that move contacts and promise as much.

        Returns:
          All of them, best first.
        """
        bench = self.bench
        if not judged:
            return []
        best = judged[0].score
        close = [j for j in judged if best - j.score <= max(_CLOSE, 0.1 * best) and best > _HOPELESS][:most]
        plain = [j for j in close if not self._moves_contacts(j.hypothesis)]
        rival = max(judged[0].gain, _CLOSE)
        hopes = {j.name: max(j.gain, bench.walks.best(j.name)) for j in judged if self._moves_contacts(j.hypothesis)}
        others = [j for j in judged if j not in close and hopes.get(j.name, 0.0) > _HOPE * rival]
        moving = [j for j in close if j not in plain] + others
        moving.sort(key=lambda j: -hopes[j.name])
        needed = {j.name: (-np.inf, _LEAST) if j in close else (_HOPE * rival, _PROMISE * rival) for j in moving}
        walked = [(j, bench.walks(j.hypothesis, *needed[j.name])) for j in moving[:_WALKS]]
        tries = [(j, j.hypothesis) for j in plain] + [(j, found) for j, found in walked if found is not None]
        if not tries:
            return list(judged)
        chosen = [j for j, _ in tries]
        out = [j for j in judged if j not in chosen]
        references = self._polished(len(chosen) > len(plain))
        for own, hypothesis in tries:
            anew = own not in plain
            side = self._best(bench.fit, hypothesis, anew, bench.free)
            free = unknowns(hypothesis, bench.joint, bench.delicate)
            start = [hypothesis.values(bench.joint)]
            refined = refine(side.windows, bench.free(side), bench.cut, [(free, start)], 2, references[0])[0]
            hypothesis = hypothesis.replaced(refined.values, bench.joint)
            sides = side, self._best(bench.test, hypothesis, anew, bench.nuisance)
            out += bench.judge([hypothesis], [refined], sides, references)
        return sorted(out, key=lambda j: -j.score)

    def matched(self, given: Judged, other: Judged) -> Judged:
        """What was named, judged as generously as one that is to be added to it: with new directions if that has them.

        Args:
          given: what was named.
          other: the same with one more effect.
        """
        bench, hypothesis = self.bench, given.hypothesis
        if self._moves_contacts(hypothesis) or not self._moves_contacts(other.hypothesis):
            return given
        side = self._best(bench.fit, hypothesis, True, bench.free)
        residual = side.windows.residual
        refined = replace(given.refined, residual=residual, chi2=bench.free(side).profile(residual, bench.cut).chi2)
        sides = side, self._best(bench.test, hypothesis, True, bench.nuisance)
        again = bench.judge([hypothesis], [refined], sides, self._polished(anew=True))[0]
        return max(again, given, key=lambda judged: judged.score)

    def _moves_contacts(self, hypothesis: Hypothesis) -> bool:
        return any(candidate.name in self.bench.delicate for candidate, _ in hypothesis.effects)

    def _best(self, side: Side, hypothesis: MakeWorld, anew: bool, free: Callable[[Side], Nuisance]) -> Side:
        """A side around a hypothesis: with the directions that it has or with new ones, whichever suits it better.

        Args:
          side: of the split.
          hypothesis: what it should suit.
          anew: whether directions of its own are tried as well.
          free: what is fitted along there.
        """
        tries = [side.recentred(hypothesis)]
        if anew:
            tries.append(tries[0].redirected(hypothesis))
        return min(tries, key=lambda s: free(s).profile(s.windows.residual, self.bench.cut).loss)

    def _polished(self, anew: bool) -> tuple[Fit, Fit]:
        """Fits of the believed model with starting states polished as those of leaders are.

        Args:
          anew: directions as well; the better of both is taken, because near contacts they are a matter of chance.
        """
        bench, known = self.bench, self._polished_sides
        pair = bench.fit, bench.test
        if False not in known:
            known[False] = tuple(side.recentred(bench.base) for side in pair)
        if anew and True not in known:
            known[True] = tuple(side.redirected(bench.base) for side in known[False])
        first, second = (
            min((bench.nuisance(s).profile(s.windows.residual, bench.cut) for s in sides), key=lambda f: f.loss)
            for sides in zip(*known.values(), strict=True)
        )
        return first, second
