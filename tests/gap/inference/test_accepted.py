"""Who may be called by name, on stand-ins for judged candidates."""

from types import SimpleNamespace

import numpy as np
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
        ("b", 5000.0, 15.0, True),  # a limit that few recordings reach
        ("ab", 60.0, 20.0, True),  # counted beside the first
        ("mb", 60.0, 20.0, True),
        ("ab", 20.0, 6.0, False),  # less than 1 % of the first
    ],
)
def test_what_may_be_called_by_name(names, gain, held_out, expected):
    assert is_accepted(names, gain, held_out) is expected


@pytest.mark.parametrize("names", ["m", "am"])
@pytest.mark.parametrize(("gain", "expected"), [(60.0, False), (200.0, True)])
def test_what_moves_contacts_is_a_matter_of_chance(names, gain, expected):
    assert is_accepted(names, gain, 40.0) is expected


@pytest.mark.parametrize(("least", "expected"), [(0.9, True), (1.1, False)])
def test_what_is_smaller_than_any_simulation_is_not_called_by_name(least, expected):
    assert is_accepted("b", 5000.0, 2000.0, least) is expected


@pytest.mark.parametrize(
    ("values", "within"),
    [([0.003, -0.11], False), ([0.11, 0.0], False), ([0.002, -0.0025], True), ([-0.0045, 0.001], False)],
)
def test_a_slope_along_either_axis_is_larger_than_calibration_leaves(values, within):
    slope = next(effect for effect in EFFECTS if effect.name == "ground_slope")
    candidate = Candidate(slope, WORLD, slope.parameters(arm(), Scales.of(arm()), WORLD))
    hypothesis = SimpleNamespace(effects=((candidate, values),))
    judged = SimpleNamespace(hypothesis=hypothesis)
    bench = SimpleNamespace(tolerances={candidate.name: 0.001})
    assert naming.within_calibration(bench, judged) is within


@pytest.mark.parametrize(("size", "expected"), [(0.3, False), (0.5, True)])
def test_what_is_no_larger_than_calibration_leaves_is_not_called_by_name(size, expected):
    assert is_accepted("b", 5000.0, 2000.0, size=size) is expected


@pytest.mark.parametrize(
    ("before", "after", "expected"), [(3.0, 2.9, True), (3.0, 3.0, False), (3.0, 3.4, False), (3.0, np.nan, False)]
)
@pytest.mark.parametrize("names", ["b", "ab"])
def test_a_name_makes_the_held_out_gap_smaller(names, before, after, expected):
    assert is_accepted(names, 200.0, 80.0, gaps=(before, after)) is expected


def test_a_second_name_makes_the_gap_smaller_than_the_first_one_did():
    assert not is_accepted("ab", 200.0, 80.0, gaps=(3.0, 2.0), reached=1.5)


def is_accepted(names, gain, held_out, negligible=0.0, size=1.0, gaps=(3.0, 2.0), reached=3.0):
    """The last of some effects, beside those before; a number costs 10, is `size` and has a tolerance of 0.1."""
    first = [SimpleNamespace(null=0.0, tolerance=0.1, negligible=negligible, shape=False)]
    effects = []
    for name in names:
        place, effect = SimpleNamespace(members=()), SimpleNamespace(name=name)
        single = SimpleNamespace(name=name, parameters=first, place=place, effect=effect)
        single.singles = (single,)
        effects.append((single, (size,)))
    given = SimpleNamespace(score=4000.0, gain=2500.0, held_out=1510.0) if len(names) > 1 else None
    before = (given.score, given.gain, given.held_out) if given else (0.0, 0.0, 0.0)
    judged = SimpleNamespace(
        score=before[0] + gain + held_out - 10.0,
        gain=before[1] + gain,
        held_out=before[2] + held_out,
        hypothesis=SimpleNamespace(effects=effects),
    )
    bench = SimpleNamespace(contact_sensitive={"m"}, tolerances=dict.fromkeys("abm", 0.1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(naming, "held_out_chi2", lambda _, one: gaps if one is judged else (gaps[0], reached))
        return accepted(bench, judged, given)
