"""Columns with unknown names are taken where they can be one column of the model only, and asked for otherwise."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.plan import LogOptions, plan_tables
from btr_mjx.gap.data.files.table import log_table

FURUTA = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><joint name="arm" axis="0 0 1"/>
<geom size="0.1" mass="1"/><body pos="0.2 0 0"><joint name="pendulum" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</body></worldbody><actuator><motor name="drive" joint="arm"/></actuator></mujoco>""")
FINGER = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><joint name="FFJ2"/><geom size="0.1" mass="1"/>
<body pos="0.2 0 0"><joint name="FFJ1"/><geom size="0.1" mass="1"/></body></body></worldbody>
<tendon><fixed name="FFJ0"><joint joint="FFJ2" coef="1"/><joint joint="FFJ1" coef="1"/></fixed></tendon>
<actuator><position name="A_FFJ0" tendon="FFJ0" kp="5"/></actuator></mujoco>""")
ARM = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><joint name="hip"/><geom size="0.1" mass="1"/>
<body pos="0.2 0 0"><joint name="knee"/><geom size="0.1" mass="1"/></body></body></worldbody>
<actuator><motor name="hip" joint="hip"/><motor name="knee" joint="knee"/></actuator></mujoco>""")


def matched(model: mujoco.MjModel, *columns: str) -> tuple[dict[str, str], list[str]]:
    notes: list[str] = []
    table = log_table(Path("log.csv"), "", {name: np.arange(30.0) for name in ("time", *columns)})
    (plan,) = plan_tables([table], model, LogOptions(), "log.csv", notes)
    return dict(plan.names), [note for note in notes if note.startswith("assumed")]


@pytest.mark.parametrize(
    ("model", "columns", "column", "target"),
    [
        (FURUTA, ("theta_arm", "alpha_pendulum", "drive_cmd"), "alpha_pendulum", "qpos/pendulum"),
        (FURUTA, ("theta_arm", "theta_pendulum", "tau"), "tau", "ctrl/drive"),
        (FURUTA, ("theta_arm", "beta_pendulum", "u"), "u", "ctrl/drive"),
        (ARM, ("hip_pos", "knee_pos", "hip_torque", "tau"), "tau", "ctrl/knee"),
        (ARM, ("hip_pos", "gamma_knee", "hip_torque", "knee_torque"), "gamma_knee", "qpos/knee"),
    ],
)
def test_what_can_be_one_column_only_is_taken_and_told(
    model: mujoco.MjModel, columns: tuple[str, ...], column: str, target: str
) -> None:
    names, assumed = matched(model, *columns)
    assert names[column] == target
    assert any(repr(column) in note and target in note for note in assumed)


def test_a_command_has_the_name_of_the_tendon_that_its_actuator_pulls() -> None:
    names, assumed = matched(FINGER, "FFJ0_target", "FFJ2_position", "FFJ1_position")
    assert names["FFJ0_target"] == "ctrl/A_FFJ0"
    assert assumed == []


@pytest.mark.parametrize(
    ("model", "columns", "missing"),
    [
        (FURUTA, ("theta_arm", "alpha_pendulum", "beta_pendulum", "drive_cmd"), "qpos/pendulum"),  # two may be it
        (ARM, ("hip_pos", "knee_pos", "tau"), "ctrl/hip"),  # it may be two
        (ARM, ("hip_pos", "knee_pos", "hip_torque", "tau", "effort"), "ctrl/knee"),
        (ARM, ("hip_pos", "knee_temperature", "battery", "hip_torque", "knee_torque"), "qpos/knee"),
        (ARM, ("hip_pos", "alpha_knee"), "ctrl/hip"),  # it may be a position or a command
        (ARM, ("hip_pos", "knee_pos", "hip_torque", "status"), "ctrl/knee"),
    ],
)
def test_what_may_be_something_else_is_asked_for(model: mujoco.MjModel, columns: tuple[str, ...], missing: str) -> None:
    with pytest.raises(InputError, match=missing):
        matched(model, *columns)
