"""Rivals of a diagnosis: a regression of forces as arm identification does it, and published numbers."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from machine import Log, Trial
from open_loop import Predictor, believed_models, simulated
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter

FILTER, LEAST = 0.03, 5
"""Window of the filter that differentiates positions [s], and its smallest number of samples."""
SLIDING = 0.01
"""Speed below which dry friction counts as partly stuck [rad/s or m/s]."""
GAINS = (0.2, 5.0)
"""Bounds of an actuator's gain, as a share of the believed one."""


def regression(trial: Trial, with_gain: bool) -> dict[str, np.ndarray] | None:
    """Numbers of every joint by least squares on the balance of forces along the fitted recordings.

    inverse dynamics(q, v, a) = g tau(q, v, u) - f tanh(v / v0) - d v - J a - c, with q, v and a of a polynomial filter.

    Args:
      trial: recordings and believed models.
      with_gain: also fit g; otherwise it is 1.

    Returns:
      (nv,) arrays of f, d, J, g and c by field; None for robots with free joints, to which this does not apply.
    """
    models = believed_models(trial)
    if (models[""].jnt_type <= int(mujoco.mjtJoint.mjJNT_BALL)).any():
        return None
    rows = [np.stack(balance(models[log.own_model], log)) for log in trial.logs if log.split == "fit"]
    inverse, driven, v, a = np.concatenate(rows, axis=1)
    out = np.empty((5, models[""].nv))
    for j in range(models[""].nv):
        columns = np.column_stack([-np.tanh(v[:, j] / SLIDING), -v[:, j], -a[:, j], driven[:, j], -np.ones(len(v))])
        gain = GAINS if with_gain and np.ptp(driven[:, j]) > 0 else (1 - 1e-9, 1 + 1e-9)
        bounds = ([0, 0, 0, gain[0], -np.inf], [np.inf, np.inf, np.inf, gain[1], np.inf])
        out[:, j] = lsq_linear(columns, inverse[:, j], bounds).x
    return dict(zip(("dof_frictionloss", "dof_damping", "dof_armature", "gain", "offset"), out, strict=True))


def balance(model: mujoco.MjModel, log: Log) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Forces of inverse dynamics and of actuators, velocities and accelerations, (K, nv) each, on an even clock."""
    step = float(np.median(np.diff(log.time)))
    at = np.arange(log.time[0], log.time[-1], step)
    width = max(LEAST, round(FILTER / step)) | 1
    q, u = (np.column_stack([np.interp(at, log.time, x) for x in part.T]) for part in (log.qpos, log.ctrl))
    u = savgol_filter(u, width, 2, axis=0)
    v, a = (savgol_filter(q, width, 3, deriv=order, delta=step, axis=0) for order in (1, 2))
    data, inverse, driven = mujoco.MjData(model), np.empty_like(v), np.empty_like(v)
    for k in range(len(at)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_forward(model, data)
        driven[k], data.qacc[:] = data.qfrc_actuator, a[k]
        mujoco.mj_inverse(model, data)
        inverse[k] = data.qfrc_inverse
    inside = slice(width, -width)
    return inverse[inside], driven[inside], v[inside], a[inside]


def with_numbers(model: mujoco.MjModel, numbers: Mapping[str, Sequence[float] | np.ndarray]) -> mujoco.MjModel:
    """A copy of a model with numbers of its joints added; "gain" and "offset" (of the force) change its actuators."""
    model = copy.copy(model)
    for name, values in numbers.items():
        if name not in ("gain", "offset"):
            getattr(model, name)[:] += values
    mujoco.mj_setConst(model, mujoco.MjData(model))  # friction is as stiff as inertia allows
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    if "gain" in numbers:
        share = np.asarray(numbers["gain"])[dofs, None]
        model.actuator_gainprm[:, :1] *= share
        model.actuator_biasprm[:, :3] *= share
    if "offset" in numbers:
        model.actuator_biastype[:] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        model.actuator_biasprm[:, 0] -= np.asarray(numbers["offset"])[dofs] / model.actuator_gear[:, 0]
    return model


def predictor(trial: Trial, numbers: Mapping[str, Any], delay: float = 0.0) -> Predictor:
    """Predictions of the believed models with added numbers and with commands that act late [s]."""
    models = {name: with_numbers(model, numbers) for name, model in believed_models(trial).items()}
    return simulated(lambda log: (models[log.own_model], ()), trial.interpolation, delay)
