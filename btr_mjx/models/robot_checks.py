"""Checks that a robot's model, signal and names fit each other, before trials are simulated."""

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models.compilation import base_model, start_of
from btr_mjx.models.paths import nearest_names
from btr_mjx.robots import Robot

MAX_STEPS = 10_000_000
"""Most time steps of a trial."""


def check_robot(robot: Robot) -> None:
    """Check a robot with its compiled nominal model.

    Raises:
      InputError: a template or model that is not accepted, a trial that is shorter than a time step or longer than
        `MAX_STEPS`, a base, point or keyframe that the model lacks, or a signal that does not fit the model's motors.
    """
    model = base_model(robot)
    start_of(robot)
    steps = robot.duration / model.opt.timestep
    if not 1 <= steps <= MAX_STEPS:
        raise InputError(
            f"duration: got {robot.duration:g} s, {steps:.4g} time steps of {model.opt.timestep:g} s; expected 1 to "
            f"{MAX_STEPS}"
        )
    base_address(robot)
    _check_signal(robot, model)


def free_joints(model: mujoco.MjModel) -> dict[str, int]:
    """Body -> its free joint."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    return {model.body(int(model.jnt_bodyid[j])).name: int(j) for j in free}


def base_address(robot: Robot) -> tuple[int, int] | None:
    """Addresses of the base's free joint in qpos and in qvel; None for a robot with a fixed base.

    Raises:
      InputError: the robot's base body does not exist or has no free joint.
    """
    if robot.base_body is None:
        return None
    model = base_model(robot)
    joints = free_joints(model)
    if robot.base_body not in joints:
        bodies = [model.body(i).name for i in range(1, model.nbody)]
        raise InputError(
            f"{robot.template_path}: expected a body {robot.base_body!r} with a free joint; nearest: "
            f"{nearest_names(robot.base_body, [*joints] or bodies)}"
        )
    joint = joints[robot.base_body]
    return int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])


def _check_signal(robot: Robot, model: mujoco.MjModel) -> None:
    box = robot.controller_box
    middle = 0.5 * (box.low + box.high)[:, None].repeat(2, axis=1)
    try:
        found = np.asarray(robot.signal(middle, 0.5 * robot.duration, np))
    except Exception as error:  # the signal may be the user's own function
        raise InputError(f"{robot.name}: its signal fails: {type(error).__name__}: {error}") from error
    if found.shape != (model.nu, 2):
        raise InputError(
            f"{robot.template_path}: the model has {model.nu} controls, and the signal of {robot.name} is made for "
            f"{found.shape[0] if found.ndim else 0}; expected the same motors"
        )
    if not np.isfinite(found).all():
        raise InputError(f"{robot.name}: its signal is not finite at {0.5 * robot.duration:g} s")
