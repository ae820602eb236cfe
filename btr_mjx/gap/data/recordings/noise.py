"""Sensor noise: read from a dataset, or estimated from its recordings.

Estimate: divided differences of order `DIFFERENCE_ORDER` annihilate smooth motion; the median absolute value of the
normalised differences, divided by 0.6745, is a robust standard deviation of the noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES, state_columns
from btr_mjx.gap.data.recordings.unmeasured import POSITION_SIGMA, VELOCITY_SIGMA
from btr_mjx.models import difference, part_names
from btr_mjx.runs import check_keys, is_number

NOISE_KEYS = ("qpos", "qvel", "position", "rotation", "velocity", "angular_velocity")
DIFFERENCE_ORDER = 6
"""Order of the divided differences that remove the motion from a signal."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviation of the sensor noise.

    Attributes:
      qpos: (nv,) of the configuration, per tangent-space coordinate [rad or m].
      qvel: (nv,) of the velocity [rad/s or m/s].
    """

    qpos: np.ndarray
    qvel: np.ndarray


def read_noise(table: Any, model: mujoco.MjModel, where: str, notes: list[str]) -> Noise | None:
    """The noise of a [noise] table; None if it does not cover all coordinates."""
    names = part_names(model, "joint")
    columns = [f"{kind}/{name}" for name in names for kind in ("qpos", "qvel")]
    positions, velocities = state_columns(model)
    check_keys(table, [*NOISE_KEYS, *columns, *positions, *velocities], where, notes, strict=False)
    for key, value in table.items():
        if not is_number(value) or value <= 0:
            raise InputError(f"{where}: {key} = {value!r}: expected a positive standard deviation")
    sigma = np.full((2, model.nv), np.nan)
    for dof, (name, part) in enumerate(_coordinates(model)):
        turning = part.startswith("w")
        groups = ("rotation", "angular_velocity") if turning else ("position", "velocity")
        single = "" if turning else f"qpos/{name}/{part[1:]}"  # a rotation has no column of its own in qpos
        for row, (kind, own) in enumerate((("qpos", single), ("qvel", f"qvel/{name}/{part}"))):
            keys = [own, f"{kind}/{name}", *([groups[row]] if part else []), kind]
            sigma[row, dof] = next((float(table[key]) for key in keys if key in table), np.nan)
    if table and np.isnan(sigma).any():
        notes.append(f"{where}: does not cover all coordinates; the noise is estimated from the data instead")
    return None if np.isnan(sigma).any() else Noise(sigma[0], sigma[1])


_MIN_VARIANCE_RATIO = 0.5
"""Ratio of residual variance of a model to estimated variance of a channel, below which the estimate is reduced."""

_VARIANCE_FLOOR = 1e-4
"""Smallest ratio applied in one update: smoothed starting states, and thus the residual, depend on the estimate too."""

_Samples = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""time (K,), qpos (K, nq), qvel (K, nv), and (nv,) bool: which velocities were measured."""


