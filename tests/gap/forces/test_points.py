"""Columns of the library, and points whose numbers and variances are fitted to recordings of a known truth."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, SIGMA, arm, damped
from gap_forces import arm_side, arm_stretches, believed, moved_arm
from gap_models import one

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import Hypothesis, candidates
from btr_mjx.gap.forces import points
from btr_mjx.gap.forces.held_out import held_out, is_better
from btr_mjx.gap.forces.horizons import cut_horizons
from btr_mjx.gap.forces.kalman_filter import filtered, smoothed
from btr_mjx.gap.forces.motion import FreeNumber, linearise_motion, pushes
from btr_mjx.gap.forces.points import ForceSide, Point, again, covariance, evaluate_point
from btr_mjx.gap.forces.predictions import compared_predictions, horizon_errors, predicts_better, predicts_worse
from btr_mjx.gap.forces.scan import Scanned, price
from btr_mjx.gap.forces.search import (
    _may_pay,
    _scene,
    _tried,
    _unbeaten,
    first_variances,
    one_more,
    pruned,
    start,
)
from btr_mjx.gap.forces.settling import newton_step, settled, updated_variances
from btr_mjx.gap.forces.unknowns import library_of
from btr_mjx.gap.simulate import Counter, Journal
from btr_mjx.gap.windows import scales_of
from btr_mjx.models import PathParameter

EFFECTS = tuple(e for e in LIBRARY if e.name in ("viscous_damping", "actuator_gain"))


@pytest.fixture(scope="module")
def sides():
    """Recordings of an arm with more damping at the elbow: to fit, and held out."""
    own = [[moved_arm(f"r{i}", i, change=damped) for i in pair] for pair in ((0, 1), (2, 3))]
    return [arm_side(arm_stretches(recordings), EFFECTS) for recordings in own]


@pytest.fixture(scope="module")
def null(sides):
    return start(sides[0], believed())


def damping(side, value: float) -> Point:
    candidate = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    return Point(believed(), ((candidate, (value,)),), np.zeros(len(side.library.calibrated)))


@pytest.fixture(scope="module")
def named(sides, null):
    return settled(sides[0], damping(sides[0], 0.02), null.variances)


def test_columns_of_groups_are_sums_of_those_of_members(sides):
    """Against the column of the group as an effect of its own."""
    side = sides[0]
    entries = {e.candidate.name: e for e in side.library.entries}
    groups = [e for e in entries.values() if e.candidate.place.members and not e.candidate.place.parts]
    assert {e.candidate.effect.name for e in groups} == {"viscous_damping", "actuator_gain"}
    for entry in groups:
        (own,) = entry.columns
        members = [side.library.numbers[column] for column in own]
        assert [m.candidate.place.label for m in members] == [*entry.candidate.place.members]
        small = 0.01 * entry.candidate.parameters[0].step
        numbers = [FreeNumber(m.candidate, 0, m.at, small) for m in members]
        numbers.append(FreeNumber(entry.candidate, 0, tuple(entry.candidate.null), small))
        linear = linearise_motion(side.stretches, believed())
        found = linear.responses(pushes(linear, believed(), numbers))
        np.testing.assert_allclose(
            found[..., 0] + found[..., 1], found[..., 2], atol=0.01 * np.abs(found[..., 2]).max()
        )
        assert entry.design(len(side.library.numbers))[:, 0].sum() == 2
        each = entries[entry.candidate.name.replace("@", "@each:")]
        assert each.columns == tuple((column,) for column in own)


def test_calibration_has_no_effect_where_it_is_zero_and_moves_the_model_where_it_is_not(sides):
    side = sides[0]
    model, plain = arm(), damping(side, 0.0)
    labels = [e.candidate.name for e in side.library.calibrated]
    calibration = np.zeros(len(labels))
    calibration[labels.index("viscous_damping@joint:shoulder")] = 0.03
    moved = plain.moved(np.array([0.2]), calibration)
    world = moved.hypothesis(side.library)(model).model
    np.testing.assert_allclose(world.dof_damping, [0.05 + 0.03, 0.05 + 0.2])
    np.testing.assert_allclose(moved.hypothesis(side.library, without=0)(model).model.dof_damping, [0.08, 0.05])
    np.testing.assert_allclose(plain.hypothesis(side.library)(model).model.dof_damping, [0.05, 0.05])
    assert plain.moved(np.array([-5.0]), calibration).named[0][1][0] >= plain.named[0][0].parameters[0].low


def test_damping_is_found_again(named, null):
    (_, values), *_ = named.point.named
    assert values[0] == pytest.approx(0.1, rel=0.1)
    assert null.loss - named.loss > 100


def test_a_settled_fit_is_the_largest_likelihood(sides, named):
    """The next step is small beside its uncertainty, and any other value is worse in true simulation."""
    side = sides[0]
    step = newton_step(side, named)
    assert np.abs(step.values[0]) < np.sqrt(covariance(side, named)[0, 0])
    value = named.point.named[0][1][0]
    for other in (0.5 * value, 1.5 * value):
        moved = named.point.moved(np.array([other - value]), named.point.calibration)
        assert evaluate_point(side, moved, named.variances, named).loss > named.loss + 10


def test_a_body_without_inertia_is_no_hypothesis(sides, null) -> None:
    """A thousandth of a millionth of the inertia: a likelihood cannot be computed, and so it is nothing."""
    side = sides[0]
    light = replace(null.linear, force=1e9 * null.linear.force)
    with pytest.raises(np.linalg.LinAlgError):
        filtered(light, null.columns, null.variances)
    assert again(side, replace(null, parts=lambda: (light, null.pushes, null.whitened)), null.variances).loss == np.inf


def test_a_believed_model_without_inertia_is_refused(sides, monkeypatch: pytest.MonkeyPatch) -> None:
    side = sides[0]
    heavy = points.linearise_motion

    def light(*given):
        found = heavy(*given)
        return replace(found, force=1e9 * found.force)

    monkeypatch.setattr(points, "linearise_motion", light)
    with pytest.raises(InputError, match="hardly any inertia"):
        start(side, believed())


def test_a_number_is_worth_the_same_by_another_name(sides, named):
    """Damping that is refitted as part of the believed model explains as much as damping that is named."""
    side = sides[0]
    model = side.stretches.data.recordings[0].model
    refitted = (PathParameter("elbow damping", ("joint:elbow/damping",), 0.0, 1.0),)
    base = Hypothesis(refitted, (0.05,))
    library = library_of(candidates(model, scales_of(side.stretches.data), EFFECTS), model, refitted, {}, 0.005)
    other = start(ForceSide(side.stretches, library, Counter()), base)
    assert other.loss == pytest.approx(named.loss, abs=10)
    assert 0.05 + other.point.calibration[-1] == pytest.approx(0.15, rel=0.05)


def test_numbers_of_the_model_stay_within_their_bounds(sides):
    """The true damping of 0.15 is out of reach; beyond the bound there is no model."""

    class Bounded(PathParameter):
        def write(self, model, value):
            assert self.low <= value <= self.high
            super().write(model, value)

    side = sides[0]
    model = side.stretches.data.recordings[0].model
    refitted = (Bounded("elbow damping", ("joint:elbow/damping",), 0.0, 0.08),)
    base = Hypothesis(refitted, (0.05,))
    library = library_of(candidates(model, scales_of(side.stretches.data), ()), model, refitted, {}, 0.005)
    found = start(ForceSide(side.stretches, library, Counter()), base)
    assert 0.05 + found.point.calibration[-1] > 0.08


def test_what_is_settled_stays(sides, named, null):
    for fit in (named, null):
        assert settled(sides[0], fit.point, fit.variances).loss == pytest.approx(fit.loss, abs=10)


def test_noise_and_forces_come_right(sides, named, null):
    """More updates of the variances alone lead to the noise that was added, to no force and to exact time stamps."""
    fit, nothing = named, np.zeros_like(named.linear.defect)
    for _ in range(80):
        fit = again(sides[0], fit, smoothed(fit.linear, nothing, fit.variances).variances)
    np.testing.assert_allclose(np.sqrt(fit.variances.sensor), SIGMA, rtol=0.1)
    assert (np.sqrt(fit.variances.force) < 0.02 * np.sqrt(null.variances.force[1])).all()
    assert np.sqrt(fit.variances.jitter) < 1e-4
    assert fit.loss < named.loss
    assert named.variances.force[1] < 0.1 * null.variances.force[1]


def test_updated_variances_are_more_likely(sides, null):
    """Near their best, too: an extrapolation that overshoots is not taken."""
    fit = evaluate_point(sides[0], damping(sides[0], 0.03), null.variances)
    losses = [fit.loss]
    for _ in range(8):
        fit = again(sides[0], fit, updated_variances(fit))
        losses.append(fit.loss)
    assert losses[-1] < losses[0] - 5
    assert (np.diff(losses) < 0.05).all()


def test_derivatives_at_a_point_are_those_of_its_hypothesis(sides, named):
    fit = evaluate_point(sides[0], named.point, named.variances)
    candidate, values = named.point.named[0]
    side = sides[0]
    calibrated = Point(believed(), (), named.point.calibration).hypothesis(side.library)
    number = FreeNumber(candidate, 0, values, 0.2 * candidate.parameters[0].step)
    expected = fit.linear.responses(pushes(fit.linear, calibrated, [number]))[..., 0]
    np.testing.assert_allclose(fit.columns[..., 0], expected, rtol=1e-6, atol=1e-9)


def test_one_more_effect_is_the_true_one_and_stays(sides, null):
    found = one_more(sides[0], null)
    best = found.finalists[0][1]
    assert found.leads[0].candidate.effect.name == "viscous_damping"
    assert next(c.name for c, _ in best.point.named).startswith("viscous_damping")
    left = pruned(sides[0], best, null)
    assert [c.name for c, _ in left.point.named] == ["viscous_damping@joint:elbow"]
    assert found.finalists[0][0] == pytest.approx(
        null.loss
        - best.loss
        - price(
            best.point.numbers,
            null.whitened.count * len(sides[0].stretches),
            len({e.candidate.name for e in sides[0].library.entries}),
        )
    )
    assert len(found.finalists) <= 3 + 2  # two whole drives: with stiffnesses of their servos and without


@pytest.mark.parametrize("scanned", [0.02, 0.4])
def test_a_lead_is_tried_as_large_as_pays(sides, null, scanned: float) -> None:
    """A scan may see a part of what an effect is, or too much of it; 0.1 is true."""
    candidate, own = one(arm(), "viscous_damping@joint:elbow", LIBRARY), null.point.calibration
    found = _tried(sides[0], null, Scanned(candidate, (scanned,), np.zeros(0), own, 0.0, 0.0))
    ((value,),) = (values for _, values in found.point.named)
    assert 0.05 <= value <= 0.2
    assert np.log2(value / scanned) == pytest.approx(round(np.log2(value / scanned)))
    beside = replace(damping(sides[0], scanned), calibration=own)
    as_scanned = evaluate_point(sides[0], beside, null.variances)
    assert found.loss < again(sides[0], as_scanned, updated_variances(as_scanned)).loss


def test_whole_drives_are_fitted_where_they_may_pay(null, sides) -> None:
    """Two drives of an arm that lacks nothing are not, those of one that lacks damping are."""
    sound = arm_side(arm_stretches([moved_arm(f"r{i}", i) for i in (0, 1)]), EFFECTS)
    drives = [
        [fit for _, fit in one_more(side, begun).finalists if fit.point.numbers == 2]
        for side, begun in ((sound, start(sound, believed())), (sides[0], null))
    ]
    assert [bool(own) for own in drives] == [False, True]


def test_what_is_no_model_of_a_body_does_not_pay(sides, null) -> None:
    """Its motion is lost: the random force that it leaves is beyond what numbers can hold."""
    lost, point = replace(null.variances, force=1e18 * null.variances.force), damping(sides[0], 0.02)
    with pytest.raises(np.linalg.LinAlgError):
        filtered(null.linear, null.columns, lost)
    assert not _may_pay(sides[0], null, _scene(sides[0], null), point, lost, 1)
    assert _may_pay(sides[0], null, _scene(sides[0], null), point, null.variances, 1)


def test_finalists_that_predict_worse_are_left_out(sides, null, named):
    """However much likelihood they have."""
    wrong = evaluate_point(sides[0], damping(sides[0], 0.6), null.variances)
    rows = [(500.0, wrong), (300.0, named)]
    assert _unbeaten(sides[0], rows, 0.0) == [(300.0, named)]
    # What has no evidence beats nothing.
    assert _unbeaten(sides[0], rows, 400.0) == rows


def test_what_does_not_pay_is_pruned(sides, named, null):
    extra = one(arm(), "armature@joint:shoulder", LIBRARY)
    point = Point(believed(), (*named.point.named, (extra, (1e-3,))), named.point.calibration)
    left = pruned(sides[0], settled(sides[0], point, named.variances), null)
    assert [c.name for c, _ in left.point.named] == ["viscous_damping@joint:elbow"]


def test_held_out_recordings_bear_out_the_truth_only(sides, named, null):
    test = sides[1]
    before, after = (held_out(test, fit.point, fit.variances) for fit in (null, named))
    wrong = held_out(test, damping(test, 0.6), named.variances)
    assert before.loss.shape == (len(test.stretches),)
    assert is_better(before, after)
    assert not is_better(after, before)
    assert not is_better(after, after)
    assert not is_better(after, wrong)
    assert after.chi2.mean() == pytest.approx(1, abs=0.15)
    assert before.chi2.mean() > 1.3 * after.chi2.mean()


def test_a_few_stretches_on_which_all_fails_decide_nothing() -> None:
    rng = np.random.default_rng(0)
    believed_errors = rng.chisquare(3, (60, 2))
    believed_errors[::10] *= 1e4
    mended = believed_errors * rng.uniform(0.5, 0.9, (60, 2))
    mended[10] *= 3
    steady = rng.chisquare(3, (60, 2))
    assert predicts_better(believed_errors, mended, steady) is True
    assert predicts_better(mended, believed_errors, steady) is False
    assert predicts_better(mended, mended, steady) is None
    assert predicts_better(believed_errors, believed_errors[rng.permutation(60)], steady) is None
    assert predicts_better(believed_errors[:1], mended[:1], steady[:1]) is None


def test_holding_still_is_no_prediction_of_motion() -> None:
    """Most of the time a robot stands still, and a model that never moves errs by nothing there."""
    moves = np.arange(60) % 4 == 0
    steady = np.where(moves, 4.0, 1e-6)[:, None]
    frozen, follows = np.where(moves, 2.0, 0.0)[:, None], np.where(moves, 0.5, 0.01)[:, None]
    assert predicts_better(frozen, follows, steady) is True
    assert predicts_better(follows, frozen, steady) is False


def test_predictions_over_a_horizon_are_those_of_plain_simulations(sides):
    data = sides[1].stretches.data
    truth = believed().with_effect(one(arm(), "viscous_damping@joint:elbow", LIBRARY), [0.1])
    (lacking, right), steady = horizon_errors(data, [believed(), truth], horizon=0.05)
    assert lacking.shape == right.shape == steady.shape
    assert right[:, 1].mean() < 0.3 * lacking[:, 1].mean()
    assert right.mean() < 0.1 * steady.mean()
    model, first = arm(), data.recordings[0]
    start = cut_horizons(data, 0.05).segments[0]
    plain, own = mujoco.MjData(model), first.qpos[np.searchsorted(first.time, start.start[0] - 1e-9) :, 1]
    assert len(own) == len(first.time) - data.span.half  # behind samples that tell the state from both sides
    plain.qpos[:], plain.qvel[:] = start.qpos[0], start.qvel[0]
    model.opt.timestep, away = 0.005 / 3, [plain.qpos[1] - own[0]]
    for k in range(10):
        for _ in range(3):
            plain.ctrl[:] = data.commands[0].at(start.start[0] + plain.time)
            mujoco.mj_step(model, plain)
        away.append(plain.qpos[1] - own[k + 1])
    assert lacking[0, 1] == pytest.approx(np.mean(np.square(away)), rel=0.02)
    moving = [start.qpos[0, 1] + 0.005 * k * start.qvel[0, 1] - own[k] for k in range(11)]
    assert steady[0, 1] == pytest.approx(np.mean(np.square(moving)))


def test_first_variances_are_of_the_size_of_what_is_missing(sides):
    """Half of what damping takes at its usual speed, and nothing of the sort at the shoulder."""
    side = sides[0]
    force = np.sqrt(first_variances(side, believed()).force)
    usual = 0.1 * np.median(np.abs(side.stretches.qvel[..., 1])) / 0.6745
    assert 0.5 * usual < force[1] < 4 * usual


def test_hypotheses_are_compared_by_what_they_predict(sides) -> None:
    """The truth beats what lacks it, and nothing beats itself."""
    elbow = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    truth, near, lacking = believed().with_effect(elbow, [0.1]), believed().with_effect(elbow, [0.102]), believed()
    better = compared_predictions(sides[1].stretches.data, [lacking, truth, near])
    np.testing.assert_array_equal(better, -better.T)
    assert better[0].tolist()[:2] == [0, 1]
    assert better[0, 2] == 1


def test_a_model_that_predicts_worse_is_told_from_a_better_one(sides) -> None:
    """Over short horizons and over whole recordings, of either side; in doubt a model is not worse."""
    elbow = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    truth, wrong = (believed().with_effect(elbow, [value]) for value in (0.1, 0.6))
    for side in sides:
        data = side.stretches.data
        assert not predicts_worse(data, believed(), truth)
        assert not predicts_worse(data, truth, truth)
        assert predicts_worse(data, truth, wrong)
        assert predicts_worse(data, truth, believed())


def test_a_single_stretch_confirms_nothing(sides, named, null) -> None:
    before, after = (held_out(sides[1], fit.point, fit.variances) for fit in (null, named))
    alone = [replace(own, loss=own.loss[:1], chi2=own.chi2[:1]) for own in (before, after)]
    assert alone[1].loss < alone[0].loss
    assert not is_better(*alone)


def test_a_fit_that_is_read_is_the_one_that_was_stored(sides, null, tmp_path):
    """Bit for bit, with the same number of steps; and what was simulated for it is not kept."""
    point = damping(sides[0], 0.01)
    first, again_, plain = Journal(tmp_path), Journal(tmp_path), Counter()
    fit = settled(replace(sides[0], counter=first), point, null.variances)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    assert (
        sum(path.stat().st_size for path in tmp_path.iterdir())
        < 0.5 * fit.columns.nbytes + fit.linear.transition.nbytes
    )
    read = settled(replace(sides[0], counter=again_), point, null.variances)
    expected = settled(replace(sides[0], counter=plain), point, null.variances)
    assert first.steps == again_.steps == plain.steps > 0
    for own in (fit, read):
        assert own.point.named == expected.point.named
        assert own.loss == expected.loss
        np.testing.assert_array_equal(own.point.calibration, expected.point.calibration)
        np.testing.assert_array_equal(own.columns, expected.columns)
        np.testing.assert_array_equal(own.whitened.gram, expected.whitened.gram)
        np.testing.assert_array_equal(own.variances.weight, expected.variances.weight)
        for name in ("defect", "transition", "force", "slope"):
            np.testing.assert_array_equal(getattr(own.linear, name), getattr(expected.linear, name))
    other = settled(replace(sides[0], counter=again_), damping(sides[0], 0.011), null.variances)
    assert other.loss != read.loss
    assert len(list(tmp_path.glob("*.npz"))) == 2
