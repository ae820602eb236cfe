"""Digest of a robot: whether two runs have the same one."""

from dataclasses import replace

from btr_mjx.models.compilation import base_model
from btr_mjx.robots import Robot
from btr_mjx.runs import content_digest


def robot_digest(robot: Robot) -> str:
    """SHA-256, in hex, of a robot and of its compiled model, which holds the files that its MJCF includes.

    Where these files are does not matter, nor does the robot's name.

    Raises:
      InputError: the model cannot be compiled.
    """
    return content_digest(replace(robot, name="", template_path="", folder=""), base_model(robot))