def estimate_noise(model: mujoco.MjModel, tracks: Sequence[_Samples]) -> Noise:
    """Estimate the noise from divided differences of `DIFFERENCE_ORDER` + 1 consecutive samples.

    Args:
      model: the model.
      tracks: samples of each recording.

    Returns:
      The noise, at least the quantisation noise (step / sqrt(12)). For a velocity that was never measured: the noise
      of the position divided by the median sampling interval.
    """
    interval = float(np.median(np.concatenate([np.diff(track[0]) for track in tracks])))
    qpos: list[np.ndarray] = []
    qvel: list[np.ndarray] = []
    floor = quantisation_noise(model, tracks)
    for time, q, v, measured in tracks:
        index = np.arange(len(time) - DIFFERENCE_ORDER)[:, None] + np.arange(DIFFERENCE_ORDER + 1)
        weights = annihilator(time[index])
        moves = difference(
            model, q[index[:, DIFFERENCE_ORDER // 2]][:, None], q[index]
        )  # (N, DIFFERENCE_ORDER + 1, nv)
        qpos.append(np.einsum("ni,niv->nv", weights, moves))
        qvel.append(np.where(measured, np.einsum("ni,niv->nv", weights, v[index]), np.nan))
    ever = np.logical_or.reduce([track[3] for track in tracks])
    sigma_q = np.maximum(np.median(np.abs(np.concatenate(qpos)), axis=0) / 0.6745, floor[0])
    sigma_v = sigma_q / interval
    left = np.abs(np.concatenate(qvel))[:, ever]
    sigma_v[ever] = np.maximum(np.nanmedian(left, axis=0) / 0.6745, floor[1, ever])
    return Noise(sigma_q, sigma_v)


def quantisation_noise(model: mujoco.MjModel, tracks: Sequence[_Samples]) -> np.ndarray:
    """Noise (2, nv) of the digits of positions and velocities, step / sqrt(12): no sensor has less.

    Args:
      model: the model.
      tracks: samples of each recording.
    """
    floor = np.full((2, model.nv), 1e-12)
    for _, q, v, measured in tracks:
        for row, signal in enumerate((difference(model, q[:1], q), np.where(measured, v, 0.0))):
            step = np.array([_quantum(column) for column in signal.T])
            floor[row] = np.maximum(floor[row], np.maximum(step / np.sqrt(12), 1e-9 * np.ptp(signal, axis=0)))
    return floor


def without_sensor(noise: Noise, seen: np.ndarray) -> Noise:
    """The noise, with the steps by which states are varied where `seen` (nv,) is False: there is no encoder."""
    if seen.all():
        return noise
    return Noise(np.where(seen, noise.qpos, POSITION_SIGMA), np.where(seen, noise.qvel, VELOCITY_SIGMA))


def reduced_noise(
    sigma: np.ndarray, channels: np.ndarray, residual: np.ndarray, freedom: float, known: np.ndarray
) -> np.ndarray | None:
    """Reduce a noise estimate where the residual of a model is smaller than the estimate.

    Commands that change at every sample excite motion that is not smooth, which `estimate_noise` counts as noise. The
    residual variance of a model driven by the same commands is an upper bound of the noise, whatever the model lacks.

    Args:
      sigma: (2 nv,) the estimate.
      channels: (c,) indices of the measured coordinates.
      residual: (W, R) residual of a model in units of the estimate, R = samples * c, channel index last.
      freedom: residual degrees of freedom of a window.
      known: (c,) bool: coordinates whose noise is no estimate of this kind.

    Returns:
      (2 nv,) the reduced estimate; None if no channel needs a reduction.
    """
    share = (residual.reshape(len(residual), -1, len(channels)) ** 2).mean(1) * (residual.shape[1] / freedom)
    part = np.where(known, 1.0, np.median(share, axis=0))
    if (part >= _MIN_VARIANCE_RATIO).all():
        return None
    out = sigma.copy()
    out[channels] *= np.sqrt(np.where(part < _MIN_VARIANCE_RATIO, np.maximum(part, _VARIANCE_FLOOR), 1.0))
    return out


def annihilator(time: np.ndarray) -> np.ndarray:
    """Weights (N, n) of unit norm that annihilate every polynomial of degree below n - 1 at times (N, n)."""
    span = np.ptp(time, axis=1)[:, None, None]
    gaps = (time[:, :, None] - time[:, None, :]) / span
    gaps[:, np.arange(time.shape[1]), np.arange(time.shape[1])] = 1.0
    weights = 1.0 / np.prod(gaps, axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _quantum(signal: np.ndarray) -> float:
    """Step of a quantised signal; 0 if its values are not on a grid."""
    steps = np.diff(np.unique(signal))
    steps = steps[steps > 1e-9 * max(float(np.ptp(signal)), 1e-300)]
    if len(steps) < 2 or len(steps) > 0.8 * len(signal):
        return 0.0
    quantum = float(steps.min())
    return quantum if bool(np.all(np.abs(steps / quantum - np.round(steps / quantum)) < 0.01)) else 0.0


def noise_as_table(noise: Noise, model: mujoco.MjModel) -> Mapping[str, float]:
    """The [noise] table of a noise, one key per coordinate; the rotation of a joint has the value of its first axis."""
    table: dict[str, float] = {}
    for dof, (name, part) in enumerate(_coordinates(model)):
        turning = part.startswith("w")
        table[f"qvel/{name}/{part}".rstrip("/")] = float(noise.qvel[dof])
        table.setdefault(f"qpos/{name}" if turning else f"qpos/{name}/{part[1:]}".rstrip("/"), float(noise.qpos[dof]))
    return table


def _coordinates(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Joint and suffix of its velocity, "" for hinges and slides, of each of the nv coordinates."""
    joints = zip(part_names(model, "joint"), model.jnt_type.tolist(), strict=True)
    return [(name, part) for name, kind in joints for part in SUFFIXES.get(kind, ((), ("",)))[1]]
