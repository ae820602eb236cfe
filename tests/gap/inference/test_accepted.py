"""Who may be called by name, on stand-ins for judged candidates."""

from types import SimpleNamespace
from unittest.mock import MagicMock, patch

import numpy as np
import pytest
from gap_arm import arm

from btr_mjx.gap.effects import EFFECTS, WORLD, Candidate, Scales
from btr_mjx.gap.inference.search import naming
from btr_mjx.gap.inference.search.held_out import likely, unmoved, vouched
from btr_mjx.gap.inference.search.naming import accepted


@pytest.mark.parametrize(
    ("names", "gain", "held_out", "expected"),
    [
        ("b", 20.0, 6.0, True),
        ("b", 20.0, 2.0, False),  # not seen where it was not fitted
        ("b", 9.0, 4.0, False),  # worth no more than its price
        ("b", 900.0, 25.0, False),  # too little held out beside what was fitted
        ("b", 900.0, 40.0, True),
        ("b", 5000.0, 150.0, True),  # little beside that, but certain: a limit that few recordings reach
        ("m", 80.0, 20.0, False),  # contacts are a matter of chance
        ("m", 90.0, 40.0, True),
        ("m", 120.0, 40.0, False),  # and one side has it all
        ("m", 400.0, 50.0, True),  # but this is enough
        ("ab", 40.0, 20.0, True),
        ("ab", 30.0, 10.0, False),  # less than 1 % of the first effect
        ("ab", 16.0, 10.0, False),  # enough for a first effect
        ("am", 100.0, 20.0, False),
        ("am", 110.0, 40.0, True),
        ("mb", 45.0, 20.0, False),  # less than 2 % of a first effect that moves contacts
        ("mb", 60.0, 20.0, True),  # but this is enough of what moves none
    ],
)
def test_what_may_be_called_by_name(names, gain, held_out, expected):
    assert is_accepted(names, gain, held_out) is expected


@pytest.mark.parametrize(("names", "expected"), [("ab", True), ("mb", True), ("am", False), ("mn", False)])
def test_beside_a_very_strong_effect_so_much_is_enough_of_what_moves_no_contacts(names, expected):
    assert is_accepted(names, 200.0, 80.0, strength=10.0) is expected
    assert is_accepted(names, 50.0, 18.0, strength=10.0) is False


@pytest.mark.parametrize(
    ("gain", "held_out", "fresh", "expected"),
    [
        (20.0, 1.0, 0.0, False),
        (20.0, 1.0, 8.0, True),  # seen in fresh windows instead
        (-8.0, 60.0, 0.0, False),
        (-8.0, 60.0, 40.0, True),  # those are of the recordings to fit
        (40.0, 6.0, -5.0, False),
    ],
)
def test_fresh_windows_have_a_say(gain, held_out, fresh, expected):
    assert is_accepted("b", gain, held_out, fresh=fresh) is expected


@pytest.mark.parametrize(
    ("name", "held_out", "hopes", "expected"),
    [
        ("b", 6.0, 10.0, True),  # held-out recordings hardly see it, and what they see is there
        ("b", 6.0, 20.0, True),  # less of it, as noise may have it
        ("b", 6.0, 60.0, False),
        ("b", 2.0, 3.0, False),
        ("b", 25.0, 1e3, False),
        ("m", 6.0, 10.0, False),  # contacts are a matter of chance
    ],
)
def test_held_out_recordings_need_not_gain_more_than_a_name_foresees(name, held_out, hopes, expected):
    assert is_accepted(name, 900.0, held_out, hopes=hopes) is expected


@pytest.mark.parametrize("hope", [20.0, 40.0, 60.0])
def test_noise_hardly_ever_makes_a_true_name_gain_less_than_is_likely(hope):
    """Gains of simulated data around the simulation of a true name, against the simulation without it."""
    rng = np.random.default_rng(3)
    away = np.sqrt(hope / 50) * np.ones(50)
    noise = rng.normal(size=(20_000, 50))
    gains = ((away + noise) ** 2).sum(1) - (noise**2).sum(1)
    assert np.mean(gains < likely(hope)) == pytest.approx(0.023, abs=0.005)


