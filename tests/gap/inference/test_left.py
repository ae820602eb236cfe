"""What a name may leave, and what is missing, or not ruled out, though nothing may be named."""

from types import SimpleNamespace

import numpy as np
import pytest

from btr_mjx.gap.effects import Parameter, Place
from btr_mjx.gap.inference.scoring.leftover import FeatureGain, Leftover
from btr_mjx.gap.inference.verdict.check import Check
from btr_mjx.gap.inference.verdict.identify import (
    grows,
    left_beside_name,
    left_without_name,
    undecided,
)


def left_by(gains, dispersion=1.0, confirmed=None):
    """A check in which hypotheses leave given gains at one joint, of which 45 may be chance."""
    left = {gain: Leftover(*np.zeros((3, 1)), left, None) for gain, left in gains.items()}
    bench = SimpleNamespace(dispersion=dispersion, contact_sensitive=frozenset())
    chance = SimpleNamespace(excess=5.5, usual=-np.inf)
    return SimpleNamespace(
        bench=bench,
        gain=45.0,
        spread=lambda _: True,
        excess_at_joint=lambda there: Check.excess_at_joint(chance, there),  # type: ignore[arg-type]
        left=lambda judged: left[judged.gain],
        confirmed_feature=lambda _: confirmed,
        significant_feature=lambda judged: (
            FeatureGain(0, 1.0, left[judged.gain].gain) if left[judged.gain].gain > 45.0 else None
        ),
    )


def gained(gain):
    return SimpleNamespace(gain=gain, hypothesis=SimpleNamespace(effects=()))


@pytest.mark.parametrize(
    ("left", "expected"),
    [
        ({1000.0: 40.0}, False),  # chance
        ({1000.0: 100.0}, True),
        ({5000.0: 100.0}, False),  # little beside what the name explains
        ({1000.0: 300.0, 1200.0: 40.0}, True),  # a second name explains less than a force of another shape
        ({1000.0: 300.0, 1500.0: 40.0}, False),  # two effects
    ],
)
def test_what_a_name_may_leave(left, expected):
    named = [gained(gain) for gain in left]
    assert left_beside_name(left_by(left), named, 0.9, 0.0) is expected


def test_a_name_must_explain_most_of_a_lack_of_fit():
    named = [gained(1000.0)]
    little = left_by({1000.0: 0.0})
    assert left_beside_name(little, named, 0.3, 3.5)
    assert not left_beside_name(little, named, 0.3, 1.0)  # chance
    assert not left_beside_name(little, named, 0.8, 3.5)
    little.spread = lambda _: False  # in a few windows
    assert not left_beside_name(little, named, 0.3, 3.5)


@pytest.mark.parametrize(
    ("excess", "chi2", "usual", "rough", "expected"),
    [
        (5.4, 500.0, 2.0, False, False),
        (5.6, 59.0, 2.0, False, False),
        (5.6, 61.0, 2.0, False, True),
        (5.6, 61.0, 0.0, False, True),
        (5.6, 61.0, 0.9, True, False),  # touchdowns at another time throw a few windows
        (5.6, 61.0, 1.1, True, True),
    ],
)
def test_what_a_name_may_leave_at_a_joint(excess, chi2, usual, rough, expected):
    left = Leftover(np.array([excess, 0.0]), np.array([chi2, 900.0]), np.array([usual, 9.0]), 0.0, None)
    check, named = left_by({}), gained(1000.0)
    chance = SimpleNamespace(excess=5.5, usual=1.0 if rough else -np.inf)
    check.left, check.significant_feature = (lambda _: left), (lambda _: None)
    check.excess_at_joint = lambda there: Check.excess_at_joint(chance, there)  # type: ignore[arg-type]
    assert left_beside_name(check, [named], 0.9, 0.0) is expected


def test_a_name_is_none_where_held_out_recordings_know_of_something_else():
    named = [gained(1000.0)]
    assert left_beside_name(left_by({1000.0: 0.0}, confirmed="position cubed"), named, 0.9, 0.0)


