"""Logs that repeat rows, commands like stairs, and angles that jump by a turn."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, DatasetDescription, bends, held, load, save_dataset, stairs
from btr_mjx.gap.preflight import preflight
from tests.support.convention_logs import ARM, SPINNER, log, sines

RNG = np.random.default_rng(0)
LOGS = [log(ARM, sines(RNG, [0.9, 0.8, 0.8]), i, rate=500) for i in range(2)]


def errors(data: Dataset) -> list[str]:
    return [f.message for f in preflight(data) if f.level == "error"]


def without_control(folder: Path) -> None:
    """Take [control] out of dataset.toml, so that the interpolation is not given."""
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(text.replace('[control]\ninterpolation = "linear"\n', ""))


def hold(values: np.ndarray, every: int, first: int = 0) -> np.ndarray:
    return values[np.maximum((np.arange(len(values)) - first) // every * every + first, 0)]


def test_the_fresh_rows_of_repeated_ones_are_used(tmp_path: Path) -> None:
    unmeasured = np.zeros(3, bool)
    repeated = [dataclasses.replace(r, qpos=hold(r.qpos, 10), qvel_measured=unmeasured) for r in LOGS]
    save_dataset(tmp_path, ARM, repeated)
    data = load(tmp_path)
    for recording, log_ in zip(data.recordings, LOGS, strict=True):
        np.testing.assert_array_equal(recording.qpos, log_.qpos[::10])
        np.testing.assert_array_equal(recording.commands[0], log_.time)
        np.testing.assert_array_equal(recording.commands[1], log_.ctrl)
    findings = preflight(data)
    assert any("positions change every 10th row only (50 Hz)" in f.message for f in findings)
    assert all(f.level == "note" for f in findings)


def test_joints_that_are_refreshed_in_turn_are_refused(tmp_path: Path) -> None:
    def alternate(qpos: np.ndarray) -> np.ndarray:
        return np.stack([hold(column[:, None], 6, 2 * j)[:, 0] for j, column in enumerate(qpos.T)], axis=1)

    save_dataset(tmp_path, ARM, [dataclasses.replace(r, qpos=alternate(r.qpos)) for r in LOGS])
    (found,) = errors(load(tmp_path))
    assert "positions of shoulder, elbow, wrist change every 6th row only" in found


def test_encoder_counts_of_slow_joints_are_not_held() -> None:
    """A coarse encoder repeats rows, too, but steps by single counts."""
    time = np.arange(0, 5, 0.001)
    coarse = np.round(np.sin(time)[:, None] / 0.003) * 0.003
    found = held(coarse)
    assert found is None or found.coarse
    assert held(np.sin(time)[:, None]) is None


@pytest.mark.parametrize("every", [2, 5, 20])
def test_stairs_are_held_where_nothing_is_said(tmp_path: Path, every: int) -> None:
    save_dataset(tmp_path, ARM, [dataclasses.replace(r, ctrl=hold(r.ctrl, every)) for r in LOGS])
    (found,) = errors(load(tmp_path))
    assert f"commands are stairs: they change every {every}th row" in found
    assert 'interpolation = "hold" in [control] fits them' in found
    without_control(tmp_path)
    data = load(tmp_path)
    assert data.recordings[0].interpolation == "hold"
    assert any('interpolation = "hold" is used' in line for line in data.notes)
    assert not any("stairs" in text for text in errors(data))


def test_smooth_commands_bend_between_samples(tmp_path: Path) -> None:
    save_dataset(tmp_path, ARM, LOGS, DatasetDescription())
    without_control(tmp_path)
    assert load(tmp_path).recordings[0].interpolation == "cubic"
    assert stairs([r.ctrl for r in LOGS]) is None
    assert stairs([np.zeros((50, 2))]) is None


@pytest.mark.parametrize(
    ("command", "smooth"),
    [
        (lambda t: np.sin(3 * t) + 0.2 * np.sin(11 * t), True),
        (lambda t: np.sin(3 * t) + 0.1 * np.random.default_rng(0).normal(size=len(t)), False),
        (lambda t: np.abs((t / 0.7) % 2 - 1), False),  # a triangle
        (lambda t: np.where(t > 3, 1.0, 0.0) + 0.02 * t, False),  # a step
        (lambda t: 0.0 * t, False),
    ],
    ids=["sines", "noise", "triangle", "step", "nothing"],
)
def test_commands_bend_only_if_they_are_smooth(command, smooth) -> None:
    """At even and at uneven times, with a column that never changes beside it."""
    for jitter in (0.0, 0.004):
        times = 0.01 * np.arange(801) + jitter * np.random.default_rng(1).uniform(size=801)
        assert bends([(times, np.stack([command(times), np.ones(801)], axis=1))]) == smooth


def spinning(wrap: bool) -> list:
    """A motor at about 3 rad/s, in [-pi, pi) or counted on."""
    logs = [log(SPINNER, lambda t: 3 + np.sin(4 * t)[:, None], i, seconds=6.0) for i in range(2)]
    if not wrap:
        return logs
    return [dataclasses.replace(r, qpos=(r.qpos + np.pi) % (2 * np.pi) - np.pi) for r in logs]


def test_continuous_hinges_are_unwrapped(tmp_path: Path) -> None:
    save_dataset(tmp_path, SPINNER, spinning(wrap=True))
    data = load(tmp_path)
    for recording, true in zip(data.recordings, spinning(wrap=False), strict=True):
        np.testing.assert_allclose(recording.qpos, true.qpos, atol=1e-9)
    findings = preflight(data)
    assert any("qpos/j7 jumped by 2 pi 3 times and was unwrapped" in f.message for f in findings)
    assert all(f.level == "note" for f in findings)


def test_jumps_of_hinges_with_limits_are_refused(tmp_path: Path) -> None:
    limited = SPINNER.replace('name="j7" axis', 'name="j7" limited="true" range="-4 4" axis')
    save_dataset(tmp_path, limited, spinning(wrap=True))
    (found,) = errors(load(tmp_path))
    assert "qpos/j7 jumps by 2 pi 3 times in 'r0', first at " in found
    assert "unwrap it, or remove the joint's limits" in found


def test_jumps_by_360_degrees_are_refused(tmp_path: Path) -> None:
    turned = [dataclasses.replace(r, qpos=np.degrees(r.qpos), qvel=np.degrees(r.qvel)) for r in spinning(wrap=True)]
    save_dataset(tmp_path, SPINNER, turned)
    (found,) = errors(load(tmp_path))
    assert "qpos/j7 jumps by 360 3 times" in found
    assert "divide it by 57.3" in found


def test_stairs_beside_smooth_commands_are_held_alone(tmp_path: Path) -> None:
    save_dataset(tmp_path, ARM, [LOGS[0], dataclasses.replace(LOGS[1], ctrl=hold(LOGS[1].ctrl, 10))])
    without_control(tmp_path)
    data = load(tmp_path)
    assert [r.interpolation for r in data.recordings] == ["cubic", "hold"]
    assert any(line.startswith("r1: commands are stairs") for line in data.notes)
    assert not any("stairs" in text for text in errors(data))
