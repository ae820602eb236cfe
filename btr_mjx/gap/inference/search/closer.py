"""A closer look at the best candidates of a first round and at nothing at all.

Where a robot touches the ground, what a starting state could explain is another matter in every hypothesis' own world,
and so is where the search for it ends: in fifty windows that is worth as much as a weak effect. Hypotheses that are
weak, or close to each other, are therefore compared once more from starting states that all of them have found, the
believed model among them, with directions of their own.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import AGAIN, refine
from btr_mjx.gap.inference.search.exchange import beside_the_best
from btr_mjx.gap.inference.search.runoff import apart, telling
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import MARGIN, Judged, Side, among, nearest
from btr_mjx.gap.simulate import run_in_threads

WEAK = 60.0
"""Score below which a leader is looked at."""

_CLOSE_BELOW = 400.0
"""The same of one that others come close to."""

_HOPELESS = -6.0
"""Score below which nothing is looked at: true effects that have less come to less than a name needs as well."""

_SHARE = 0.3
"""Part of the best score within which others are looked at as well, if it is more than what is called equivalent: of
one joint's frictions each may find starting states that the others lack."""

_PROMISING = 40.0
"""Score from which on a leader that moves contacts and may not be named is looked at: a true offset of 700 had 17 on
held-out recordings, and 100 from starting states that were found for the believed model as well."""

_MOST = 3
"""Candidates that are looked at, at most."""


def closer(bench: Bench, judged: Sequence[Judged]) -> list[Judged]:
    """Judge the best of a first round with starting states and directions that suit each of them.

    Args:
      bench: of the search.
      judged: candidates for a first effect, best first.

    Returns:
      All of them, best first; as they were where the search has cost much already, or there is nothing to be told.
    """
    chosen = [] if bench.costly() or not bench.survey.contact else _chosen(bench, judged)
    if not chosen:
        return list(judged)
    return among(judged, chosen, beside_the_best(bench, _again(bench, chosen)))


def _chosen(bench: Bench, judged: Sequence[Judged]) -> list[Judged]:
    """Those that are looked at: the best that move no contacts, where they are weak or come close to each other.

    And what moves contacts and leads all the same: it is no name, or nobody would look closer.
    """
    moving = [j for j in judged[:1] if j.name in bench.delicate and j.score > _PROMISING]
    plain = [j for j in judged if j.name not in bench.delicate and j.score > _HOPELESS]
    if not plain or plain[0].score > _CLOSE_BELOW:
        return moving
    margin = max(MARGIN, _SHARE * plain[0].score)
    close = [j for j in plain[1:] if plain[0].score - j.score < margin][: _MOST - 1]
    if close:
        # A lag and a delay that hardly differ are told apart by other means.
        windows = bench.fit.windows
        states, *others = windows.states([plain[0].hypothesis, *(j.hypothesis for j in close)])
        told = telling(np.stack([apart(windows, other, states) for other in others]))
        close = [j for j, tells in zip(close, told, strict=True) if tells]
    weak = [plain[0], *close] if close or plain[0].score < WEAK else []
    return [*moving, *weak][:_MOST]


def _again(bench: Bench, chosen: Sequence[Judged]) -> list[Judged]:
    """The same with numbers and scores that they have from starting states that all have found."""
    base, hypotheses = bench.base, [j.hypothesis for j in chosen]
    fit = shared([base, *hypotheses], [bench.fit, *(j.sides[0] for j in chosen)])
    reference = bench.nuisance(fit[0]).profile(fit[0].windows.residual, bench.cut)
    found = []
    for h, side in zip(hypotheses, fit[1:], strict=True):
        free, start = unknowns(h, bench.joint, bench.delicate), [h.values(bench.joint)]
        most = AGAIN[h.effects[-1][0].name in bench.delicate]
        found += refine(side.windows, bench.free(side, h), bench.cut, [(free, start)], most, reference)
    hypotheses = [h.replaced(f.values, bench.joint) for h, f in zip(hypotheses, found, strict=True)]
    test = shared([base, *hypotheses], [bench.test, *(j.sides[1] for j in chosen)])
    references = reference, bench.nuisance(test[0]).profile(test[0].windows.residual, bench.cut)
    out = []
    for j, h, f, *sides in zip(chosen, hypotheses, found, fit[1:], test[1:], strict=True):
        out += [replace(one, fresh=j.fresh) for one in bench.judge([h], [f], (sides[0], sides[1]), references)]
    return out


def shared(hypotheses: Sequence[Hypothesis], known: Sequence[Side]) -> list[Side]:
    """A side for each hypothesis: every window from where it comes nearest to the data, of all that any of them found.

    Args:
      hypotheses: those that are compared.
      known: the same windows with starting states that are known already.
    """
    sides = [nearest([side.based(h) for side in known]) for h in hypotheses]
    for find in (_redirected, _recentred):
        new = run_in_threads([partial(find, side, h) for side, h in zip(sides, hypotheses, strict=True)])
        sides = run_in_threads([partial(_nearest_of, h, sides[i], [*sides, *new]) for i, h in enumerate(hypotheses)])
    return sides


def _redirected(side: Side, hypothesis: Hypothesis) -> Side:
    return side.redirected(hypothesis)


def _recentred(side: Side, hypothesis: Hypothesis) -> Side:
    return side.recentred(hypothesis, exact=False)


def _nearest_of(hypothesis: Hypothesis, own: Side, pool: Sequence[Side]) -> Side:
    """The nearest of a pool for a hypothesis; its own comes first, it keeps what others have as well."""
    return nearest([side.based(hypothesis) for side in (own, *(s for s in pool if s is not own))])
