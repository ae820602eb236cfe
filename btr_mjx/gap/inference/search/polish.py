"""Leaders judged again, with starting states that suit each of them.

Linear directions of the starting states, found in the believed model, judge a hypothesis that moves contacts worse than
nothing although it is true: a foot touches at another time. Such leaders get directions of their own, found anew while
their size is walked over, because derivatives through a touchdown lead nowhere.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from btr_mjx.gap.effects import WORLD
from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import AGAIN, Refined, refine
from btr_mjx.gap.inference.search.exchange import beside_the_best, exchanged
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, among, nearest
from btr_mjx.gap.inference.search.sizes import best_size
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Fit

_HOPELESS = -5.0
"""Where the best score is lower, no better starting states will make a name of it."""

_CLOSE = 40.0
"""Leaders whose scores differ by less are judged again."""

_LEADING = 1.5
"""Gain, less its price and in prices of a number, that what leads the scan needs to be judged again in any case."""

_STRONG = 1000.0
"""Score beside which the part of it below must be there already."""

_WALKS = 4, 3
"""Candidates that move contacts that are looked at again, leaders included; and where much has been spent already."""

_WALKED = 3
"""The best of them after that are judged again, and whatever came as near to the best of them as the following part."""

_AS_GOOD = 0.85
"""Where not much has been spent yet. A true offset had 684 on a quarter of the windows where three other numbers of its
limb had 713 to 770."""

_HOPE = 0.25
"""Part of the best gain that such a candidate must have before its size is walked over."""

_PROMISE = 0.5
"""Part of the best gain that it must have afterwards to be judged again."""

_WORTH = 0.0
"""Score, beyond that of what was found, of a candidate for one more effect that is judged again."""

_BESIDE = 100.0
"""The same of one that moves contacts; or a gain so large that it had alone, beside what moves none."""

_LEAST = 5.0
"""Gain after the walk of a leader beside what was found, at least, to be judged again."""

_LIKELY = 25.0
"""Gain that what moves contacts needs alone before its size is walked over."""

_ENOUGH = 60.0
"""Gain that it needs afterwards: with much less on the recordings to fit it will not come to the score of a name."""

_ENOUGH_OF_GROUND = 25.0
"""The same of what changes the ground for all feet, which needs less."""

_SURE = 50.0
"""Score of a leader that is not given up for what a walk sees: a quarter of the windows to fit said nothing of three
true offsets that had 61 to 101 in all windows, at sizes that were half of the true ones, and 120 to 300 with care."""

Settled = tuple[Hypothesis, Side, Refined]
"""A hypothesis with its best numbers, the side that suits it, and what the refinement found there."""


class Polisher:
    """Judges leaders of a search again.

    Attributes:
      bench: of the search.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._centres: dict[tuple[str, bool], tuple[Side, Side]] = {}
        self._done: set[str] = set()

    def __call__(self, judged: Sequence[Judged], most: int = 3, given: Judged | None = None) -> list[Judged]:
        """Judge the leaders again, with starting states that suit each of them, and directions where contacts move.

        Args:
          judged: best first.
          most: so many leaders at most, beside candidates that move contacts and promise as much.
          given: what was found before, beside which they were judged.

        Returns:
          All of them, best first; just as they were where none is worth it, or those that are have been judged again.
        """
        tries = self._promising(judged, most, given)
        if not tries:
            return list(judged)
        chosen = [own for own, _ in tries]
        self._done |= {own.name for own in chosen}
        out = [j for j in judged if j not in chosen]
        out += self.again([hypothesis for _, hypothesis in tries], given)
        return sorted(out, key=lambda j: -j.score)

    def _promising(self, judged: Sequence[Judged], most: int, given: Judged | None) -> list[tuple[Judged, Hypothesis]]:
        """Those that are judged again, see `__call__`, each with the hypothesis that it becomes before."""
        bench = self.bench
        if not judged:
            return []
        already, known = (0.0, 0.0) if given is None else (given.score, given.gain)
        best = judged[0].score - already
        close = [j for j in judged if judged[0].score - j.score <= max(_CLOSE, 0.1 * best) and best > _HOPELESS][:most]
        rival = max(judged[0].gain - known, _CLOSE)
        hopes = {j.name: max(j.gain - known, self._alone(j, given)) for j in judged if self._anew(j.hypothesis)}
        plain = [j for j in close if j.name not in hopes]
        # What leads in the linear picture and not in true simulation may lack starting states of its own.
        scan = bench.hopes if given is None else bench.hopes_beside
        first = max(scan, key=lambda name: scan[name], default="")
        sure = scan.get(first, 0.0) > _LEADING
        if given is None and best > _STRONG:
            sure &= next((j.score for j in judged if j.name == first), 0.0) > _HOPE * best
        leads = [j for j in judged if sure and j.hypothesis.effects[-1][0].name == first]
        leading = [j for j in leads if j.name not in hopes]
        plain += [j for j in leading if j not in close]
        moving = [j for j in judged if j.name in hopes and (j in close or hopes[j.name] > _HOPE * rival)]
        if given is not None:
            plain = [j for j in plain if j.score - already >= _WORTH or j in leading]
            plain = [j for j in plain if j.name not in self._done]
            moving = [j for j in moving if max(j.score - already, self._alone(j, given)) >= _BESIDE]
            moving = [j for j in moving if j.name not in self._done]
        moving.sort(key=lambda j: -hopes[j.name])
        floor = 0.0 if given is None or not moving else bench.walks.gain(given.hypothesis)

        def walked(j: Judged) -> Hypothesis | None:
            least = (-np.inf, floor + _LEAST) if j in close else (floor + _HOPE * rival, floor + _PROMISE * rival)
            if given is None and j.gain >= least[0]:
                least = -np.inf, least[1]  # with directions of its own only a larger size may show what this one has
            sure = given is None and (j.gain >= _ENOUGH or j.score >= _SURE)
            if given is None and not sure:
                ground = j.hypothesis.effects[-1][0].place == WORLD
                least = max(least[0], _LIKELY), max(least[1], _ENOUGH_OF_GROUND if ground else _ENOUGH)
            found = bench.walks(j.hypothesis, *least)
            # A walk sees some of the windows: what had enough in all of them is not given up for it.
            return j.hypothesis if found is None and sure and j in close else found

        tries = moving[: _WALKS[bench.costly()]]
        ends = zip(tries, run_in_threads([partial(walked, j) for j in tries]), strict=True)
        there = [(j, found) for j, found in ends if found is not None]
        there.sort(key=lambda end: -bench.walks.best(end[1].name))
        best_of = [bench.walks.best(found.name) for _, found in there]
        as_good = sum(gain >= _AS_GOOD * best_of[0] for gain in best_of)
        most_walked = _WALKED if bench.costly() else max(_WALKED, as_good)
        return [(j, j.hypothesis) for j in plain] + there[:most_walked]

    def _alone(self, judged: Judged, given: Judged | None) -> float:
        """Gain that what moves contacts had with directions of its own alone; -inf beside another that moves some."""
        if given is not None and self._anew(given.hypothesis):
            return -np.inf
        return self.bench.walks.best(judged.hypothesis.effects[-1][0].name)

    def ground(self, judged: Sequence[Judged]) -> list[Judged]:
        """Judge with care the best of what changes the ground for all feet, where that has not been done.

        A quarter of the windows and a size that is off say little of it: of a softness that was worth 265 they said 19,
        of a friction worth 53 less than nothing. It costs as much as a run-off, and of twenty simulated robots that
        lacked nothing a scan led to it in one.

        Args:
          judged: a first round, best first.

        Returns:
          The same, best first.
        """
        worlds = [j for j in judged if self._anew(j.hypothesis) and j.hypothesis.effects[-1][0].place == WORLD]
        best = next((j for j in worlds if j.name not in self._done), None)
        if best is None:
            return list(judged)
        self._done.add(best.name)
        again = self.again([best.hypothesis], None)
        return among(judged, [best], again)

    def believed(self) -> tuple[Side, Side]:
        """Both sides of the split with starting states and directions that suit the believed model."""
        return self._known(None, True)

    def beside(self, given: Judged, hypothesis: Hypothesis) -> Judged:
        """What was `given` with one more effect, whose numbers start as the hypothesis has them, refined and judged."""
        return self.again([hypothesis], given)[0]

    def again(self, hypotheses: Sequence[Hypothesis], given: Judged | None) -> list[Judged]:
        """Refine and judge hypotheses with the starting states, of all that suit one of them, that suit each best.

        Every window takes those from which the hypothesis comes nearest to it, and so does what they are compared
        with. Near a touchdown the linear picture of a starting state is a matter of chance, and a single window in
        which it fails moves a score by more than a weak effect is worth, or than one leg's length differs from an
        offset of its knee.

        Args:
          hypotheses: with an effect more than what was found.
          given: what was found before; None for the believed model.
        """
        bench = self.bench
        before = bench.base if given is None else given.hypothesis
        moving = [k for k, h in enumerate(hypotheses, 1) if self._anew(h)]
        known = self._known(given, bool(moving))
        along = bench.nuisance if given is None else bench.free

        fit = self._shared([before, *hypotheses], known[0])
        reference = along(fit[0], before).profile(fit[0].windows.residual, bench.cut)
        pairs = zip(hypotheses, fit[1:], strict=True)
        few = len(moving) > _WALKED or bench.costly()
        ends = run_in_threads([partial(self._settled, h, side, reference, few) for h, side in pairs])
        if len(moving) > 1:
            fit = exchanged([before, *(h for h, _, _ in ends)], [fit[0], *(side for _, side, _ in ends)], moving)
            reference = along(fit[0], before).profile(fit[0].windows.residual, bench.cut)
            pairs = zip((h for h, _, _ in ends), fit[1:], strict=True)
            ends = run_in_threads([partial(self._refined, h, side, reference) for h, side in pairs])
        hypotheses = [h for h, _, _ in ends]

        test = exchanged([before, *hypotheses], self._shared([before, *hypotheses], known[1]), moving)
        references = reference, bench.nuisance(test[0], before).profile(test[0].windows.residual, bench.cut)
        if given is not None:
            given, references = replace(given, fits=references), given.references
        out = []
        for (h, side, refined), far in zip(ends, test[1:], strict=True):
            out += bench.judge([h], [refined], (side, far), references, given)
        return beside_the_best(bench, out)

    def _shared(self, hypotheses: Sequence[Hypothesis], known: Side) -> list[Side]:
        """A side for each of some hypotheses, which go on from what those before them have found.

        Args:
          hypotheses: what they are compared with comes first.
          known: side that suits the first of them.
        """
        pool, first = [known], True
        for h in hypotheses[1:]:
            start = nearest([side.based(h) for side in pool])
            # Rivals differ little: what the most hopeful one's directions and time step cost once serves the others.
            moves = self._anew(h)
            own = start.recentred(h, exact=first or not moves)
            pool.append(nearest([start, own, *([own.redirected(h)] if moves and first else [])]))
            first &= not moves

        def best(i: int) -> Side:
            # Those before it were looked at already.
            return nearest([pool[i], *(side.based(hypotheses[i]) for side in pool[i + 1 :])])

        return run_in_threads([partial(best, i) for i in range(len(hypotheses))])

    def _settled(self, hypothesis: Hypothesis, side: Side, reference: Fit, few: bool) -> Settled:
        """A hypothesis with its best numbers on a side to fit, what that became on the way, and how good it is."""
        if self._anew(hypothesis):
            hypothesis, (side,) = best_size(self.bench, hypothesis, [side], [reference], few)
        return self._refined(hypothesis, side, reference)

    def _refined(self, hypothesis: Hypothesis, side: Side, reference: Fit) -> Settled:
        """The same without a look at other sizes."""
        bench = self.bench
        free = unknowns(hypothesis, bench.joint, bench.delicate)
        start = [hypothesis.values(bench.joint)]
        most = AGAIN[self._anew(hypothesis)]
        found = refine(side.windows, bench.free(side, hypothesis), bench.cut, [(free, start)], most, reference)[0]
        return hypothesis.replaced(found.values, bench.joint), side, found

    def _anew(self, hypothesis: Hypothesis) -> bool:
        """Whether the last effect moves contacts; sides on which one is judged suit the effects before it."""
        return hypothesis.effects[-1][0].name in self.bench.delicate

    def _known(self, given: Judged | None, anew: bool) -> tuple[Side, Side]:
        """Both sides of the split with the starting states of what hypotheses are compared with.

        Args:
          given: what was found before; None for the believed model.
          anew: with directions of its own as well.
        """
        name = "" if given is None else given.name
        if (name, False) not in self._centres:
            if given is None:
                base, pair = self.bench.base, (self.bench.fit, self.bench.test)
                found = [nearest([side, side.recentred(base)]) for side in pair]
            else:
                found = [side.based(given.hypothesis) for side in given.sides]
            self._centres[name, False] = found[0], found[1]
        if anew and (name, True) not in self._centres:
            make = self.bench.base if given is None else given.hypothesis
            found = [nearest([side, side.redirected(make)]) for side in self._centres[name, False]]
            self._centres[name, True] = found[0], found[1]
        return self._centres[name, anew]
