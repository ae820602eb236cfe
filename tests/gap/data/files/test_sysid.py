"""Files that `mujoco.sysid` itself writes."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_logs import ARM, FLOATER, RobotLog, simulated_log

from btr_mjx.errors import DamagedFile
from btr_mjx.gap.data import load, open_logs

timeseries = pytest.importorskip("mujoco.sysid._src.timeseries")
SENSORS = (
    '<sensor><jointpos name="enc_s" joint="shoulder"/><jointpos name="enc_e" joint="elbow"/>'
    '<jointvel name="vel_s" joint="shoulder"/><jointvel name="vel_e" joint="elbow"/></sensor></mujoco>'
)


def saved(folder: Path, name: str, log: RobotLog, model: mujoco.MjModel, names: list, data: np.ndarray) -> None:
    make = timeseries.TimeSeries.from_control_names if name == "control" else timeseries.TimeSeries.from_names
    make(log.time, data, model, names).save_to_disk(folder / f"{name}.npz")


@pytest.mark.parametrize("sensors", [False, True])
def test_states_or_sensors_and_controls_in_two_files(tmp_path: Path, sensors: bool) -> None:
    log = simulated_log(ARM, 1.0)
    xml = ARM.replace("</mujoco>", SENSORS) if sensors else ARM
    model = mujoco.MjModel.from_xml_string(xml)
    (tmp_path / "arm.xml").write_text(xml)
    kind = timeseries.SignalType
    names = [f"{joint}_{what}" for what in ("qpos", "qvel") for joint in ("elbow", "shoulder")]
    types = [kind.MjStateQPos] * 2 + [kind.MjStateQVel] * 2
    data = np.concatenate([log.qpos[:, ::-1], log.qvel[:, ::-1]], axis=1)
    if sensors:
        saved(tmp_path, "measured", log, model, ["enc_e", "enc_s", "vel_e", "vel_s"], data)
    else:
        saved(tmp_path, "measured", log, model, list(zip(names, types, strict=True)), data)
    saved(tmp_path, "control", log, model, ["shoulder", "elbow"], log.ctrl)
    (tmp_path / "dataset.toml").write_text(
        '[model]\nfile = "arm.xml"\n[[recording]]\nfile = ["measured.npz", "control.npz"]\n'
    )
    found = load(tmp_path).recordings
    for name in ("time", "qpos", "qvel", "ctrl"):
        np.testing.assert_allclose(
            np.concatenate([getattr(one, name) for one in found]), getattr(log, name), atol=1e-12
        )
    assert all(one.qvel_measured.all() for one in found)


def test_a_free_body_goes_by_the_name_of_its_body(tmp_path: Path) -> None:
    log, model = simulated_log(FLOATER, 1.0), mujoco.MjModel.from_xml_string(FLOATER)
    (tmp_path / "robot.xml").write_text(FLOATER)
    kind = timeseries.SignalType
    signals = [
        ("trunk_qpos", 7, kind.MjStateQPos),
        ("hip_qpos", 1, kind.MjStateQPos),
        ("trunk_qvel", 6, kind.MjStateQVel),
    ]
    signals += [("hip_qvel", 1, kind.MjStateQVel), ("hip_ctrl", 1, kind.MjCtrl)]
    data = np.concatenate([log.qpos, log.qvel, log.ctrl], axis=1)
    assert data.shape[1] == model.nq + model.nv + model.nu
    timeseries.TimeSeries.from_custom_map(log.time, data, signals).save_to_disk(tmp_path / "run.npz")
    found = open_logs(tmp_path / "robot.xml", [tmp_path / "run.npz"]).recordings
    for name in ("qpos", "qvel", "ctrl"):
        np.testing.assert_allclose(np.concatenate([getattr(one, name) for one in found]), getattr(log, name), atol=1e-9)


def test_a_mapping_that_does_not_fit_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    np.savez(tmp_path / "x.npz", times=np.zeros(30), data=np.zeros((30, 1)), signal_mapping='{"a": [2, [7]]}')
    with pytest.raises(DamagedFile, match="signal_mapping does not fit data of shape"):
        open_logs(tmp_path / "arm.xml", [tmp_path / "x.npz"])
