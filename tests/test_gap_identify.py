import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from gap_arm import dataset, recording
from threadpoolctl import threadpool_info, threadpool_limits

from btr_mjx.errors import InputError
from btr_mjx.gap.akin_effects import HARDENING_SPRING
from btr_mjx.gap.bodies import AtBody
from btr_mjx.gap.check import Check
from btr_mjx.gap.effect import Parameter
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.gains import luckiest
from btr_mjx.gap.held_out import foreseen
from btr_mjx.gap.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.identify import identify, missing, strange, undecided
from btr_mjx.gap.leftover import Leftover, Told
from btr_mjx.gap.outcome import calibration_of, equivalent
from btr_mjx.gap.places import Place
from btr_mjx.gap.recordings import Believed
from btr_mjx.gap.search import Bench
from btr_mjx.gap.search_records import Options

LIBRARY = tuple(
    e for e in EFFECTS if e.name in ("viscous_damping", "dry_friction", "armature", "actuator_gain", "actuator_delay")
)
QUICK = Options(steps=6e4, leaders=4, contact_leaders=0)


def damped(model):
    model.dof_damping[1] += 0.1


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


def test_a_true_name_gains_what_it_foresees_on_held_out_recordings():
    """Where its parameter is right, chi^2 falls by the squared distance of both simulations, but for the noise."""
    gains = []
    for seed in range(3):
        bench = Bench(dataset(damped, seed=seed), LIBRARY, QUICK)
        elbow = next(c for c in bench.candidates if c.name == "viscous_damping@joint:elbow")
        for size in (0.1, 0.03):
            hypothesis = bench.base.with_effect(elbow, [size])
            residuals = [side.windows.residuals([hypothesis])[0] for side in (bench.fit, bench.test)]
            judged = SimpleNamespace(hypothesis=hypothesis, sides=(bench.fit, bench.test), residual=residuals[1])
            change = bench.test.windows.residual - residuals[1]
            along = bench.nuisance(bench.test, hypothesis)
            left = np.array([(row**2).sum() for row in along.absorbed(change, bench.cut)])
            assert foreseen(bench, judged) <= left.sum() / bench.dispersion + 1e-6
            assert foreseen(bench, judged) >= (left.sum() - left.max()) / bench.dispersion - 1e-6
            gains.append((size, foreseen(bench, judged)))
            if size == 0.1:
                before, after = (along.profile(r, bench.cut) for r in (bench.test.windows.residual, residuals[1]))
                assert bench.fall(before, after) == pytest.approx(foreseen(bench, judged), rel=0.3)
    assert all(large > 5 * small for (_, large), (_, small) in zip(gains[::2], gains[1::2], strict=True))


def test_the_gap_closes_on_held_out_recordings(found):
    assert found.gap.before > 2 * found.gap.after
    assert found.gap.after == pytest.approx(1.0, abs=0.2)
    assert found.gap.closed > 0.9
    assert found.gap.noise_floor == min(found.gap.nulls, found.gap.after)
    assert found.gap.nulls == pytest.approx(1.0, abs=0.2)
    assert found.gap.open_loop_after < 0.3 * found.gap.open_loop_before


def test_the_map_points_at_the_elbow_in_fast_motion(found):
    table = found.disagreement
    assert table.places == ("joint:shoulder", "joint:elbow")
    value = dict(zip(table.regimes, table.value[1], strict=True))
    assert value["all"] > 3
    assert value["fast"] > value["slow"]
    assert table.value[1, 0] > 2 * table.value[0, 0]
    assert np.isnan(value["contact"])


def test_the_ranking_is_ordered_and_complete(found):
    scores = [row.score for row in found.ranking]
    assert scores == sorted(scores, reverse=True)
    assert found.ranking[0].margin == 0
    assert found.ranking[0].score > found.threshold
    assert found.steps > 0


def test_nothing_is_named_where_nothing_is_missing():
    found = identify(dataset(seed=2), LIBRARY, options=QUICK)
    assert found.verdict == "none"
    assert not found.effects
    assert found.gap.before == found.gap.after


