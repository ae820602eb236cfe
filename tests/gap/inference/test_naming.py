"""Who may be called by name, and who comes first, on an arm with more damping at the elbow."""

from dataclasses import replace

import numpy as np
import pytest
from gap_arm import arm, dataset

from btr_mjx.gap.effects import EFFECTS, WORLD, Candidate, Hypothesis, Scales
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.finalists import Finalists
from btr_mjx.gap.inference.search.naming import acceptable, accepted, within_calibration
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.outcome import equivalent
from btr_mjx.gap.windows import Options

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature", "joint_offset"))


@pytest.fixture(scope="module")
def bench() -> Bench:
    def damped(model):
        model.dof_damping[1] += 0.1

    return Bench(dataset(damped, seed=4, fit=2, test=1), LIBRARY, Options(steps=4e4, leaders=3, contact_leaders=0))


@pytest.fixture(scope="module")
def first(bench: Bench) -> list[Judged]:
    return Finalists(bench)(bench.find())


def small(bench: Bench, judged: Judged) -> Judged:
    """The same with a size of half a tolerance."""
    candidate, _ = judged.hypothesis.effects[-1]
    size = candidate.null + 0.5 * bench.tolerances[candidate.name]
    return replace(judged, hypothesis=bench.base.with_effect(candidate, size))


def test_what_the_robot_has_is_named_and_nothing_beside_it(bench: Bench, first: list[Judged]) -> None:
    best = first[0]
    assert best.name == "viscous_damping@joint:elbow"
    assert accepted(bench, best, None)
    assert not [j.name for j in bench.find(best) if accepted(bench, j, best)]


@pytest.mark.parametrize("lost", ["score", "gain", "held_out"])
def test_a_name_needs_its_price_and_a_gain_where_it_was_fitted_and_where_it_was_not(
    bench: Bench, first: list[Judged], lost: str
) -> None:
    assert not accepted(bench, replace(first[0], **{lost: 0.0}), None)


@pytest.mark.parametrize("factor", [2.0, np.nan])
def test_a_name_makes_the_held_out_gap_smaller(bench: Bench, first: list[Judged], factor: float) -> None:
    base = bench.nuisance(bench.test).profile(bench.test.windows.residual, bench.cut)
    assert not accepted(bench, replace(first[0], fits=(first[0].fits[0], replace(base, chi2=factor * base.chi2))), None)


def test_what_is_no_larger_than_calibration_leaves_has_no_name(bench: Bench, first: list[Judged]) -> None:
    assert not within_calibration(bench, first[0])
    assert within_calibration(bench, small(bench, first[0]))
    assert not accepted(bench, small(bench, first[0]), None)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_slope_along_either_axis_is_larger_than_calibration_leaves(
    bench: Bench, first: list[Judged], axis: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slope = next(effect for effect in EFFECTS if effect.name == "ground_slope")
    candidate = Candidate(slope, WORLD, slope.parameters(arm(), Scales.of(arm()), WORLD))
    monkeypatch.setitem(bench.tolerances, candidate.name, 0.001)
    for size, within in ((0.1, False), (-0.1, False), (0.0001, True)):
        values = tuple(size * (np.arange(2) == axis))
        judged = replace(first[0], hypothesis=Hypothesis((), (), ((candidate, values),)))
        assert within_calibration(bench, judged) is within


def test_the_order_changes_only_where_data_cannot_tell_candidates_apart(bench: Bench, first: list[Judged]) -> None:
    """A name gives way to what calibration leaves; what may not be named to an equal that may."""
    best, usual = first[0], small(bench, first[0])
    assert acceptable(bench, first, None)[0] is best
    assert acceptable(bench, [best, usual], None) == [usual, best]
    weak = replace(usual, score=0.01 * best.score)
    assert acceptable(bench, [best, weak], None) == [best, weak]
    unnamed = replace(best, held_out=0.0)
    assert acceptable(bench, [unnamed, best], None) == [best, unnamed]
    assert acceptable(bench, [], None) == []


def test_scores_of_what_moves_contacts_are_less_certain(first: list[Judged]) -> None:
    """It is equivalent further away; equals are equivalent, what explains nothing is not."""
    names = {j.hypothesis.effects[-1][0].name for j in first}
    for judged in (first, [first[0], replace(first[1], score=0.95 * first[0].score)]):
        assert equivalent(judged)[0] == first[0].name
        assert set(equivalent(judged)) <= set(equivalent(judged, names))
    assert len(equivalent([first[0], replace(first[1], score=first[0].score)])) == 2
    assert len(equivalent([first[0], replace(first[1], score=0.0)], names)) == 1
