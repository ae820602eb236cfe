"""Recordings in other forms than our own: BAM's JSON beside a servo.toml, LeRobot's Parquet."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.data.servo import Servo, load_servo, servo_xml

NOMINAL = Servo(kt=0.4, resistance=3.0, error_gain=0.003, armature=0.002, viscous_friction=0.001, arm_mass=0.03)
SETTING = {"mass": 0.5, "length": 0.1, "kp": 200, "vin": 7.4}
TOML = (
    '[servo]\nmotor = "xl330"\nkt = 0.4\nresistance = 3.0\nerror_gain = 0.003\nmax_duty = 1.0\narmature = 0.002\n'
    "viscous_friction = 0.001\narm_mass = 0.03\ngravity = 9.81\n"
)


def textbook(servo: Servo, goal: float, start: float, seconds: float, setting: dict[str, Any] = SETTING) -> float:
    """Angle after some time, by Runge-Kutta integration of the motor and pendulum equations."""
    m, l, kp, vin = (float(setting[k]) for k in ("mass", "length", "kp", "vin"))
    inertia = m * l**2 + servo.arm_mass * l**2 / 3 + servo.armature
    weight = (m * l + servo.arm_mass * l / 2) * servo.gravity

    def rate(state: np.ndarray) -> np.ndarray:
        q, w = state
        duty = np.clip(kp * servo.error_gain * (goal - q), -servo.max_duty, servo.max_duty)
        torque = servo.kt / servo.resistance * (duty * vin - servo.kt * w)
        return np.array([w, (torque - servo.viscous_friction * w - weight * np.sin(q)) / inertia])

    state, h = np.array([start, 0.0]), 1e-4
    for _ in range(round(seconds / h)):
        a = rate(state)
        b = rate(state + h / 2 * a)
        c = rate(state + h / 2 * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + rate(state + h * c))
    return float(state[0])


def write_json(path: Path, count: int = 80, **changes: Any) -> None:
    """A recording file of `count` samples with some entries replaced."""
    time = np.cumsum(np.random.default_rng(len(str(path))).uniform(0.005, 0.006, count))
    entries = [
        {"timestamp": t, "goal_position": np.sin(3 * t), "position": 0.4 * np.sin(3 * t), "speed": 1.2 * np.cos(3 * t)}
        | {"load": 0, "input_volts": 7.3, "temp": 30, "torque_enable": True}
        for t in time.tolist()
    ]
    content = {**SETTING, "motor": "xl330", "trajectory": "sine", "entries": entries, **changes}
    path.write_text(json.dumps(content))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "servo.toml").write_text(TOML)
    for i in range(6):
        write_json(tmp_path / f"r{i}.json", kp=100 if i < 3 else 400)
    return tmp_path


@pytest.mark.parametrize(("goal", "start"), [(0.5, 0.0), (-1.5, 1.0), (3.0, 0.0)])
def test_model_equals_motor_equations(goal: float, start: float) -> None:
    """With saturation, back-EMF and gravity."""
    setting = SETTING | {"kp": 600}
    model = mujoco.MjModel.from_xml_string(
        servo_xml(NOMINAL, *(float(setting[k]) for k in ("mass", "length", "kp", "vin")))
    )
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    data.qpos[0], data.ctrl[0] = start, goal
    mujoco.mj_step(model, data, 3000)
    assert data.qpos[0] == pytest.approx(textbook(NOMINAL, goal, start, 0.3, setting), abs=2e-4)


def test_added_friction_holds_static_load() -> None:
    """A joint with friction above the load torque stays at rest; with MuJoCo's default it creeps by 20 mrad/s."""
    held = mujoco.MjModel.from_xml_string(servo_xml(NOMINAL, **SETTING))
    soft = mujoco.MjModel.from_xml_string(servo_xml(NOMINAL, **SETTING))
    soft.dof_solref[:], soft.dof_solimp[:] = [0.02, 1.0], [0.9, 0.95, 1e-3, 0.5, 2]
    ends = []
    for model in (held, soft):
        model.dof_frictionloss[:] = 0.6
        model.actuator_gainprm[:], model.actuator_biasprm[:] = 0, 0
        data = mujoco.MjData(model)
        data.qpos[:] = 1.0
        for _ in range(500):
            mujoco.mj_step(model, data)
        ends.append(float(data.qpos[0]))
    assert abs(ends[0] - 1.0) < 1e-4
    assert abs(ends[1] - 1.0) > 5e-3


def test_folder_is_read_as_dataset(folder: Path) -> None:
    dataset = open_dataset(folder)
    assert [r.split for r in dataset.recordings] == ["fit", "fit", "test", "fit", "test", "fit"]
    weak, strong = dataset.recordings[0].model, dataset.recordings[5].model
    assert strong.actuator_gainprm[0, 0] == pytest.approx(4 * weak.actuator_gainprm[0, 0])
    assert weak.actuator_forcerange[0, 1] == pytest.approx(0.4 / 3 * 7.4)
    assert len(dataset.parameters) == 3
    assert all(p.relative and p.low < 1 < p.high for p in dataset.parameters)
    assert mujoco.MjModel.from_xml_string(dataset.spec_xml).nu == 1
    first = dataset.recordings[0]
    np.testing.assert_allclose(first.qpos[:, 0], 0.4 * np.sin(3 * first.time))
    np.testing.assert_allclose(first.ctrl[:, 0], np.sin(3 * first.time))
    assert first.sensor["input_volts"][0] == 7.3
    assert first.qvel_measured.all()


def test_zero_parameters_are_not_refitted(folder: Path) -> None:
    (folder / "servo.toml").write_text(TOML.replace("armature = 0.002\n", "").replace("arm_mass = 0.03\n", ""))
    assert [p.name for p in load_servo(folder).parameters] == [
        "motor strength (torque per volt)",
        "back-EMF and viscous friction",
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": None}, r"r0\.json: mass = None: expected a positive number"),
        ({"entries": []}, r'r0\.json: expected an object with a list "entries"'),
        ({"entries": [{"timestamp": 0.1 * k, "position": 0.0} for k in range(30)]}, r"no entry has 'goal_position'"),
        ({"count": 10}, r"10 samples are too short"),
    ],
)
def test_invalid_recordings_raise(folder: Path, changes: dict[str, Any], message: str) -> None:
    write_json(folder / "r0.json", **changes)
    with pytest.raises(InputError, match=message):
        load_servo(folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kt = 0.4\n", "", r"\[servo\] has no kt"),
        ("kt = 0.4", "kt = -0.4", r"kt = -0\.4: expected a positive number"),
        ("resistance", "resistence", r"'resistence'; did you mean 'resistance'"),
        ("[servo]", "[motor]", r"no \[servo\] table"),
    ],
)
def test_invalid_nominal_values_raise(folder: Path, old: str, new: str, message: str) -> None:
    (folder / "servo.toml").write_text(TOML.replace(old, new))
    with pytest.raises(InputError, match=message):
        load_servo(folder)


def test_invalid_and_absent_json_raise(folder: Path, tmp_path: Path) -> None:
    (folder / "r0.json").write_text("{")
    with pytest.raises(InputError, match=r"r0\.json: not valid JSON"):
        load_servo(folder)
    for file in folder.glob("*.json"):
        file.unlink()
    with pytest.raises(InputError, match=r"no \.json recording"):
        load_servo(folder)
    (folder / "servo.toml").unlink()
    with pytest.raises(InputError, match=r"dataset\.toml.*servo\.toml"):
        open_dataset(folder)
