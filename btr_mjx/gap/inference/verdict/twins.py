"""Twins: whether a force of another shape, at the same place, explains what a name does not.

What is nearly right leaves little, and that where motions are largest: windows that count less because something is
wrong with them. A linear picture may show nothing from there. Twins are therefore simulated, beside the name as it was
found and beside a part of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import refine
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged

_HANDED = (0.5, 1.0)
"""Parts of a name that its twin takes over at the start of a refinement."""

_LARGE = 3.0
"""Size of a twin that is compared with its name, in steps of its number."""

_HOPE = 5.0
"""Gain on the recordings to fit that is worth a closer look."""

_FIRST, _REST = 1, 2
"""Steps of a refinement of every start, and of those that are refined to the end, unless much has been spent already:
the best of them is refined once more when it is judged."""

_REFINED = 2
"""Starts that are, at most: after one step the best of them is hardly ever behind two others."""


def candidates_of(bench: Bench, judged: Judged) -> list[tuple[int, Candidate]]:
    """Twins of what was named, each with the index of the effect that is taken for it.

    Args:
      bench: of the search.
      judged: what was named, all of it.
    """
    model, out = bench.dataset.model, []
    known = {candidate.effect.name for candidate in bench.candidates}
    for i, (candidate, _) in enumerate(judged.hypothesis.effects):
        for effect in candidate.effect.similar:
            there = [p for p in effect.places(model) if p.label == candidate.place.label]
            if effect.name not in known:
                out += [(i, Candidate(effect, p, effect.parameters(model, bench.scales, p))) for p in there]
    return out


def twin(bench: Bench, judged: Judged) -> Judged | None:
    """The best twin of what was named, judged beside it.

    Args:
      bench: of the search.
      judged: what was named, all of it.

    Returns:
      None where none promises anything; its score counts what was named as well.
    """
    tries = [h for i, candidate in candidates_of(bench, judged) for h in _starts(bench, judged, i, candidate)]
    if not tries:
        return None
    side = judged.sides[0]
    reference = bench.free(side, judged.hypothesis).profile(judged.refined.residual, bench.cut)
    for steps in (_FIRST,) if bench.costly() else (_FIRST, _REST):
        found = refine(
            side.windows,
            [bench.free(side, h) for h in tries],
            bench.cut,
            [(unknowns(h, bench.joint, bench.delicate), [h.values(bench.joint)]) for h in tries],
            steps,
            reference,
        )
        best = sorted(range(len(tries)), key=lambda i: found[i].loss)[:_REFINED]
        tries = [tries[i].replaced(found[i].values, bench.joint) for i in best]
    if (reference.loss - found[best[0]].loss) / bench.dispersion < _HOPE:
        return None
    return Polisher(bench).beside(judged, tries[0])


def _starts(bench: Bench, judged: Judged, index: int, candidate: Candidate) -> list[Hypothesis]:
    """A name with its twin: hardly any of it, and as much as explains what is taken off the name."""
    hypothesis = judged.hypothesis
    first = [hypothesis.with_effect(candidate, candidate.null)]
    own, values = hypothesis.effects[index]
    if len(own.parameters) > 1:
        return first
    windows = judged.sides[0].windows
    without = _with(hypothesis, index, own.null)
    large = candidate.null
    large[0] += _LARGE * candidate.parameters[0].step
    absent, there = windows.residuals([without, without.with_effect(candidate, large)])
    named, twin = judged.refined.residual - absent, there - absent
    size = float((twin**2).sum())
    if size == 0:
        return first
    whole = float((named * twin).sum()) / size * (large[0] - candidate.null[0])
    for part in _HANDED:
        handed = candidate.null
        number = candidate.parameters[0]
        handed[0] = np.clip(number.null + part * whole, number.low, number.high)
        rest = own.null + (1.0 - part) * (np.array(values) - own.null)
        first.append(_with(hypothesis, index, rest).with_effect(candidate, handed))
    return first


def _with(hypothesis: Hypothesis, index: int, values: Sequence[float] | np.ndarray) -> Hypothesis:
    """The same with other numbers of one effect."""
    effects = list(hypothesis.effects)
    effects[index] = effects[index][0], tuple(float(value) for value in values)
    return replace(hypothesis, effects=tuple(effects))
