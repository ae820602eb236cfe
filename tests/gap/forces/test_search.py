"""Forward selection: it ends."""

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
        return SimpleNamespace(finalists=[(50.0, next(count))])

    monkeypatch.setattr(search, "one_more", one_more)
    monkeypatch.setattr(search, "pruned", lambda side, found, null: _fit(*turns[found % len(turns)]))
    rounds, chain, _ = search.select_effects(None, _fit(), 5, lambda _: None, lambda *_: True)  # type: ignore[arg-type]
    found = [tuple(c.name for c, _ in fit.point.named) for fit in chain]
    assert len(set(found)) == len(found) == len(rounds)