def test_half_of_what_is_foreseen_is_enough_where_that_is_much():
    assert likely(100.0) == 50.0
    assert likely(0.0) == 0.0


@pytest.mark.parametrize(("least", "expected"), [(0.9, True), (1.1, False)])
def test_what_is_smaller_than_any_simulation_is_not_called_by_name(least, expected):
    assert is_accepted("b", 5000.0, 2000.0, least) is expected


@pytest.mark.parametrize(
    ("values", "within"),
    [([0.003, -0.11], False), ([0.11, 0.0], False), ([0.003, -0.0035], True), ([-0.0045, 0.001], False)],
)
def test_a_slope_along_either_axis_is_larger_than_calibration_leaves(values, within):
    slope = next(effect for effect in EFFECTS if effect.name == "ground_slope")
    candidate = Candidate(slope, WORLD, slope.parameters(arm(), Scales.of(arm()), WORLD))
    hypothesis = SimpleNamespace(effects=((candidate, values),))
    judged = SimpleNamespace(widest=SimpleNamespace(hypothesis=hypothesis))
    bench = SimpleNamespace(dataset=SimpleNamespace(tolerances={}))
    assert naming.within_calibration(bench, judged) is within


@pytest.mark.parametrize(("size", "expected"), [(0.3, False), (0.5, True)])
def test_calibration_is_asked_of_the_numbers_that_suit_all_windows(size, expected):
    assert is_accepted("b", 5000.0, 2000.0, size=size) is expected


@pytest.mark.parametrize(("place", "expected"), [(WORLD, True), (None, False)])
def test_the_ground_needs_less_than_the_contacts_of_a_limb(place, expected):
    assert is_accepted("m", 40.0, 20.0, place=place) is expected
    assert is_accepted("m", 30.0, 15.0, place=place) is False
    assert is_accepted("am", 40.0, 20.0, place=place) is False
    assert is_accepted("m", 100.0, 30.0, place=place) is expected  # 30 % of what the others gain
    assert is_accepted("m", 100.0, 20.0, place=place) is False


@pytest.mark.parametrize(("limb", "expected"), [("", False), ("m", False), ("mn", True)])
def test_where_calibration_can_be_asked_a_limb_needs_less(monkeypatch, limb, expected):
    monkeypatch.setattr("btr_mjx.gap.inference.search.naming.limb_of", lambda bench, judged: list(limb))
    assert is_accepted("m", 40.0, 20.0) is expected
    assert is_accepted("m", 50.0, 10.0) is expected  # less than contacts need held out
    assert is_accepted("m", 30.0, 15.0) is False
    assert is_accepted("m", 50.0, 2.0) is False
    assert is_accepted("am", 40.0, 20.0) is False
    assert is_accepted("m", 500.0, 200.0, explained=True) is False


@pytest.mark.parametrize(
    ("names", "falls", "held_out", "hopes", "expected"),
    [
        ("a", [100.0, 40.0], 1.0, 0.1, True),  # little was to be expected of held-out recordings
        ("a", [100.0, 40.0], -1.0, 0.1, False),  # they speak against it
        ("a", [100.0, 40.0], 1.0, 10.0, False),  # more was to be expected
        ("a", [140.0, 4.0], 1.0, 0.1, False),  # only one of those that were fitted knows of it
        ("m", [100.0, 40.0], 1.0, 0.1, False),
        ("ba", [100.0, 40.0], 1.0, 0.1, True),
    ],
)
def test_where_held_out_recordings_can_say_little_they_need_not(names, falls, held_out, hopes, expected):
    assert is_accepted(names, sum(falls), held_out, hopes=hopes, falls=falls) is expected


