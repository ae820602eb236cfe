"""Rounds of the search: who comes first, one more effect beside it, and its rivals beside that."""

from collections.abc import Callable, Sequence

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.inference.search.finalists import Finalists
from btr_mjx.gap.inference.search.naming import acceptable, accepted
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged

_POLISHED = 3
"""Times that candidates for one more effect are judged again, at most."""

_ABREAST = 2
"""Such candidates that are judged again at once, where they are close."""


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
    finalists = Finalists(bench)
    rounds = [acceptable(bench, finalists(bench.find()), None)]
    named: list[Judged] = []
    while rounds[-1] and accepted(bench, rounds[-1][0], named[-1] if named else None):
        named.append(rounds[-1][0])
        if len(named) >= most:
            break
        note("one more effect")
        rounds.append(_beside(bench, finalists, named[-1]))
    note("each beside the others")
    return _pruned(bench, finalists, rounds, named)


def _pruned(
    bench: Bench, finalists: Finalists, rounds: list[list[Judged]], named: list[Judged]
) -> tuple[list[list[Judged]], list[Judged]]:
    """Rounds and names without those that the names after them have made worthless: backward elimination."""
    k = 0
    while k < len(named) - 1:
        effects = named[-1].hypothesis.effects
        without = _judged_in_turn(finalists, bench.base, [*effects[:k], *effects[k + 1 :]])
        rest = without[-1]
        whole = finalists.beside(rest, rest.hypothesis.with_effect(*effects[k]))
        if accepted(bench, whole, rest):
            k += 1
            continue
        others = [own for i, own in enumerate(rounds) if i != k + 1]
        for new, own in zip(without, others, strict=False):
            last = new.hypothesis.effects[-1][0].name
            own[:] = [new, *(j for j in own if j.hypothesis.effects[-1][0].name != last)]
        # Those that stay were judged anew, and may no longer be called by name.
        fit = [accepted(bench, j, given) for j, given in zip(without, [None, *without], strict=False)]
        rounds, named = others, without[: fit.index(False) if False in fit else len(fit)]
    return rounds, named


def _judged_in_turn(
    finalists: Finalists, base: Hypothesis, effects: Sequence[tuple[Candidate, tuple[float, ...]]]
) -> list[Judged]:
    """Effects one after another, each refined and judged beside those before."""
    out: list[Judged] = []
    for candidate, values in effects:
        given = out[-1] if out else None
        start = given.hypothesis if given else base
        out += finalists.again([start.with_effect(candidate, values)], given)
    return out


def _beside(bench: Bench, finalists: Finalists, given: Judged) -> list[Judged]:
    """One more effect beside what was found: judged candidates, best first."""
    judged = acceptable(bench, bench.find(given), given)
    # Who was not judged as strictly must not overtake who was.
    for _ in range(_POLISHED):
        again = finalists(judged, _ABREAST, given)
        if again == judged:
            break
        judged = acceptable(bench, again, given)
    return judged
