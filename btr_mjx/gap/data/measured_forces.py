"""Robots whose controllers are unknown: the forces that their actuators were measured to have are what drives them."""

import copy

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models import part_names


def driven_by_forces(model: mujoco.MjModel, where: str) -> mujoco.MjModel:
    """A model whose actuators have the forces that they are given, whatever they are in the MJCF.

    Args:
      model: with servos, motors or others; it is not changed.
      where: file, for messages.

    Returns:
      A copy in which `actuator_force` is `ctrl`. Gears, tendons and limits of forces at joints stay.

    Raises:
      InputError: an actuator with several controls.
    """
    names = part_names(model, "actuator")
    if len(names) != model.nu:
        raise InputError(
            f'{where}: [control] measured = "force": the model has {model.nu} controls and {len(names)} actuators; '
            "expected one control for each; leave the line out and give commands"
        )
    out = copy.copy(model)
    out.actuator_gaintype[:], out.actuator_biastype[:] = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
    out.actuator_dyntype[:], out.actuator_actadr[:], out.actuator_actnum[:] = mujoco.mjtDyn.mjDYN_NONE, -1, 0
    out.actuator_gainprm[:], out.actuator_biasprm[:] = np.eye(1, out.actuator_gainprm.shape[1]), 0.0
    out.actuator_ctrllimited[:], out.actuator_forcelimited[:], out.actuator_actlimited[:] = 0, 0, 0
    out.actuator_delay[:] = 0.0
    return out
