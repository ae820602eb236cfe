"""Stretches cover recordings evenly, and hold what was measured."""

import numpy as np
import pytest
from gap_arm import SIGMA
from gap_forces import moved_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.gap.data import Recording
from btr_mjx.gap.forces.stretches import Stretches, spread_stretches
from btr_mjx.gap.windows import Span, prepare


@pytest.fixture(scope="module")
def long() -> Recording:
    return moved_arm("long", 1, seconds=2.0)


def cut(recording: Recording, first: int, count: int) -> Recording:
    own = slice(first, first + count)
    return Recording(
        f"{first}+{count}",
        recording.time[own],
        recording.ctrl[own],
        recording.qpos[own],
        recording.qvel[own],
        recording.qvel_measured,
        "fit",
        recording.model,
        interpolation=recording.interpolation,
    )


def of(recordings, share: float = 1.0) -> Stretches:
    return spread_stretches(prepare(recordings, SIGMA, Span(5, 6)), share)


def test_measurements_are_those_of_the_recordings(long):
    own = of([cut(long, 0, 200), cut(long, 150, 250)])
    assert own.time.shape == (len(own), own.intervals + 1)
    for s, r in enumerate(own.recording):
        recording = own.data.recordings[r]
        index = np.searchsorted(recording.time, own.time[s])
        np.testing.assert_array_equal(np.diff(index), 1)
        np.testing.assert_array_equal(recording.time[index], own.time[s])
        np.testing.assert_array_equal(recording.qpos[index], own.measured_q[s])
        np.testing.assert_array_equal(recording.qvel[index], own.measured_v[s])
    residual = own.residual()
    np.testing.assert_array_equal(residual[..., :2], own.measured_q - own.qpos)
    np.testing.assert_array_equal(residual[..., 2:], own.measured_v - own.qvel)
    assert (own.about(own.measured_q, own.measured_v).residual() == 0).all()
    # Smoothed states are nearer to the motion than measurements are far from them.
    assert (residual.std((0, 1)) < 1.3 * SIGMA).all()
    assert (residual.std((0, 1)) > 0.5 * SIGMA).all()


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(40, 399), min_size=1, max_size=4), st.sampled_from([0.05, 0.3, 1.0, 4.0]))
def test_stretches_cover_recordings_and_do_not_overlap(long, counts, share):
    own = of([cut(long, 0, count) for count in counts], share)
    assert set(own.recording) == set(range(len(counts)))
    for r, count in enumerate(counts):
        times = own.time[own.recording == r]
        begin, end = long.time[0], long.time[count - 1]
        assert times[0, 0] == begin
        assert times[-1, -1] == end or len(times) == 1
        assert (np.diff(times[:, 0]) > 0).all()
        # The end of one may be the start of the next, nothing more.
        assert (times[1:, 0] >= times[:-1, -1] - 1e-9).all()
        assert len(times) * own.intervals <= count - 1


def test_all_of_short_recordings_is_used_and_more_of_long_ones(long):
    own = of([cut(long, 0, 81), cut(long, 0, 381)])
    per = np.bincount(own.recording) * own.intervals
    assert per[0] > 0.7 * 80
    assert per[1] > 0.7 * 380
    few = of([long] * 3, 0.05)
    many = of([long] * 3, 0.3)
    assert len(few) * few.intervals < len(many) * many.intervals


def test_fast_samples_are_averaged():
    """Four samples make an interval of 4 ms; their noise is that of an average."""
    fast = moved_arm("fast", 4, seconds=1.0, rate=1000.0)
    quiet = moved_arm("quiet", 4, seconds=1.0, rate=1000.0, noise=0.0)
    a, b = of([fast]), of([quiet])
    assert np.median(np.diff(a.time)) == pytest.approx(4e-3)
    np.testing.assert_array_equal(a.time, b.time)
    np.testing.assert_allclose(a.sigma, SIGMA / 2)
    noise = np.concatenate([a.measured_q - b.measured_q, a.measured_v - b.measured_v], -1).std((0, 1))
    np.testing.assert_allclose(noise, a.sigma, rtol=0.25)


@pytest.mark.parametrize("count", [1, 10, 60])
def test_many_recordings_cost_no_more_than_few(long, count):
    """Each of them has a stretch."""
    share = 0.5
    own = of([cut(long, 0, 150)] * count, share)
    assert set(own.recording.tolist()) == set(range(count))
    assert len(own) * own.intervals <= 1.2 * 0.5 * 2500
