"""Forward selection: it ends, and takes what held-out recordings bear out."""

from types import SimpleNamespace
from typing import Any

import pytest

from btr_mjx.gap.forces import search


def _fit(*names: str) -> Any:
    named = tuple((SimpleNamespace(name=name), (1.0,)) for name in names)
    return SimpleNamespace(point=SimpleNamespace(named=named), loss=100.0 - len(names))


@pytest.mark.parametrize("turns", [[("a",), ("a",)], [("a",), ("b",), ("a",)], [()]])
def test_effects_that_come_and_go_end_the_search(monkeypatch: pytest.MonkeyPatch, turns: list) -> None:
    """Each further effect pays, and makes those before it worthless."""
    count = iter(range(10))

    def one_more(side: Any, fit: Any, needed: float, laws: Any, drives: bool) -> Any:
        return search.SearchRound(fit, (), ((50.0, next(count)),))  # type: ignore[arg-type]

    monkeypatch.setattr(search, "one_more", one_more)
    monkeypatch.setattr(search, "pruned", lambda side, found, null: _fit(*turns[found % len(turns)]))
    rounds, chain, _ = search.select_effects(None, _fit(), 5, lambda _: None, lambda *_: True)  # type: ignore[arg-type]
    found = [tuple(c.name for c, _ in fit.point.named) for fit in chain]
    assert len(set(found)) == len(found) == len(rounds)


@pytest.mark.parametrize(("borne_out", "last"), [("abc", "a"), ("bc", "b"), ("c", None), ("", None)])
def test_the_best_candidate_that_is_borne_out_is_named(
    monkeypatch: pytest.MonkeyPatch, borne_out: str, last: str | None
) -> None:
    """The third one scores less than is needed, whatever held-out recordings say of it."""
    finalists = tuple((score, _fit(name)) for score, name in ((50.0, "a"), (40.0, "b"), (-1.0, "c")))
    monkeypatch.setattr(search, "one_more", lambda side, fit, *_: search.SearchRound(fit, (), finalists))
    monkeypatch.setattr(search, "pruned", lambda side, found, null: found)
    said: list[str] = []

    def is_confirmed(before: Any, after: Any) -> bool:
        name = after.point.named[-1][0].name
        said.append(name)
        return name in borne_out

    rounds, chain, contradicted = search.select_effects(None, _fit(), 1, lambda _: None, is_confirmed)  # type: ignore[arg-type]
    assert [c.name for c, _ in chain[-1].point.named] == ([last] if last else [])
    assert contradicted == (last is None)
    if last:
        assert rounds[-1].finalists[0][1] is chain[-1]  # what the page calls the best one
    else:
        assert rounds[-1].finalists == finalists
        assert said == ["a", "b"]


def test_a_name_that_comes_again_contradicts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """One candidate is not borne out, and pruning leaves of the next one what was named before."""
    rounds_of = iter([((50.0, _fit("a")),), ((40.0, _fit("b")), (30.0, _fit("a")))])
    monkeypatch.setattr(search, "one_more", lambda side, fit, *_: search.SearchRound(fit, (), next(rounds_of)))
    monkeypatch.setattr(search, "pruned", lambda side, found, null: found)

    def is_confirmed(before: Any, after: Any) -> bool:
        return after.point.named[-1][0].name == "a"

    _, chain, contradicted = search.select_effects(None, _fit(), 5, lambda _: None, is_confirmed)  # type: ignore[arg-type]
    assert [c.name for c, _ in chain[-1].point.named] == ["a"]
    assert contradicted  # by "b", whatever came after it