@pytest.mark.parametrize("noise", [1.0, 1.2])
def test_the_noise_floor_is_that_of_the_data(noise):
    """Whatever noise was declared: with nothing missing, the believed model lies on the floor."""
    gap = identify(dataset(seed=2, noise=noise), LIBRARY, options=QUICK).gap
    assert gap.noise_floor == pytest.approx(noise**2, rel=0.15)
    assert gap.before == pytest.approx(gap.noise_floor, rel=0.1)


def test_believed_numbers_are_refitted_before_anything_is_called_missing():
    believed = (Believed("elbow damping", ("joint:elbow/damping",), 0.0, 1.0),)
    found = identify(dataset(damped, seed=1, parameters=believed), LIBRARY, options=QUICK)
    assert found.verdict == "none"
    (row,) = found.believed
    assert row.believed == pytest.approx(0.05)
    assert row.refitted == pytest.approx(0.15, rel=0.1)


def test_something_outside_the_library_is_called_unexplained():
    def spring(model):
        model.jnt_stiffness[0] = 4.0
        model.qpos_spring[0] = 0.5

    only = tuple(e for e in LIBRARY if e.name in ("viscous_damping", "armature"))
    found = identify(dataset(spring, seed=3), only, options=QUICK)
    assert found.verdict == "unexplained"
    assert not found.effects
    assert found.unexplained[0].startswith("joint:shoulder")


SPRINGS = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "joint_stiffness", "armature"))


def test_a_spring_is_called_a_spring():
    def spring(model):
        model.jnt_stiffness[1] += 0.1

    found = identify(dataset(spring, seed=6), SPRINGS, options=QUICK)
    assert [named.name for named in found.effects] == ["joint_stiffness@joint:elbow"]


@pytest.mark.parametrize("stiffness", [0.1, 0.03])
def test_a_spring_on_one_side_is_not_called_a_spring(stiffness):
    """A cord that pulls in one half of the range: stiffness explains most of it, but not its shape."""

    def cord(model):
        model.tendon_stiffness[0] = stiffness

    found = identify(dataset(cord, seed=6), SPRINGS, options=QUICK)
    assert (found.ranking[0].effect, found.ranking[0].location) == ("joint_stiffness", "joint:elbow")
    assert found.ranking[0].score > 5 * found.threshold
    assert found.verdict == "unexplained"
    assert found.unexplained[0].startswith("joint:elbow: a spring on one side (τ = −k |q − q_spring|, stiffness ")
    assert found.unexplained[0].endswith("explains what a spring does not (--effects all one_sided_spring names it)")
    half = float(found.unexplained[0].partition("stiffness ")[2].split()[0])
    assert abs(half) == pytest.approx(stiffness / 2, rel=0.15)  # as much again is the stiffness beside it


def test_a_spring_is_not_mistaken_for_what_it_is_not():
    def spring(model):
        model.jnt_stiffness[1] += 0.1

    found = identify(dataset(spring, seed=6), SPRINGS, max_effects=1, options=QUICK)
    assert [named.name for named in found.effects] == ["joint_stiffness@joint:elbow"]
    assert found.unexplained == ()


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


def left_by(gains, dispersion=1.0, told=None, body=None):
    """A check in which hypotheses leave given gains at one joint, of which 45 may be chance, and this at a body."""
    left = {gain: Leftover(*np.zeros((3, 1)), left, None) for gain, left in gains.items()}
    bench = SimpleNamespace(dispersion=dispersion, delicate=frozenset())
    chance = SimpleNamespace(excess_at_body=4.0, usual_at_body=0.5, excess=5.5, usual=-np.inf)
    return SimpleNamespace(
        bench=bench,
        gain=45.0,
        spread=lambda _: True,
        beyond=lambda there: Check.beyond(chance, there),  # type: ignore[arg-type]
        left=lambda judged: left[judged.gain],
        at_body=lambda _: body or AtBody(),
        thrown=lambda there: Check.thrown(chance, there),  # type: ignore[arg-type]
        told=lambda _: told,
        follows=lambda judged: Told(0, 1.0, left[judged.gain].gain) if left[judged.gain].gain > 45.0 else None,
    )


