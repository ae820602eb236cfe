"""Robots whose controllers are unknown: the forces that their actuators were measured to have are what drives them."""

import copy

import mujoco
import numpy as np


def driven_by_forces(model: mujoco.MjModel) -> mujoco.MjModel:
    """A model whose actuators have the forces that they are given, whatever they are in the MJCF.

    Args:
      model: with servos, motors or others; one control each; it is not changed.

    Returns:
      A copy in which `actuator_force` is `ctrl`. Gears, tendons and limits of forces at joints stay.
    """
    out = copy.copy(model)
    out.actuator_gaintype[:], out.actuator_biastype[:] = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
    out.actuator_dyntype[:], out.actuator_actadr[:], out.actuator_actnum[:] = mujoco.mjtDyn.mjDYN_NONE, -1, 0
    out.actuator_gainprm[:], out.actuator_biasprm[:] = np.eye(1, out.actuator_gainprm.shape[1]), 0.0
    out.actuator_ctrllimited[:], out.actuator_forcelimited[:], out.actuator_actlimited[:] = 0, 0, 0
    out.actuator_delay[:] = 0.0
    return out
