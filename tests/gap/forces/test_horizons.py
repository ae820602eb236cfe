"""Numbers that follow recordings: where truth is known, where forces are sure, and where nothing can be followed."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, arm, damped
from gap_forces import arm_side, arm_stretches, believed, moved_arm
from gap_models import one

from btr_mjx.gap.forces.horizons import cut_horizons, follow_horizons, position_errors
from btr_mjx.gap.forces.points import ForceSide, Point

TRUE = 0.1
GAIN = 0.04


@pytest.fixture(scope="module")
def side() -> ForceSide:
    """Recordings of an arm with more damping at the elbow."""
    effects = tuple(e for e in LIBRARY if e.name == "viscous_damping")
    return arm_side(arm_stretches([moved_arm(f"r{i}", i, change=damped) for i in (0, 1)]), effects)


def point(side: ForceSide, value: float) -> Point:
    candidate = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    return Point(believed(), ((candidate, (value,)),), np.zeros(len(side.library.calibrated)))


@pytest.mark.parametrize("value", [0.07, 0.13])
def test_numbers_move_to_where_recordings_are_followed(side: ForceSide, value: float) -> None:
    (_, (found,)), *_ = follow_horizons(side, point(side, value), np.array([[0.05**2]]), side.library).named
    assert found == pytest.approx(TRUE, rel=0.03)


def test_a_simulation_that_is_lost_does_not_decide() -> None:
    """Somebody holds the elbow back in one recording of three: the damping is that of the others."""

    def push(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return np.array([0.0, 5.0 if 0.3 < t < 0.5 else 0.0])

    effects = tuple(e for e in LIBRARY if e.name == "viscous_damping")
    recordings = [moved_arm(f"r{i}", i, change=damped, force=push if i == 2 else None) for i in (0, 1, 2)]
    pushed = arm_side(arm_stretches(recordings), effects)
    (_, (found,)), *_ = follow_horizons(pushed, point(pushed, 0.07), np.array([[0.05**2]]), pushed.library).named
    assert found == pytest.approx(TRUE, rel=0.2)


def test_calibration_moves_with_them() -> None:
    def change(model: mujoco.MjModel) -> None:
        damped(model)
        model.actuator_gainprm[0] *= 1 + GAIN
        model.actuator_biasprm[0] *= 1 + GAIN

    effects = tuple(e for e in LIBRARY if e.name in ("viscous_damping", "actuator_gain"))
    side = arm_side(arm_stretches([moved_arm(f"r{i}", i, change=change) for i in (0, 1)]), effects)
    start = point(side, 0.07)
    names = [entry.candidate.name for entry in side.library.calibrated]
    calibration = np.where(np.array(names) == "actuator_gain@actuator:shoulder", 0.5 * GAIN, 0.0)
    spread = np.diag([0.05, *np.full(len(names), 0.05)]) ** 2
    found = follow_horizons(side, replace(start, calibration=calibration), spread, side.library)
    assert found.named[0][1][0] == pytest.approx(TRUE, rel=0.05)
    assert found.calibration[calibration != 0] == pytest.approx(GAIN, rel=0.1)
    assert not found.calibration[calibration == 0].any()


def test_numbers_of_which_forces_are_sure_stay(side: ForceSide) -> None:
    (_, (found,)), *_ = follow_horizons(side, point(side, 0.07), np.array([[1e-5**2]]), side.library).named
    assert found == pytest.approx(0.07, abs=1e-4)


def test_a_model_that_follows_nothing_is_left_alone(side: ForceSide) -> None:
    wrong = point(side, 5.0)
    assert follow_horizons(side, wrong, np.array([[1.0]]), side.library) is wrong


def test_a_model_without_numbers_is_left_alone() -> None:
    effects = tuple(e for e in LIBRARY if e.name == "backlash")
    side = arm_side(arm_stretches([moved_arm("r0", 0)]), effects)
    nothing = Point(believed(), (), np.zeros(0))
    assert follow_horizons(side, nothing, np.zeros((0, 0)), side.library) is nothing


def test_horizons_cover_recordings_one_behind_the_other(side: ForceSide) -> None:
    data = side.stretches.data
    trial = cut_horizons(data, 0.1)
    for recording, own, target in zip(data.recordings, trial.segments, trial.target, strict=True):
        assert np.all(np.diff(own.start) > own.samples.max())
        assert own.start[-1] + 2 * own.samples.max() > recording.time[-1] - 0.1
        np.testing.assert_array_equal(target[:, 0], recording.qpos[np.searchsorted(recording.time, own.start - 1e-9)])
    whole = cut_horizons(data, np.inf)
    assert [len(own) for own in whole.segments] == [1, 1]
    (errors,) = position_errors(whole, [believed()])
    assert [e.shape[1] for e in errors] == [len(r.time) for r in data.recordings]


@pytest.mark.parametrize("samples", [60, 100, 150])
def test_horizons_are_thinned_evenly(side: ForceSide, samples: int) -> None:
    data = side.stretches.data
    every, some = cut_horizons(data, 0.1), cut_horizons(data, 0.1, samples)
    starts = [np.concatenate([own.start for own in trial.segments]) for trial in (every, some)]
    names = [
        [r.name for r, own in zip(t.recordings, t.segments, strict=True) for _ in own.start] for t in (every, some)
    ]
    kept = sum(target.shape[0] * target.shape[1] for target in some.target)
    assert kept <= samples + some.target[0].shape[1]
    pairs = [list(zip(*own, strict=True)) for own in zip(names, starts, strict=True)]
    picks = [pairs[0].index(pair) for pair in pairs[1]]
    assert picks[0] == 0
    assert len(set(np.diff(picks))) <= 1
