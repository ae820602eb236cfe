"""Leaders judged again, with starting states that suit each of them.

Linear directions of the starting states, found in the believed model, judge a hypothesis that moves contacts worse than
nothing although it is true: a foot touches at another time. Such leaders get directions of their own, found anew while
their size is walked over, because derivatives through a touchdown lead nowhere.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.hypotheses import unknowns
from btr_mjx.gap.inference.scoring.refine import AGAIN, Refined, refine
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, nearest
from btr_mjx.gap.inference.search.sizes import best_size
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Fit

_LEAST_SCORE = -5.0
"""Where the best score is lower, no better starting states will make a name of it."""

_CLOSE = 40.0
"""Leaders whose scores differ by less are judged again."""

_WALKS = 3
"""Candidates that move contacts whose size is walked over, at most."""

_BEFORE_WALK, _AFTER_WALK = 0.25, 0.5
"""Parts of the best gain that such a candidate must have before its walk, and afterwards."""

_BESIDE = 100.0
"""Score or gain alone of one, beside what was found, that is walked over."""

_ALTERNATIONS, _GAINED = 6, 0.002
"""Times that starting states and numbers are fitted in turn of what is strong, and the part of the loss that each of
them must gain for another one."""

Settled = tuple[Hypothesis, Side, Refined]
"""A hypothesis with its best numbers, the side that suits it, and what the refinement found there."""


class Finalists:
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
        if not judged:
            return []
        already, known = (0.0, 0.0) if given is None else (given.score, given.gain)
        best = judged[0].score - already
        fresh = [j for j in judged if given is None or j.name not in self._done]
        close = [j for j in fresh if judged[0].score - j.score <= max(_CLOSE, 0.1 * best) and best > _LEAST_SCORE]
        plain = [
            j
            for j in close[:most]
            if not self._is_contact_sensitive(j.hypothesis) and (given is None or j.score > already)
        ]
        hopes = {
            j.name: max(j.gain - known, self._alone(j, given))
            for j in fresh
            if self._is_contact_sensitive(j.hypothesis)
        }
        moving = [j for j in fresh if j.name in hopes and (given is None or hopes[j.name] >= _BESIDE)]
        moving = sorted(moving, key=lambda j: -hopes[j.name])[:_WALKS]
        rival = max(judged[0].gain - known, _CLOSE)
        floor = 0.0 if given is None or not moving else self.bench.line_search.gain(given.hypothesis)
        least = floor + _BEFORE_WALK * rival, floor + _AFTER_WALK * rival
        ends = run_in_threads([partial(self.bench.line_search, j.hypothesis, *least) for j in moving])
        walked = [(j, found) for j, found in zip(moving, ends, strict=True) if found is not None]
        return [(j, j.hypothesis) for j in plain] + walked

    def _alone(self, judged: Judged, given: Judged | None) -> float:
        """Gain that what moves contacts had with directions of its own alone; -inf beside another that moves some."""
        if given is not None and self._is_contact_sensitive(given.hypothesis):
            return -np.inf
        return self.bench.line_search.best(judged.hypothesis.effects[-1][0].name)

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
        moving = [k for k, h in enumerate(hypotheses, 1) if self._is_contact_sensitive(h)]
        known = self._known(given, bool(moving))
        along = bench.nuisance if given is None else bench.free

        fit = self._shared([before, *hypotheses], known[0])
        reference = along(fit[0], before).profile(fit[0].windows.residual, bench.cut)
        pairs = zip(hypotheses, fit[1:], strict=True)
        few = len(moving) > 1
        ends = run_in_threads([partial(self._settled, h, side, reference, few) for h, side in pairs])
        hypotheses = [h for h, _, _ in ends]

        test = self._shared([before, *hypotheses], known[1])
        references = reference, bench.nuisance(test[0], before).profile(test[0].windows.residual, bench.cut)
        if given is not None:
            given, references = replace(given, fits=references), given.references
        out = []
        for (h, side, refined), far in zip(ends, test[1:], strict=True):
            out += bench.judge([h], [refined], (side, far), references, given)
        return out

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
            moves = self._is_contact_sensitive(h)
            own = start.with_fitted_states(h, exact=first or not moves)
            anew = (moves and first) or self.bench.strong
            pool.append(nearest([start, own, *([own.with_own_directions(h)] if anew else [])]))
            first &= not moves

        def best(i: int) -> Side:
            # Those before it were looked at already.
            return nearest([pool[i], *(side.based(hypotheses[i]) for side in pool[i + 1 :])])

        return run_in_threads([partial(best, i) for i in range(len(hypotheses))])

    def _settled(self, hypothesis: Hypothesis, side: Side, reference: Fit, few: bool) -> Settled:
        """A hypothesis with its best numbers on a side to fit, what that became on the way, and how good it is."""
        if self._is_contact_sensitive(hypothesis) and not self.bench.tossed:  # else the line search saw all windows
            hypothesis, side = best_size(self.bench, hypothesis, side, reference, few)
        hypothesis, side, found = self._refined(hypothesis, side, reference)
        for _ in range(_ALTERNATIONS if self.bench.strong else 0):
            before = found.loss
            own = side.with_fitted_states(hypothesis)
            side = nearest([side.based(hypothesis), own, own.with_own_directions(hypothesis)])
            hypothesis, side, found = self._refined(hypothesis, side, reference)
            if before - found.loss < _GAINED * before:
                break
        return hypothesis, side, found

    def _refined(self, hypothesis: Hypothesis, side: Side, reference: Fit) -> Settled:
        """The same without a look at other sizes."""
        bench = self.bench
        free = unknowns(hypothesis, bench.joint, bench.contact_sensitive)
        start = [hypothesis.values(bench.joint)]
        most = AGAIN[self._is_contact_sensitive(hypothesis)]
        found = refine(side.windows, bench.free(side, hypothesis), bench.cut, [(free, start)], most, reference)[0]
        return hypothesis.replaced(found.values, bench.joint), side, found

    def _is_contact_sensitive(self, hypothesis: Hypothesis) -> bool:
        """Whether the last effect moves contacts; sides on which one is judged suit the effects before it."""
        return hypothesis.effects[-1][0].name in self.bench.contact_sensitive

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
                found = [nearest([side, side.with_fitted_states(base)]) for side in pair]
            else:
                found = [side.based(given.hypothesis) for side in given.sides]
            self._centres[name, False] = found[0], found[1]
        if anew and (name, True) not in self._centres:
            make = self.bench.base if given is None else given.hypothesis
            found = [nearest([side, side.with_own_directions(make)]) for side in self._centres[name, False]]
            self._centres[name, True] = found[0], found[1]
        return self._centres[name, anew]
