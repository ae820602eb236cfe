"""Naming the missing effect of an arm: from recordings to a verdict."""

import dataclasses

import numpy as np
import pytest
from gap_arm import LIBRARY, QUICK, damped, dataset, recording
from threadpoolctl import threadpool_info, threadpool_limits

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.effects.similar import HARDENING_SPRING
from btr_mjx.gap.inference import Bench, Hypothesis, identify
from btr_mjx.gap.inference.scoring.gains import fall, luckiest
from btr_mjx.gap.inference.scoring.hypotheses import unknowns
from btr_mjx.gap.inference.search import naming as search_naming
from btr_mjx.gap.inference.verdict import identify as naming
from btr_mjx.gap.inference.verdict.outcome import equivalent, overlays
from btr_mjx.gap.windows import Fit
from btr_mjx.models import PathParameter


@pytest.fixture(scope="module")
def found():
    return identify(dataset(damped, seed=1), LIBRARY, max_effects=1, options=QUICK)


def test_damping_at_the_elbow_is_named(found):
    assert found.verdict == "effect"
    (named,) = found.effects
    assert named.name == "viscous_damping@joint:elbow"
    estimate = named.parameters["damping"]
    assert estimate.value == pytest.approx(0.1, rel=0.1)
    assert estimate.low < estimate.value < estimate.high
    assert estimate.unit == "N m s/rad"
    assert found.equivalent[0] == named.name


def test_three_recordings_are_enough():
    """One window held out is all that there is to confirm a name, and not a stroke of luck to be left out."""
    few = identify(dataset(damped, seed=1, fit=2, test=1), LIBRARY, max_effects=1, options=QUICK)
    assert [named.name for named in few.effects] == ["viscous_damping@joint:elbow"]


def test_linear_algebra_stays_in_the_threads_of_the_search():
    def threads(*_):
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    during = []
    with threadpool_limits(2, "blas"):
        before = threads()
        identify(
            dataset(damped, seed=1, fit=1, test=1),
            LIBRARY[:1],
            max_effects=1,
            options=QUICK,
            progress=lambda word: during.extend(threads()),
        )
        assert threads() == before
    assert set(during) == {1}


def test_luck_counts_where_windows_are_many():
    falls = np.full(20, 2.0)
    falls[3] = 500.0
    assert luckiest(falls) == pytest.approx(3 * 2 + 15)  # the outlier, within what is usual
    assert luckiest(-falls) == 0.0
    assert luckiest(np.array([40.0])) == 0.0
    assert luckiest(np.array([40.0, 40.0])) == pytest.approx(40.0 / 8)


def test_what_one_window_alone_gains_is_left_out():
    chi2 = np.full(20, 2.0)
    chi2[3] = 500.0  # a limit that is reached once
    before, after = (Fit(np.zeros(0), float(c.sum()), c, np.zeros((0, 0))) for c in (chi2, np.zeros(20)))
    assert fall(before, after, 1e4) == pytest.approx(19 * 2.0)


def test_the_gap_closes_on_held_out_recordings(found):
    assert found.chi2.before > 2 * found.chi2.after
    assert found.chi2.after == pytest.approx(1.0, abs=0.2)
    assert found.misfit.explained > 0.9
    assert found.misfit.noise_reached
    assert found.chi2.nulls == pytest.approx(1.0, abs=0.2)
    assert found.open_loop.after < 0.3 * found.open_loop.before


def test_stretches_that_are_shown_are_those_on_which_both_models_differ(found):
    names = {r.name for r in dataset(damped, seed=1).recordings if r.split == "test"}
    assert {one.recording for one in found.overlays[: len(names)]} == names  # they take turns
    for one in found.overlays:
        assert one.coordinate == "joint:elbow"
        before, after = (np.abs(values - one.measured).mean() for values in (one.before, one.after))
        assert after < 0.8 * before
    nothing = overlays(Bench(dataset(seed=1, fit=2, test=1), LIBRARY[:1], QUICK), None)
    assert all(np.array_equal(one.before, one.after) for one in nothing)
    assert nothing


def test_the_map_points_at_the_elbow_in_fast_motion(found):
    table = found.disagreement
    assert table.places == ("joint:shoulder", "joint:elbow")
    relative = dict(zip(table.regimes, table.relative[1], strict=True))
    assert relative["all"] > 3
    assert table.relative[1, 0] > 2 * table.relative[0, 0]
    assert np.isnan(relative["contact"])
    assert table.units == ("N m", "N m")
    assert table.before[1, table.regimes.index("fast")] > table.before[1, table.regimes.index("slow")]


def test_the_ranking_is_ordered_and_complete(found):
    scores = [row.score for row in found.ranking]
    assert scores == sorted(scores, reverse=True)
    assert found.ranking[0].margin == 0
    assert found.ranking[0].score > 0
    assert found.steps > 0


@pytest.mark.parametrize("noise", [1.0, 1.2])
def test_nothing_is_named_where_nothing_is_missing(noise):
    """Whatever noise was declared: the believed model lies on the floor of the noise that the data have."""
    found = identify(dataset(seed=2, noise=noise), LIBRARY, options=QUICK)
    assert found.verdict == "none"
    assert not found.effects
    assert found.chi2.before == found.chi2.after
    assert found.chi2.nulls == pytest.approx(noise**2, rel=0.15)
    assert found.chi2.before == pytest.approx(found.chi2.nulls, rel=0.15)
    assert found.misfit.before < 3  # smoothed states err at the ends of a recording
    assert found.misfit.after is None


