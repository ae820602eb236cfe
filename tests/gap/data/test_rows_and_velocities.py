"""Time stamps that jitter on an even clock, and velocities that went through a filter of the driver."""

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Recording, load, save_dataset
from btr_mjx.gap.data.recordings.rows import even_times
from btr_mjx.gap.data.recordings.velocities import velocity_lag
from btr_mjx.gap.preflight import preflight
from tests.support.convention_logs import ARM, log, sines

RNG = np.random.default_rng(0)
LOGS = [log(ARM, sines(RNG, [0.9, 0.8, 0.8]), i) for i in range(2)]


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of a joint."""
    return np.sin(5 * time) + 0.3 * np.cos(11 * time), 5 * np.cos(5 * time) - 3.3 * np.sin(11 * time)


def low_pass(values: np.ndarray, step: float, constant: float) -> np.ndarray:
    out, keep = values.copy(), np.exp(-step / constant)
    for k in range(1, len(values)):
        out[k] = keep * out[k - 1] + (1 - keep) * values[k]
    return out


@pytest.mark.parametrize("lost", [0, 3])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_even_times_are_found_behind_late_stamps(lost: int, noise: float) -> None:
    rng = np.random.default_rng(1)
    time = np.delete(np.arange(600) * 0.008, rng.choice(np.arange(1, 599), lost, replace=False))
    position = motion(time)[0][:, None] + noise * rng.normal(size=(len(time), 1))
    late = rng.exponential(8e-4, len(time))
    found = even_times(time + late, position)
    assert found is not None
    np.testing.assert_allclose(found, time + late.mean(), atol=2e-4)


def test_stamps_that_fit_are_kept() -> None:
    """Uneven sampling with right stamps, even sampling, and motion too slow to tell."""
    rng = np.random.default_rng(2)
    time = np.arange(600) * 0.008
    late = time + rng.exponential(8e-4, len(time))
    assert even_times(late, motion(late)[0][:, None]) is None
    assert even_times(time, motion(time)[0][:, None] + 3e-4 * rng.normal(size=(600, 1))) is None
    assert even_times(late, 3e-4 * rng.normal(size=(600, 1))) is None
    assert even_times(late, np.zeros((600, 1))) is None


def test_a_dataset_uses_even_times_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    late = [dataclasses.replace(r, time=r.time + rng.exponential(4e-4, len(r.time))) for r in LOGS]
    save_dataset(tmp_path, ARM, [dataclasses.replace(r, qvel_measured=np.zeros(3, bool)) for r in late])
    data = load(tmp_path)
    np.testing.assert_allclose(np.diff(data.recordings[0].time), 0.004, rtol=1e-3)
    assert any("positions are smoother on an even clock" in f.message for f in preflight(data))


@pytest.mark.parametrize("lag", [-0.02, 0.012, 0.03])
def test_lags_of_velocities(lag: float) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(0, 8, 0.005)
    position, velocity = motion(time)
    velocity = motion(time - lag)[1] if lag < 0 else low_pass(velocity, 0.005, lag)
    expected = lag if lag < 0 else lag - 0.0025  # the filter has the newest sample half a step early
    noisy = position + 3e-4 * rng.normal(size=len(time)), velocity + 0.02 * rng.normal(size=len(time))
    assert velocity_lag([(time, *noisy)]) == pytest.approx(expected, rel=0.1)


def test_usual_shifts_of_velocities_are_no_lag() -> None:
    rng = np.random.default_rng(5)
    time = np.arange(0, 8, 0.005)
    position = motion(time)[0] + 1e-4 * rng.normal(size=len(time))
    shifts = [motion(time + shift)[1] for shift in (0, 0.0025, -0.0025)]
    backward = np.r_[0, np.diff(position)] / 0.005
    for velocity in [*shifts, backward, rng.normal(size=len(time)), np.zeros(len(time))]:
        assert velocity_lag([(time, position, velocity)]) == 0


def test_velocities_that_lag_are_left_out(tmp_path: Path) -> None:
    def filtered(r):
        qvel = r.qvel.copy()
        qvel[:, 1] = low_pass(qvel[:, 1], 0.004, 0.03)
        return dataclasses.replace(r, qvel=qvel)

    save_dataset(tmp_path, ARM, [filtered(r) for r in LOGS])
    data = load(tmp_path)
    assert all(r.qvel_measured.tolist() == [True, False, True] for r in data.recordings)
    np.testing.assert_allclose(data.recordings[0].qvel[:, 1], LOGS[0].qvel[:, 1], atol=0.2)
    (warning,) = (f.message for f in preflight(data) if f.level == "warning")
    assert re.search(r"velocities lag the slope of the positions by 2\d.* are left out \(elbow\)", warning)

    save_dataset(tmp_path / "sound", ARM, LOGS)
    assert all(r.qvel_measured.all() for r in load(tmp_path / "sound").recordings)


BODY = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="hull"><freejoint name="base"/><geom type="box" size="0.1 0.06 0.03" mass="1"/></body>
  </worldbody>
  <actuator><general name="spin" joint="base" gear="0 0 0 0.02 0.02 0.03"/></actuator>
</mujoco>
"""


def test_filtered_gyros_of_a_free_body_are_left_out(tmp_path: Path) -> None:
    model, step = mujoco.MjModel.from_xml_string(BODY), 0.005
    model.opt.timestep = step
    data, time = mujoco.MjData(model), np.arange(0, 6, step)
    push, states = np.sin(7 * time) + np.cos(3 * time), []
    for u in push:
        states.append([*data.qpos, *data.qvel])
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
    qpos, qvel = np.split(np.array(states), [7], axis=1)

    def saved(folder: Path, qvel: np.ndarray) -> np.ndarray:
        one = Recording("a", time, push[:, None], qpos, qvel, np.ones(6, bool), "fit", model)
        save_dataset(folder, BODY, [one, dataclasses.replace(one, name="b", split="test")])
        return load(folder).recordings[0].qvel_measured

    assert saved(tmp_path / "sound", qvel).all()
    filtered = np.concatenate([qvel[:, :3], low_pass(qvel[:, 3:], step, 0.02)], 1)
    assert saved(tmp_path / "late", filtered).tolist() == [True] * 3 + [False] * 3
