"""What a name may leave, and what is missing, or not ruled out, though nothing may be named."""

from types import SimpleNamespace

import numpy as np
import pytest

from btr_mjx.gap.inference.scoring.leftover import Leftover
from btr_mjx.gap.inference.verdict.check import Check
from btr_mjx.gap.inference.verdict.identify import (
    left_beside_name,
    left_without_name,
    undecided,
)


def left_by(excess=0.0, chi2=0.0, usual=2.0, rough=False, dispersion=1.0, confirmed=None, surprise=0.0):
    """A check that knows of an excess at one of two joints, 5.5 may be chance, and of a shape held-out data confirm."""
    left = Leftover(np.array([excess, 0.0]), np.array([chi2, 900.0]), np.array([usual, 9.0]), ())
    chance = SimpleNamespace(excess=5.5, usual=1.0 if rough else -np.inf, left=lambda judged: left)
    return SimpleNamespace(
        bench=SimpleNamespace(dispersion=dispersion),
        excess_at_joint=lambda judged: Check.excess_at_joint(chance, judged),  # type: ignore[arg-type]
        confirmed_feature=lambda judged: confirmed,
        surprise=lambda judged: surprise,
    )


NAMED = SimpleNamespace(gain=1000.0)


@pytest.mark.parametrize(
    ("excess", "chi2", "usual", "rough", "expected"),
    [
        (5.4, 500.0, 2.0, False, False),
        (5.6, 59.0, 2.0, False, False),  # little beside what the name explains
        (5.6, 61.0, 2.0, False, True),
        (5.6, 61.0, 0.0, False, True),
        (5.6, 61.0, 0.9, True, False),  # touchdowns at another time throw a few windows
        (5.6, 61.0, 1.1, True, True),
    ],
)
def test_what_a_name_may_leave_at_a_joint(excess, chi2, usual, rough, expected):
    assert left_beside_name(left_by(excess, chi2, usual, rough), NAMED, 0.9, 0.0) is expected


def test_a_name_is_none_where_held_out_recordings_know_of_something_else():
    assert left_beside_name(left_by(confirmed="position cubed"), NAMED, 0.9, 0.0)


@pytest.mark.parametrize("score", [None, -3.0, 40.0])
def test_what_may_not_be_named_may_still_be_missing(score):
    """Beside the best candidate where it explains something at all, else beside the believed model."""
    best = None if score is None else SimpleNamespace(score=score)
    asked = []
    for check, expected in (
        (left_by(), False),
        (left_by(confirmed="load"), True),
        (left_by(5.6, 10.0), True),
        (left_by(surprise=7.0), True),
    ):
        known = check.confirmed_feature
        check.confirmed_feature = lambda judged, known=known: asked.append(judged) or known(judged)
        assert left_without_name(check, best) is expected
    assert asked == [best if score == 40.0 else None] * 4


@pytest.mark.parametrize(
    ("score", "small", "expected"), [(80.0, False, False), (200.0, False, True), (200.0, True, False)]
)
def test_what_is_too_much_for_chance_is_missing_though_it_may_not_be_named(monkeypatch, score, small, expected):
    """Unless it is no larger than calibration leaves."""
    monkeypatch.setattr("btr_mjx.gap.inference.verdict.identify.within_calibration", lambda bench, judged: small)
    assert left_without_name(left_by(), SimpleNamespace(score=score)) is expected


def test_real_machines_leave_more():
    assert not left_beside_name(left_by(dispersion=50.0), NAMED, 0.7, 30.0)
    assert left_beside_name(left_by(dispersion=50.0), NAMED, 0.3, 30.0)


@pytest.mark.parametrize(
    ("verdict", "expected"), [("effect", ("a", "b")), ("none", ("a", "b", "d")), ("unexplained", ())]
)
def test_what_may_not_be_named_need_not_be_ruled_out(monkeypatch, verdict, expected):
    def one(name, score):
        hypothesis = SimpleNamespace(effects=[(SimpleNamespace(name=name), (1.0,))])
        return SimpleNamespace(hypothesis=hypothesis, score=score)

    def small(bench, judged):
        return judged.hypothesis.effects[0][0].name == "c"

    monkeypatch.setattr("btr_mjx.gap.inference.verdict.identify.within_calibration", small)
    first = [one("a", 100.0), one("b", 90.0), one("c", 20.0), one("d", 16.0), one("e", 14.0)]
    assert undecided(SimpleNamespace(contact_sensitive=()), first, verdict) == expected
    assert undecided(SimpleNamespace(contact_sensitive=()), [], verdict) == ()