def gained(gain):
    return SimpleNamespace(gain=gain, held_out=0.5 * gain, hypothesis=SimpleNamespace(effects=()))


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
    assert missing(left_by(left), named, 0.9, 0.0) is expected


def test_a_name_must_explain_most_of_a_lack_of_fit():
    named = [gained(1000.0)]
    little = left_by({1000.0: 0.0})
    assert missing(little, named, 0.3, 3.5)
    assert not missing(little, named, 0.3, 1.0)  # chance
    assert not missing(little, named, 0.8, 3.5)
    little.spread = lambda _: False  # in a few windows
    assert not missing(little, named, 0.3, 3.5)


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
    check.left, check.follows = (lambda _: left), (lambda _: None)
    check.beyond = lambda there: Check.beyond(chance, there)  # type: ignore[arg-type]
    assert missing(check, [named], 0.9, 0.0) is expected


def test_a_name_is_none_where_held_out_recordings_know_of_something_else():
    named = [gained(1000.0)]
    assert missing(left_by({1000.0: 0.0}, told="position cubed"), named, 0.9, 0.0)


@pytest.mark.parametrize(
    ("excess", "chi2", "usual", "expected"),
    [
        (3.9, 500.0, 0.6, False),
        (4.1, 500.0, 0.6, True),
        (4.1, 89.0, 0.6, False),
        (4.1, 91.0, 0.6, True),
        (40.0, 5000.0, 0.4, False),  # much in a few windows: feet that come down at another time
    ],
)
def test_what_a_name_may_leave_at_a_body_that_floats(excess, chi2, usual, expected):
    check = left_by({1000.0: 0.0}, body=AtBody(1, excess, chi2, usual))
    assert missing(check, [gained(1000.0)], 0.9, 0.0) is expected


def unnamed(score, offset):
    """A candidate that may not be named: a spring so far from none."""
    number = Parameter("stiffness", "N m/rad", -1.0, 1.0, 0.01)
    effect = SimpleNamespace(name="joint_stiffness")
    candidate = SimpleNamespace(
        name="joint_stiffness@elbow", effect=effect, parameters=(number,), null=np.zeros(1), place=Place("joint:elbow")
    )
    judged = SimpleNamespace(score=score, hypothesis=SimpleNamespace(effects=((candidate, (offset,)),)))
    judged.widest = judged
    return judged


@pytest.mark.parametrize(
    ("score", "size", "beside", "expected"),
    [
        (None, 0.0, None, False),  # nothing at all
        (40.0, 0.5, None, False),  # weak, not strange
        (40.0, 0.5, 10.0, False),
        (40.0, 0.5, 30.0, True),  # its twin explains more
        (80.0, 0.5, None, True),  # too much for chance
        (80.0, 0.02, None, False),  # calibration
    ],
)
def test_what_may_not_be_named_may_still_be_missing(score, size, beside, expected):
    check = left_by({})
    check.surprise = lambda _: 0.0
    check.left = lambda _: Leftover(*np.zeros((3, 1)), 0.0, None)
    check.follows = lambda _: None
    check.bench.dataset = SimpleNamespace(tolerances={"joint_stiffness": 0.01})
    best = None if score is None else unnamed(score, size)
    rival = None if beside is None else SimpleNamespace(score=score + beside)
    assert strange(check, best, rival) is expected
    if not expected:
        check.told = lambda _: "position cubed"
        assert strange(check, best, rival)
        check.told, check.follows = (lambda _: None), (lambda _: Told(0, 1.0, 50.0))
        assert strange(check, best, rival)


