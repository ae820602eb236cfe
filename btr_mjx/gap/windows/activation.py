"""Activation states of actuators (integrators, filters) along a recording with known motion and command.

The measured positions and velocities are prescribed at every step, and MuJoCo integrates the activation states.
"""

import copy

import mujoco
import numpy as np

from btr_mjx.gap.simulate import Command, World, command_phase
from btr_mjx.models import between, integrate


def activations(
    world: World,
    command: Command,
    time: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Activation states of the actuators of a world along a recording.

    Args:
      world: its command edits and encoder offsets are applied, its laws are not.
      command: command of the recording.
      time: (K,) ascending [s].
      qpos: (K, nq) measured configurations.
      qvel: (K, nv) measured velocities.
      start: (na,) activation at the first sample; None for zeros.

    Returns:
      (K, na) activation at the samples.
    """
    model = copy.copy(world.model)
    out = np.zeros((len(time), model.na))
    if start is not None:
        out[0] = start
    if not model.na:
        return out
    true = integrate(model, qpos, -world.offset) if world.offset.any() else qpos
    sent, data, phase = world.command(command), mujoco.MjData(model), command_phase(model)
    data.act[:] = out[0]
    for k in range(1, len(time)):
        length = time[k] - time[k - 1]
        steps = max(1, round(length / world.model.opt.timestep))
        model.opt.timestep = length / steps
        fractions = np.arange(steps) / steps
        path_q, path_v = between(
            model,
            (np.tile(true[k - 1], (steps, 1)), np.tile(qvel[k - 1], (steps, 1))),
            (np.tile(true[k], (steps, 1)), np.tile(qvel[k], (steps, 1))),
            fractions,
            length,
        )
        controls = sent.over_step(time[k - 1] + fractions * length, length / steps, phase)
        for q, v, u in zip(path_q, path_v, controls, strict=True):
            data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
            mujoco.mj_step(model, data)
        out[k] = data.act
    return out
