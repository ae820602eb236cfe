"""Who comes first in a round, and who is equivalent, on stand-ins for judged candidates."""

from types import SimpleNamespace

import pytest
from gap_judged import as_judged

from btr_mjx.gap.inference.search.naming import acceptable
from btr_mjx.gap.inference.verdict.outcome import equivalent


def test_what_moves_contacts_is_equivalent_further_away():
    judged = [as_judged("a", 500.0), as_judged("b", 480.0), as_judged("c", 460.0), as_judged("d", 300.0)]
    assert equivalent(judged) == ("a", "b")
    assert equivalent(judged, {"c"}) == ("a", "b", "c")
    assert equivalent(judged, {"a"}) == ("a", "b", "c")


def test_what_is_strong_is_equivalent_further_away():
    judged = [as_judged("a", 6000.0), as_judged("b", 5950.0), as_judged("c", 5930.0)]
    assert equivalent(judged) == ("a", "b")


@pytest.mark.parametrize(("rejected", "order"), [("", "abc"), ("a", "bac"), ("ab", "abc")])
def test_of_what_is_alike_the_best_that_may_be_named_comes_first(monkeypatch, rejected, order):
    """Beyond the margin, where data tell candidates apart, nothing steps in for a leader that may not be named."""
    judged = [as_judged("a", 500.0), as_judged("b", 480.0), as_judged("c", 460.0)]

    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.accepted", all_but(rejected))
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.within_calibration", lambda bench, j: False)
    out = acceptable(SimpleNamespace(contact_sensitive=frozenset()), judged, None)
    assert "".join(j.hypothesis.effects[-1][0].name for j in out) == order
    assert acceptable(SimpleNamespace(contact_sensitive=frozenset()), [], None) == []


def all_but(rejected):
    return lambda bench, judged, given: judged.hypothesis.effects[-1][0].name not in rejected


@pytest.mark.parametrize(
    ("contact_sensitive", "rejected", "order"),
    [
        ("a", "a", "bacd"),
        ("ab", "ab", "cabd"),
        ("ab", "abc", "abcd"),  # behind a plain one that may not be named nothing steps in
        ("", "a", "abcd"),
        ("abcd", "abc", "dabc"),
        ("a", "", "abcd"),
    ],
)
def test_beside_another_effect_contacts_without_a_name_stand_in_nobodys_way(
    monkeypatch, contact_sensitive, rejected, order
):
    judged = [as_judged("a", 500.0), as_judged("b", 380.0), as_judged("c", 260.0), as_judged("d", 140.0)]
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.accepted", all_but(rejected))
    out = acceptable(SimpleNamespace(contact_sensitive=frozenset(contact_sensitive)), judged, as_judged("given", 100.0))
    assert "".join(j.hypothesis.effects[-1][0].name for j in out) == order


@pytest.mark.parametrize(
    ("best", "scores", "usual", "first"),
    [
        ("m", (130.0, 122.0), "b", "b"),  # a foot that is a little low: no name
        ("m", (160.0, 122.0), "b", "m"),  # the data tell them apart
        ("m", (130.0, 122.0), "", "m"),
        ("a", (30.0, 22.0), "b", "b"),
        ("a", (60.0, 22.0), "b", "a"),
    ],
)
def test_a_name_gives_way_to_what_calibration_leaves(monkeypatch, best, scores, usual, first):
    judged = [as_judged(best, scores[0]), as_judged("b", scores[1])]
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.accepted", all_but(usual))
    monkeypatch.setattr(
        "btr_mjx.gap.inference.search.naming.within_calibration",
        lambda bench, j: j.hypothesis.effects[-1][0].name in usual,
    )
    out = acceptable(SimpleNamespace(contact_sensitive=frozenset("m")), judged, None)
    assert out[0].hypothesis.effects[-1][0].name == first
    assert len(out) == 2


@pytest.mark.parametrize(
    ("rejected", "held_out", "order"),
    [
        ("mn", (15.0, 3.0, 60.0, 50.0), "bmnc"),
        ("mn", (70.0, 3.0, 60.0, 50.0), "mnbc"),  # an imitation of what moves contacts
        ("mn", (15.0, 65.0, 60.0, 50.0), "mnbc"),
        ("mnb", (15.0, 3.0, 60.0, 50.0), "mnbc"),  # nothing steps in for a plain one
        ("n", (15.0, 3.0, 60.0, 50.0), "mnbc"),  # that one has its name
        ("m", (15.0, 3.0, 60.0, 50.0), "bmnc"),
        ("bc", (15.0, 3.0, 60.0, 50.0), "mnbc"),
    ],
)
def test_contacts_without_a_name_give_way_to_what_held_out_recordings_say_more_of(
    monkeypatch, rejected, held_out, order
):
    scores = 180.0, 120.0, 85.0, 52.0
    judged = [as_judged(*row) for row in zip("mnbc", scores, held_out, strict=True)]
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.accepted", all_but(rejected))
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.within_calibration", lambda bench, j: False)
    out = acceptable(SimpleNamespace(contact_sensitive=frozenset("mn")), judged, None)
    assert "".join(j.hypothesis.effects[-1][0].name for j in out) == order