@pytest.mark.parametrize(
    ("held_out", "expected"),
    [([10.0, 9.0], 0), ([-20.0, -9.0], 0), ([-40.0, -9.0], 1), ([-40.0, -30.0], None)],
    ids=["known", "hardly known", "denied", "both denied"],
)
def test_what_held_out_recordings_speak_against_is_not_strange(held_out, expected):
    """Gains of 60 and 50 on the recordings to fit, of which 45 may be chance."""
    told = (Told(0, 1.0, 60.0), Told(1, 1.0, 50.0), Told(2, 1.0, 40.0))
    asked = list(zip(told, held_out, strict=False))
    stub = SimpleNamespace(gain=45.0, _asked=lambda judged, least: asked)
    found = Check.follows(stub, None)  # type: ignore[arg-type]
    assert (found and found.index) == expected


@pytest.mark.parametrize(("beside", "expected"), [(10.0, False), (30.0, True)])
def test_a_name_is_none_where_its_twin_explains_more(beside, expected):
    named = [SimpleNamespace(gain=1000.0, score=990.0, hypothesis=SimpleNamespace(effects=()))]
    rival = SimpleNamespace(score=990.0 + beside)
    assert missing(left_by({1000.0: 0.0}), named, 0.9, 0.0, rival) is expected


def test_real_machines_leave_more():
    named = [gained(1000.0)]
    assert not missing(left_by({}, dispersion=50.0), named, 0.7, 30.0)
    assert missing(left_by({}, dispersion=50.0), named, 0.3, 30.0)


@pytest.mark.parametrize(
    ("verdict", "explained", "expected"),
    [
        ("effect", False, ("a", "b")),
        ("none", True, ("a", "b")),
        ("none", False, ("a", "b", "d")),
        ("unexplained", True, ()),
    ],
)
def test_what_may_not_be_named_need_not_be_ruled_out(monkeypatch, verdict, explained, expected):
    def one(name, score, explained=False):
        hypothesis = SimpleNamespace(effects=[(SimpleNamespace(name=name), (1.0,))])
        return SimpleNamespace(hypothesis=hypothesis, score=score, explained=explained)

    def small(bench, judged):
        return judged.hypothesis.effects[0][0].name == "c"

    monkeypatch.setattr("btr_mjx.gap.identify.within_calibration", small)
    first = [one("a", 100.0, explained), one("b", 90.0), one("c", 20.0), one("d", 16.0), one("e", 14.0)]
    assert undecided(SimpleNamespace(delicate=()), first, verdict) == expected
    assert undecided(SimpleNamespace(delicate=()), [], verdict) == ()


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
    first, second = bench.candidates[0], bench.candidates[-1]
    believed = (Believed("elbow damping", ("joint:elbow/damping",), 0.0, 1.0),)
    made = Hypothesis(believed, (0.2,)).with_effect(first, [0.3]).with_effect(second, [0.004])
    np.testing.assert_allclose(made.values(True), [0.2, 0.3, 0.004])
    again = made.replaced(np.array([0.1, 0.2, 0.3]), True)
    np.testing.assert_allclose(again.values(False), [0.2, 0.3])
    assert again.believed == (0.1,)
    assert len(unknowns(made, True).low) == 3
    assert made.name == f"{first.name} + {second.name}"
    calibrated = dataclasses.replace(made, effects=made.effects[1:], calibration=made.effects[:1])
    np.testing.assert_allclose(calibrated.values(True), [0.2, 0.004])
    assert (calibrated.numbers, calibrated.name) == (1, second.name)
    for other in (calibrated, calibrated.replaced(calibrated.values(True), True)):
        assert other.calibration == made.effects[:1]
        np.testing.assert_array_equal(*(bench.fit.windows.states([h])[0] for h in (made, other)))
    judged = bench.find()
    assert equivalent(judged)[0] == judged[0].name
    (error,) = calibration_of([judged[0], dataclasses.replace(judged[0], hypothesis=calibrated)])
    assert (f"{error.effect}@{error.location}", list(error.parameters.values())) == (first.name, [0.3])
    assert calibration_of(judged[:1]) == calibration_of([]) == ()


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