def test_believed_numbers_are_refitted_before_anything_is_called_missing():
    believed = (PathParameter("elbow damping", ("joint:elbow/damping",), 0.0, 1.0),)
    found = identify(dataset(damped, seed=1, parameters=believed), LIBRARY, options=QUICK)
    assert found.verdict == "none"
    (row,) = found.believed
    assert row.believed == pytest.approx(0.05)
    assert row.refitted == pytest.approx(0.15, rel=0.1)


def test_a_name_whose_held_out_gap_grows_is_no_verdict(monkeypatch):
    """Whatever the search found, and however it came to it."""
    real = search_naming.held_out_chi2

    def grown(bench, judged):
        before, after = real(bench, judged)
        return (before, after) if judged is None else (before, 1.01 * before)

    monkeypatch.setattr(search_naming, "held_out_chi2", grown)
    bench = Bench(dataset(damped, seed=1, fit=2, test=1), LIBRARY[:1], QUICK)
    found = naming.name_missing(bench, max_effects=1)
    assert found.verdict == "unexplained"
    assert not found.effects
    assert found.chi2.after == found.chi2.before


def test_something_outside_the_library_is_called_unexplained():
    def spring(model):
        model.jnt_stiffness[0] = 4.0
        model.qpos_spring[0] = 0.5

    only = tuple(e for e in LIBRARY if e.name in ("viscous_damping", "armature"))
    found = identify(dataset(spring, seed=3), only, options=QUICK)
    assert found.verdict == "unexplained"
    assert not found.effects
    assert found.unexplained[0].startswith("joint shoulder: ")


SPRINGS = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "joint_stiffness", "armature"))


def test_a_spring_is_called_a_spring():
    def spring(model):
        model.jnt_stiffness[1] += 0.1

    found = identify(dataset(spring, seed=6), SPRINGS, options=QUICK)
    assert [named.name for named in found.effects] == ["joint_stiffness@joint:elbow"]
    assert found.unexplained == ()


@pytest.mark.parametrize("stiffness", [0.1, 0.03])
def test_a_spring_on_one_side_is_not_called_a_spring(stiffness):
    """A cord that pulls in one half of the range: stiffness explains most of it, but not its shape."""

    def cord(model):
        model.tendon_stiffness[0] = stiffness

    found = identify(dataset(cord, seed=6), SPRINGS, options=QUICK)
    assert found.ranking[0].effect == "joint_stiffness"
    assert found.verdict == "unexplained"
    assert found.unexplained[0] == "joint elbow: what is left there looks like a spring with a corner"


def test_who_expects_a_twin_may_name_it():
    def hard(model):
        model.jnt_stiffnesspoly[1, 1] += 0.1

    data = dataset(hard, seed=6)
    unknown = identify(data, SPRINGS, max_effects=1, options=QUICK)
    assert unknown.verdict == "unexplained"
    known = identify(data, (*SPRINGS, HARDENING_SPRING), max_effects=1, options=QUICK)
    assert [named.name for named in known.effects] == ["hardening_spring@joint:elbow"]
    assert known.effects[0].parameters["cubic"].value == pytest.approx(0.1, rel=0.1)


def test_two_effects_at_once():
    def both(model):
        damped(model)
        model.dof_armature[0] += 0.03

    found = identify(dataset(both, seed=4), LIBRARY, max_effects=2, options=QUICK)
    assert {named.name for named in found.effects} == {"viscous_damping@joint:elbow", "armature@joint:shoulder"}


def test_results_are_bit_identical():
    made = dataset(damped, seed=5, fit=2, test=1)
    benches = [Bench(made, LIBRARY[:1], QUICK) for _ in range(2)]
    first, second = (bench.find() for bench in benches)
    assert [(j.name, j.score) for j in first] == [(j.name, j.score) for j in second]


def test_both_sides_of_the_split_are_needed():
    with pytest.raises(InputError, match="split 'test'"):
        identify(dataset(fit=2, test=0), LIBRARY, options=QUICK)


def test_hypotheses_keep_their_numbers_in_order():
    bench = Bench(dataset(damped, seed=1, fit=2, test=1), LIBRARY, QUICK)
    first, second = bench.candidates[0], next(c for c in bench.candidates if c.effect.name == "actuator_gain")
    believed = (PathParameter("elbow damping", ("joint:elbow/damping",), 0.0, 1.0),)
    made = Hypothesis(believed, (0.2,)).with_effect(first, [0.3]).with_effect(second, [0.004])
    np.testing.assert_allclose(made.values(True), [0.2, 0.3, 0.004])
    again = made.replaced(np.array([0.1, 0.2, 0.3]), True)
    np.testing.assert_allclose(again.values(False), [0.2, 0.3])
    assert again.believed == (0.1,)
    assert unknowns(made, True).low.shape == made.values(True).shape
    assert made.name == f"{first.name} + {second.name}"
    judged = bench.find()
    assert equivalent(judged)[0] == judged[0].name


def test_uneven_samples_without_velocities():
    believed = dataset(fit=1, test=1).model
    recordings = tuple(
        recording(f"u{i}", damped, 50 + i, "fit" if i < 3 else "test", believed=believed, uneven=True, duration=0.7)
        for i in range(5)
    )
    blind = tuple(
        dataclasses.replace(r, qvel=np.full_like(r.qvel, np.nan), qvel_measured=np.zeros(2, bool)) for r in recordings
    )
    made = dataclasses.replace(dataset(fit=1, test=1), recordings=blind)
    found = identify(made, LIBRARY[:2], max_effects=1, options=QUICK)
    assert found.verdict == "effect"
    assert found.effects[0].location == "joint:elbow"
