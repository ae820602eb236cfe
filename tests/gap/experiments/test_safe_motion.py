"""Proposed commands do not crash robots that fly or balance, and do not spare those that hold themselves."""

import mujoco
import numpy as np
import pytest
from gap_arm import dataset
from gap_arm import recording as arm_recording

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.experiments.next_experiment import is_survived
from btr_mjx.gap.experiments.safe_motion import _guarded, stays_near_recordings
from btr_mjx.gap.experiments.trial_commands import random_commands

DRONE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="frame" pos="0 0 1">
  <freejoint/><geom type="box" size=".1 .1 .02" mass="0.5"/><site name="hub"/></body></worldbody>
  <actuator><motor name="lift" site="hub" gear="0 0 1 0 0 0"/><motor name="roll" site="hub" gear="0 0 0 1 0 0"/>
  <motor name="pitch" site="hub" gear="0 0 0 0 1 0"/></actuator></mujoco>"""
BALANCER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <joint name="ankle" axis="0 1 0" damping="0.01"/><geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="1"
  contype="0"/></body></worldbody><actuator><motor name="ankle" joint="ankle"/></actuator></mujoco>"""


def drone_control(data, time):
    x, y = data.qpos[4:6]
    lift = 0.5 * 9.81 + 4 * (1 + 0.1 * np.sin(3 * time) - data.qpos[2]) - 2 * data.qvel[2]
    roll = -0.4 * (2 * x - 0.15 * np.sin(4 * time)) - 0.08 * data.qvel[3]
    pitch = -0.4 * (2 * y - 0.15 * np.sin(5 * time)) - 0.08 * data.qvel[4]
    return [lift, roll, pitch]


def balance_control(data, time):
    return [-20 * (data.qpos[0] - 0.15 * np.sin(3 * time)) - 2 * data.qvel[0]]


def recorded(xml, control) -> Dataset:
    """Four seconds of a robot under feedback, sampled at 100 Hz."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, rows = mujoco.MjData(model), []
    for k in range(2000):
        data.ctrl[:] = control(data, data.time)
        if k % 5 == 0:
            rows.append((data.time, data.ctrl.copy(), data.qpos.copy(), data.qvel.copy()))
        mujoco.mj_step(model, data)
    time, ctrl, qpos, qvel = (np.array(part) for part in zip(*rows, strict=True))
    seen = np.ones(model.nv, bool)
    sides = [Recording(f"run-{s}", time, ctrl, qpos, qvel, seen, s, model) for s in ("fit", "test")]
    arm = dataset(fit=1, test=1)
    return Dataset(**{**vars(arm), "model": model, "recordings": tuple(sides), "parameters": (), "tolerances": {}})


@pytest.mark.parametrize(("xml", "control"), [(DRONE, drone_control), (BALANCER, balance_control)])
def test_robots_that_fly_or_balance_get_no_command_without_feedback(xml, control):
    robot = recorded(xml, control)
    assert stays_near_recordings(robot.recordings[0], robot)
    commands = random_commands(robot, np.random.default_rng(0), 10)
    assert not any(is_survived(command, [Hypothesis((), ())], robot) for command in commands)


def test_an_arm_that_holds_itself_gets_commands():
    arm = dataset(fit=2, test=1)
    commands = random_commands(arm, np.random.default_rng(0), 10)
    assert sum(is_survived(command, [Hypothesis((), ())], arm) for command in commands) >= 7


def test_tilt_and_height_are_those_of_mujoco():
    model = mujoco.MjModel.from_xml_string(DRONE)
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    qpos, told = np.zeros((20, 7)), []
    for row in qpos:
        row[:3], row[3:] = rng.standard_normal(3), rng.standard_normal(4)
        row[3:] /= np.linalg.norm(row[3:])
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        told.append([data.xpos[1, 2], np.arccos(data.xmat[1].reshape(3, 3)[2, 2])])
    time = np.arange(20.0)
    motion = Recording("r", time, np.zeros((20, 3)), qpos, np.zeros((20, 6)), np.ones(6, bool), "fit", model)
    np.testing.assert_allclose(_guarded(motion), told, atol=1e-12)


def test_joints_may_go_as_far_again_as_they_have_been():
    arm = dataset(fit=2, test=1)
    one = arm_recording("one", seed=0)
    far = Recording(**{**vars(one), "qpos": 4 * one.qpos})
    assert stays_near_recordings(one, arm)
    assert not stays_near_recordings(far, arm)
