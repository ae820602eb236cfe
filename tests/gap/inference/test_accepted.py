"""Who may be called by name, on stand-ins for judged candidates."""

from types import SimpleNamespace

import pytest
from gap_arm import arm

from btr_mjx.gap.effects import EFFECTS, WORLD, Candidate, Scales
from btr_mjx.gap.inference.search import naming
from btr_mjx.gap.inference.search.naming import accepted


@pytest.mark.parametrize(
    ("names", "gain", "held_out", "expected"),
    [
        ("b", 20.0, 6.0, True),
        ("b", 20.0, 2.0, False),  # not seen where it was not fitted
        ("b", -8.0, 60.0, False),  # nor where it was
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
    judged = SimpleNamespace(hypothesis=hypothesis)
    bench = SimpleNamespace(dataset=SimpleNamespace(tolerances={}))
    assert naming.within_calibration(bench, judged) is within


@pytest.mark.parametrize(("size", "expected"), [(0.3, False), (0.5, True)])
def test_what_is_no_larger_than_calibration_leaves_is_not_called_by_name(size, expected):
    assert is_accepted("b", 5000.0, 2000.0, size=size) is expected


@pytest.mark.parametrize(("place", "expected"), [(WORLD, True), (None, False)])
def test_the_ground_needs_less_than_the_contacts_of_a_limb(place, expected):
    assert is_accepted("m", 40.0, 20.0, place=place) is expected
    assert is_accepted("m", 30.0, 15.0, place=place) is False
    assert is_accepted("am", 40.0, 20.0, place=place) is False
    assert is_accepted("m", 100.0, 30.0, place=place) is expected  # 30 % of what the others gain
    assert is_accepted("m", 100.0, 20.0, place=place) is False


def is_accepted(names, gain, held_out, negligible=0.0, size=1.0, place=None, strength=1.0):
    """Beside an effect of 4000 times `strength`; a number costs 10, is `size` and has a tolerance of 0.1."""
    first = [SimpleNamespace(null=0.0, tolerance=0.1, negligible=negligible, shape=False)]
    place = place or SimpleNamespace(members=())
    effects = []
    for name in names:
        single = SimpleNamespace(name=name, parameters=first, place=place, effect=SimpleNamespace(name=name))
        single.singles = (single,)
        effects.append((single, (size,)))
    given = SimpleNamespace(score=4000.0 * strength, gain=2500.0 * strength, held_out=1510.0 * strength)
    given = given if len(names) > 1 else None
    before = (given.score, given.gain, given.held_out) if given else (0.0, 0.0, 0.0)
    judged = SimpleNamespace(
        score=before[0] + gain + held_out - 10.0,
        gain=before[1] + gain,
        held_out=before[2] + held_out,
        hypothesis=SimpleNamespace(effects=effects),
    )
    side = SimpleNamespace(windows=range(20))
    data = SimpleNamespace(tolerances={})
    bench = SimpleNamespace(contact_sensitive={"m", "n"}, dispersion=1.0, fit=side, test=side, dataset=data)
    return accepted(bench, judged, given)