def unnamed(score, offset):
    """A candidate that may not be named: a spring so far from none."""
    number = Parameter("stiffness", "N m/rad", -1.0, 1.0, 0.01)
    effect = SimpleNamespace(name="joint_stiffness")
    candidate = SimpleNamespace(
        name="joint_stiffness@elbow", effect=effect, parameters=(number,), null=np.zeros(1), place=Place("joint:elbow")
    )
    candidate.singles = (candidate,)
    return SimpleNamespace(score=score, hypothesis=SimpleNamespace(effects=((candidate, (offset,)),)))


@pytest.mark.parametrize(
    ("score", "size", "expected"),
    [
        (None, 0.0, False),  # nothing at all
        (40.0, 0.5, False),  # weak, not strange
        (80.0, 0.5, True),  # too much for chance
        (80.0, 0.02, False),  # calibration
    ],
)
def test_what_may_not_be_named_may_still_be_missing(score, size, expected):
    check = left_by({})
    check.surprise = lambda _: 0.0
    check.left = lambda _: Leftover(*np.zeros((3, 1)), 0.0, None)
    check.significant_feature = lambda _: None
    check.bench.dataset = SimpleNamespace(tolerances={"joint_stiffness": 0.01})
    best = None if score is None else unnamed(score, size)
    assert left_without_name(check, best) is expected
    if not expected:
        check.confirmed_feature = lambda _: "position cubed"
        assert left_without_name(check, best)
        check.confirmed_feature, check.significant_feature = (lambda _: None), (lambda _: FeatureGain(0, 1.0, 50.0))
        assert left_without_name(check, best)


@pytest.mark.parametrize(
    ("rough", "held_out", "expected"),
    [
        (False, [10.0, 9.0], 0),
        (False, [-20.0, -9.0], 0),
        (False, [-40.0, -9.0], 1),
        (False, [-40.0, -30.0], None),
        (True, [16.0, -9.0], 0),
        (True, [14.0, 13.0], 1),
        (True, [14.0, 12.0], None),
    ],
    ids=["known", "hardly known", "denied", "both denied", "likely", "the other one", "rough touchdowns"],
)
def test_what_held_out_recordings_speak_against_is_not_strange(rough, held_out, expected):
    """Gains of 60 and 50 on the recordings to fit, of which 45 may be chance."""
    feature_gains = (FeatureGain(0, 1.0, 60.0), FeatureGain(1, 1.0, 50.0), FeatureGain(2, 1.0, 40.0))
    asked = list(zip(feature_gains, held_out, strict=False))
    sides = [SimpleNamespace(windows=range(count)) for count in (50, 25)]  # 30 and 25 are to be expected held out
    stub = SimpleNamespace(gain=45.0, rough=rough, sides=sides, _asked=lambda judged, least: asked)
    found = Check.significant_feature(stub, None)  # type: ignore[arg-type]
    assert (found and found.index) == expected


def test_real_machines_leave_more():
    named = [gained(1000.0)]
    assert not left_beside_name(left_by({}, dispersion=50.0), named, 0.7, 30.0)
    assert left_beside_name(left_by({}, dispersion=50.0), named, 0.3, 30.0)


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


@pytest.mark.parametrize(("held_out", "expected"), [(400.0, 0), (31.0, 0), (29.0, None)])
def test_held_out_recordings_of_rough_touchdowns_need_not_know_of_all_that_is_strange(held_out, expected):
    """What is outside the library gained 9730 on the recordings to fit and 409 held out."""
    sides = [SimpleNamespace(windows=range(50))] * 2
    asked = [(FeatureGain(0, 1.0, 9730.0), held_out)]
    stub = SimpleNamespace(gain=45.0, rough=True, sides=sides, _asked=lambda judged, least: asked)
    found = Check.significant_feature(stub, None)  # type: ignore[arg-type]
    assert (found and found.index) == expected


@pytest.mark.parametrize(("before", "after", "expected"), [(3.0, 2.9, False), (3.0, 3.0, True), (3.0, 3.4, True)])
def test_a_name_with_which_the_gap_does_not_shrink_is_none(before, after, expected):
    assert grows((before, after)) is expected
