"""Joints without an encoder: a first estimate of their motion, from which windows estimate their states.

The believed model is simulated along a recording while the measured joints are held at their measured states, so that
only the others move by themselves. Where such a joint is stable, an error of its start dies out; in every window its
starting state is an unknown like any other, with bounds far wider than those of measured coordinates.
"""

import copy
from collections.abc import Collection

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES, unmeasured_bases
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import between, part_names

POSITION_SIGMA, VELOCITY_SIGMA = 0.01, 0.1
"""Steps by which the state of such a joint is varied, in place of its noise [rad or m], [rad/s or m/s]."""


def unmeasured_joints(columns: Collection[str], model: mujoco.MjModel, where: str) -> list[int]:
    """Ids of the hinges and slides of which no column holds the position, and of bases of which only an IMU was logged.

    Raises:
      InputError: a free or ball joint without its columns, a velocity without its position, or nothing measured.
    """
    names, out = part_names(model, "joint"), unmeasured_bases(columns, model)
    for joint, name in enumerate(names):
        parts = SUFFIXES.get(int(model.jnt_type[joint]))
        if parts is not None and joint not in out and not any(f"qpos/{name}/{part}" in columns for part in parts[0]):
            what = "free" if len(parts[0]) > 4 else "ball"
            raise InputError(
                f"{where}: there is no column 'qpos/{name}/{parts[0][0]}': the pose of a {what} joint cannot be "
                "estimated from the other joints; record it, or leave the joint out of the model"
            )
        if parts is None and f"qpos/{name}" not in columns:
            out.append(joint)
    out.sort()
    if out and len(out) == model.njnt:
        expected = listed(f"qpos/{name}" for name in names)
        raise InputError(f"{where}: there is no column of a joint's position; expected {expected}")
    for joint in out:
        if any(f"{c}/".startswith(f"qvel/{names[joint]}/") for c in columns):
            raise InputError(
                f"{where}: there is no column 'qpos/{names[joint]}', but one of its velocity; record both, or leave "
                "both out: the joint's state is then estimated"
            )
    return out


def estimate_motion(
    model: mujoco.MjModel, time: np.ndarray, ctrl: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, joints: list[int]
) -> None:
    """Estimate the states of joints that were not measured, in place.

    Args:
      model: the believed model.
      time: (K,) [s].
      ctrl: (K, nu) commands.
      qpos: (K, nq) configurations; those of `joints` are written.
      qvel: (K, nv) velocities; those of `joints` are written.
      joints: ids of hinges and slides.

    Raises:
      InputError: the simulation diverges.
    """
    own_q, own_v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    qpos[:, own_q], qvel[:, own_v] = model.qpos0[own_q], 0.0
    model = copy.copy(model)
    data = mujoco.MjData(model)
    for k in range(1, len(time)):
        length = time[k] - time[k - 1]
        steps = max(1, round(length / model.opt.timestep))
        model.opt.timestep = length / steps
        many = np.zeros(steps, int)
        ends = [(qpos[many + i], qvel[many + i]) for i in (k - 1, k)]
        path_q, path_v = between(model, ends[0], ends[1], np.arange(steps) / steps, length)
        q, v = qpos[k - 1, own_q].copy(), qvel[k - 1, own_v].copy()
        for i in range(steps):
            data.qpos[:], data.qvel[:] = path_q[i], path_v[i]
            data.qpos[own_q], data.qvel[own_v] = q, v
            data.ctrl[:] = ctrl[k - 1] + (i + 0.5) / steps * (ctrl[k] - ctrl[k - 1])
            mujoco.mj_step(model, data)
            q, v = data.qpos[own_q].copy(), data.qvel[own_v].copy()
        qpos[k, own_q], qvel[k, own_v] = q, v
        if not (np.isfinite(q).all() and np.isfinite(v).all()) or np.abs(v).max() > 1e4:
            names = ", ".join(part_names(model, "joint")[j] for j in joints)
            raise InputError(
                f"the motion of {names}, without an encoder, cannot be estimated: the believed model diverges at "
                f"{time[k]:.4g} s; record the joint, or begin where it is at rest"
            )