def is_accepted(
    names,
    gain,
    held_out,
    negligible=0.0,
    fresh=0.0,
    size=1.0,
    place=None,
    explained=False,
    hopes=np.inf,
    falls=(),
    strength=1.0,
):
    """Beside an effect of 4000 times `strength`; a number costs 10, is 1 and has a tolerance of 0.1.

    On more windows it is `size`. Chi^2 falls by `falls` in a window of each recording to fit.
    """
    first = [SimpleNamespace(null=0.0, tolerance=0.1, negligible=negligible, shape=False)]
    place = place or SimpleNamespace(members=())
    effects = [
        (
            SimpleNamespace(name=name, null=[0.0], parameters=first, place=place, effect=SimpleNamespace(name=name)),
            (1.0,),
        )
        for name in names
    ]
    given = SimpleNamespace(score=4000.0 * strength, gain=2500.0 * strength, held_out=1510.0 * strength)
    given = given if len(names) > 1 else None
    before = (given.score, given.gain, given.held_out) if given else (0.0, 0.0, 0.0)
    judged = SimpleNamespace(
        score=before[0] + gain + held_out + fresh - 10.0,
        gain=before[1] + gain,
        held_out=before[2] + held_out,
        fresh=fresh,
        hypothesis=SimpleNamespace(effects=effects),
        before=fits([300.0] * 20, [9.0]),
        fits=fits(300.0 - np.array([*falls, *[0.0] * (20 - len(falls))]), [0.0]),
        explained=explained,
    )
    more = [(candidate, (size,)) for candidate, _ in effects]
    judged.widest = SimpleNamespace(hypothesis=SimpleNamespace(effects=more))
    windows = MagicMock(recording=np.arange(20), freedom=300.0)
    windows.__len__.return_value = 20
    side, data = SimpleNamespace(windows=windows), SimpleNamespace(tolerances={}, model=None)
    bench = SimpleNamespace(
        delicate={"m", "n"}, dispersion=1.0, fit=side, test=side, dataset=data, candidates=(), cut=1e6
    )
    with patch("btr_mjx.gap.inference.search.naming.foreseen", return_value=hopes):
        return accepted(bench, judged, given)


def fits(*chi2):
    return tuple(SimpleNamespace(chi2=np.array(side)) for side in chi2)


@pytest.mark.parametrize(
    ("falls", "held", "expected"),
    [
        ([300.0, 0.0, 20.0, 10.0], 0.1, True),  # without the first recording 30 are left
        ([300.0, 30.0, 0.0, 0.0], 0.1, False),  # both of the same recording
        ([300.0, 0.0, 20.0, 10.0], 4.0, False),  # held-out recordings do have a say
        ([300.0, 0.0, 20.0, 10.0], -4.0, False),
        ([300.0, 0.0, 20.0, -10.0], 0.1, False),
    ],
)
def test_several_recordings_vouch_for_what_those_held_out_do_not_know(falls, held, expected):
    windows = SimpleNamespace(recording=np.array([0, 0, 1, 2]), freedom=400.0)
    bench = SimpleNamespace(cut=1e6, dispersion=1.0, fit=SimpleNamespace(windows=windows))
    before, after = [500.0, 400.0], 500.0 - np.array(falls)
    judged = SimpleNamespace(before=fits([500.0] * 4, before), fits=fits(after, [500.0, 400.0 - held]))
    assert (unmoved(judged, 3.0) and vouched(bench, judged, 15.0)) is expected


@pytest.mark.parametrize(
    ("before", "after", "dispersion", "expected"),
    [
        (40000.0, 450.0, 1.0, True),
        (3900.0, 450.0, 1.0, False),  # not so far from anything
        (40000.0, 700.0, 1.0, False),  # not explained
        (40000.0, 450.0, 20.0, False),  # beside what nothing explains
    ],
)
def test_one_recording_vouches_for_what_it_cannot_do_without(before, after, dispersion, expected):
    windows = SimpleNamespace(recording=np.array([0, 0, 1, 2]), freedom=400.0)
    bench = SimpleNamespace(cut=600.0, dispersion=dispersion, fit=SimpleNamespace(windows=windows))
    judged = SimpleNamespace(before=fits([before, 400.0, 400.0, 400.0]), fits=fits([after, 410.0, 400.0, 400.0]))
    assert vouched(bench, judged, 15.0) is expected
