"""Measured forces that drive a model whose controllers are unknown."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_logs import ARM

from btr_mjx.errors import InputError
from btr_mjx.gap.data import load, open_dataset
from btr_mjx.gap.data.columns.matching import match_columns
from btr_mjx.gap.data.measured_forces import driven_by_forces
from btr_mjx.gap.effects import known_effects
from btr_mjx.gap.results.mended_model import acts_through_actuators
from btr_mjx.gap.results.records import FoundEffect

MODEL = mujoco.MjModel.from_xml_string(ARM)
DRIVES = """<mujoco><worldbody><body><joint name="hip"/><geom size="0.1" pos="0 0 -0.3"/>
<body pos="0 0 -0.3"><joint name="knee" axis="1 0 0"/><geom size="0.05" pos="0 0.1 -0.2"/></body></body></worldbody>
<actuator><position name="hip" joint="hip" kp="40" kv="1" gear="3" forcerange="-2 2" ctrlrange="-0.3 0.3"/>
<general name="knee" joint="knee" dyntype="filter" dynprm="0.05" gainprm="9" biastype="affine" biasprm="0.2 -5 -0.1"/>
</actuator></mujoco>"""


def test_forces_that_were_measured_move_the_model_as_its_own_drives_did() -> None:
    model = mujoco.MjModel.from_xml_string(DRIVES)
    driven = driven_by_forces(model)
    one, other, angles = mujoco.MjData(model), mujoco.MjData(driven), []
    for _ in range(500):
        one.ctrl[:] = np.sin(7 * one.time), np.cos(5 * one.time)
        mujoco.mj_step1(model, one)
        mujoco.mj_step2(model, one)
        other.ctrl[:] = one.actuator_force
        mujoco.mj_step(driven, other)
        angles.append([one.qpos.copy(), other.qpos.copy()])
    own, same = np.moveaxis(np.array(angles), 1, 0)
    assert np.abs(own - same).max() < 1e-9 < 0.1 < np.ptp(own, axis=0).min()
    assert model.actuator_gainprm[0, 0] == 40


def test_efforts_are_what_drives_and_commands_have_no_use() -> None:
    columns = ["time", "q_shoulder", "q_elbow", "shoulder_cmd", "u_elbow", "tau_shoulder", "effort/elbow"]
    found = match_columns([("log", columns)], driven_by_forces(MODEL), {}, "log.csv", forces=True).names
    assert {column: target for (_, column), target in found.items() if target.startswith(("ctrl", "force"))} == {
        "tau_shoulder": "ctrl/shoulder",
        "effort/elbow": "ctrl/elbow",
    }
    exact = [("log", ["time", "qpos", "ctrl/shoulder", "ctrl/elbow", "force/shoulder", "force/elbow"])]
    names = match_columns(exact, MODEL, {}, "log.csv", forces=True).names
    assert names[0, "force/elbow"] == "ctrl/elbow"
    assert (0, "ctrl/elbow") not in names


def written(folder: Path, columns: str) -> list[Path]:
    """A model and two logs, whose numbers mean nothing."""
    (folder / "arm.xml").write_text(ARM)
    t = np.arange(0, 2, 0.01)
    rows = np.stack([t, *(np.sin(k * t) for k in range(1, columns.count(",") + 1))], 1)
    logs = [folder / "a.csv", folder / "b.csv"]
    for log in logs:
        np.savetxt(log, rows, delimiter=",", header=columns, comments="")
    return logs


def test_a_log_without_commands_is_driven_by_its_forces(tmp_path: Path) -> None:
    logs = written(tmp_path, "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow")
    data = open_dataset(tmp_path / "arm.xml", logs=logs)
    t = data.recordings[0].time
    assert data.forces
    np.testing.assert_allclose(data.recordings[0].ctrl, np.stack([np.sin(3 * t), np.sin(4 * t)], 1), atol=1e-9)
    assert any("forces of the actuators" in note for note in data.notes)
    (tmp_path / "dataset.toml").write_text(data.inferred)
    again = load(tmp_path)
    assert again.forces
    np.testing.assert_array_equal(again.recordings[1].ctrl, data.recordings[1].ctrl)


def test_commands_win_where_they_were_logged_unless_said_otherwise(tmp_path: Path) -> None:
    logs = written(tmp_path, "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,cmd_shoulder,cmd_elbow")
    data = open_dataset(tmp_path / "arm.xml", logs=logs)
    assert not data.forces
    assert set(data.recordings[0].force) == {"shoulder", "elbow"}
    (tmp_path / "dataset.toml").write_text(data.inferred.replace("[control]", '[control]\nmeasured = "force"'))
    assert load(tmp_path).forces
    (tmp_path / "dataset.toml").write_text(data.inferred.replace("[control]", '[control]\nmeasured = "torque"'))
    with pytest.raises(InputError, match="expected 'command' or 'force'"):
        load(tmp_path)


def test_what_acts_through_actuators_is_told_from_the_rest() -> None:
    effects = list(known_effects().values())
    for effect, place, numbers, expected in (
        ("actuator_gain", "actuator:elbow", {"change": -0.1}, True),
        ("actuator_delay", "actuator:elbow", {"delay": 0.01}, True),
        ("viscous_damping", "joint:elbow", {"damping": 0.1}, False),
        ("armature", "joint:elbow", {"armature": 0.1}, False),
    ):
        assert acts_through_actuators(MODEL, FoundEffect(effect, place, numbers), effects) == expected


def test_forces_beside_commands_of_another_file_are_measurements(tmp_path: Path) -> None:
    """Only together the two files have all columns; torques alone do not make the first one complete."""
    written(tmp_path, "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow")
    states, commands = tmp_path / "states.csv", tmp_path / "commands.csv"
    (tmp_path / "a.csv").rename(states)
    rows = np.loadtxt(states, delimiter=",", skiprows=1)[:, :3]
    np.savetxt(commands, rows, delimiter=",", header="time,cmd_shoulder,cmd_elbow", comments="")
    data = open_dataset(tmp_path / "arm.xml", logs=[states, commands])
    assert not data.forces
    assert len({r.name for r in data.recordings}) <= 2
    assert set(data.recordings[0].force) == {"shoulder", "elbow"}
    t = data.recordings[0].time
    np.testing.assert_allclose(data.recordings[0].ctrl[:, 0], np.sin(t), atol=1e-3)
