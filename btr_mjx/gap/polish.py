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
        self._given: dict[str, Judged] = {}

    def __call__(self, judged: Sequence[Judged], most: int = 3, given: Judged | None = None) -> list[Judged]:
        """Judge the leaders again, with starting states that suit each of them, and directions where contacts move.

        Args:
          judged: best first.
          most: so many leaders at most, beside candidates that move contacts and promise as much.
          given: what was found before, beside which they were judged.

        Returns:
          All of them, best first.
        """
        bench = self.bench
        if not judged:
            return []
        already, known = (0.0, 0.0) if given is None else (given.score, given.gain)
        best = judged[0].score - already
        close = [j for j in judged if judged[0].score - j.score <= max(_CLOSE, 0.1 * best) and best > _HOPELESS][:most]
        plain = [j for j in close if not self._anew(j.hypothesis)]
        rival = max(judged[0].gain - known, _CLOSE)
        hopes = {
            j.name: max(j.gain - known, bench.walks.best(j.name) if given is None else -np.inf)
            for j in judged
            if self._anew(j.hypothesis)
        }
        others = [j for j in judged if j not in close and hopes.get(j.name, 0.0) > _HOPE * rival]
        moving = [j for j in close if j not in plain] + others
        moving.sort(key=lambda j: -hopes[j.name])
        walked = []
        for j in moving[:_WALKS]:
            floor = 0.0 if given is None else bench.walks.gain(given.hypothesis)
            least = (-np.inf, floor + _LEAST) if j in close else (floor + _HOPE * rival, floor + _PROMISE * rival)
            walked.append((j, bench.walks(j.hypothesis, *least)))
        tries = [(j, j.hypothesis) for j in plain] + [(j, found) for j, found in walked if found is not None]
        if not tries:
            return list(judged)
        chosen = [j for j, _ in tries]
        out = [j for j in judged if j not in chosen]
        references = self._polished(len(chosen) > len(plain))
        for own, hypothesis in tries:
            anew = own not in plain
            side = self._best(own.sides[0], hypothesis, anew, bench.free)
            free = unknowns(hypothesis, bench.joint, bench.delicate)
            start = [hypothesis.values(bench.joint)]
            refined = refine(side.windows, bench.free(side), bench.cut, [(free, start)], 2, references[0])[0]
            hypothesis = hypothesis.replaced(refined.values, bench.joint)
            sides = side, self._best(own.sides[1], hypothesis, anew, bench.nuisance)
            again = bench.judge([hypothesis], [refined], sides, references)[0]
            out.append(again if given is None else self._beside(given, own, again))
        return sorted(out, key=lambda j: -j.score)

    def _beside(self, given: Judged, before: Judged, again: Judged) -> Judged:
        """A candidate beside what was found, which was not judged again with it.

        Args:
          given: what was found before.
          before: the same with one more effect.
          again: that, judged again.

        Returns:
          What moves contacts with as much off as `given` gains when it gets directions of its own, too. Of any other,
          the better: both share starting states with `given` to begin with, and new ones move strong scores by more
          than a weak effect is worth.
        """
        bench, hypothesis = self.bench, given.hypothesis
        if not self._anew(again.hypothesis):
            return max(before, again, key=lambda judged: judged.score)
        if self._anew(hypothesis):
            return again
        if given.name not in self._given:
            side = self._best(given.sides[0], hypothesis, True, bench.free)
            residual = side.windows.residual
            refined = replace(given.refined, residual=residual, chi2=bench.free(side).profile(residual, bench.cut).chi2)
            sides = side, self._best(given.sides[1], hypothesis, True, bench.nuisance)
            self._given[given.name] = bench.judge([hypothesis], [refined], sides, self._polished(anew=True))[0]
        own = self._given[given.name]
        if own.score <= given.score:
            return again
        gain, held_out, score = own.gain - given.gain, own.held_out - given.held_out, own.score - given.score
        return replace(again, gain=again.gain - gain, held_out=again.held_out - held_out, score=again.score - score)

    def _anew(self, hypothesis: Hypothesis) -> bool:
        """Whether the last effect moves contacts; sides on which one is judged suit the effects before it."""
        return hypothesis.effects[-1][0].name in self.bench.delicate

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
