"""State estimation from noisy samples at uneven times, by local polynomial fits.

A polynomial in time is fitted by weighted least squares to the positions and measured velocities around a sample.
Positions are differences in the tangent space from this sample, so that all joint types are supported.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from btr_mjx.gap.simulate import Command, World
from btr_mjx.gap.windows.activation import activations
from btr_mjx.gap.windows.rows import row_blocks
from btr_mjx.models import difference, integrate
from btr_mjx.runs import available_cores

_WIDTHS = (3, 4, 5, 6, 8, 10, 13, 16, 20)
"""Candidates for the half width of the fit, in samples, or in times in which motion changes."""

_MOST_CHI2 = 1.2
"""Largest median chi^2 per degree of freedom, in the worst coordinate, of residuals that agree with the noise."""


@dataclass(frozen=True)
class Span:
    """Width and order of the local polynomial fit.

    Attributes:
      half: number of samples on either side.
      order: number of coefficients of the polynomial.
    """

    half: int
    order: int = 4


@dataclass(frozen=True)
class Track:
    """Measured states of one recording.

    Attributes:
      time: (K,) [s].
      qpos: (K, nq).
      qvel: (K, nv), ignored where `measured` is false.
      measured: (nv,) bool: which velocities were measured.
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    measured: np.ndarray


def smooth(
    model: mujoco.MjModel,
    track: Track,
    samples: np.ndarray,
    sigma: np.ndarray,
    span: Span,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed states at some samples of a recording.

    Args:
      model: the model.
      track: measured states of the recording.
      samples: (N,) sample indices.
      sigma: (2 nv,) noise of positions and velocities.
      span: width and order of the fit; at the ends of the recording its window is shifted inwards.

    Returns:
      qpos (N, nq), qvel (N, nv), and chi^2 per degree of freedom of the fit (N, nv).
    """
    count, nv = len(track.time), model.nv
    width = min(2 * span.half + 1, count)
    first = np.clip(samples - span.half, 0, count - width)
    index = first[:, None] + np.arange(width)
    tau = track.time[index] - track.time[samples][:, None]
    scale = np.maximum(np.abs(tau).max(1), 1e-9)
    u = tau / scale[:, None]
    centre = track.qpos[samples]
    position = difference(model, centre[:, None], track.qpos[index])  # (N, width, nv)
    velocity = np.where(track.measured, track.qvel[index], 0.0) * scale[:, None, None]
    order = min(span.order, width)
    basis = np.stack([u**p for p in range(order)], -1)  # (N, width, order)
    slope = np.stack([p * u ** max(p - 1, 0) for p in range(order)], -1)
    weight_v = np.where(track.measured, 1.0 / sigma[nv:], 0.0) / scale[:, None]  # (N, nv)
    weight_q = np.broadcast_to(1.0 / sigma[:nv], weight_v.shape)
    gram_q = np.einsum("nkp,nkr->npr", basis, basis)[:, None] * (weight_q**2)[..., None, None]
    gram_v = np.einsum("nkp,nkr->npr", slope, slope)[:, None] * (weight_v**2)[..., None, None]
    moment = np.einsum("nkp,nkj->njp", basis, position) * (weight_q**2)[..., None]
    moment = moment + np.einsum("nkp,nkj->njp", slope, velocity) * (weight_v**2)[..., None]
    gram = gram_q + gram_v
    gram = gram + 1e-9 * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] * np.eye(order)
    fitted = np.linalg.solve(gram, moment[..., None])[..., 0]  # (N, nv, order)
    left_q = (position - np.einsum("nkp,njp->nkj", basis, fitted)) * weight_q[:, None]
    left_v = (velocity - np.einsum("nkp,njp->nkj", slope, fitted)) * weight_v[:, None]
    freedom = width * (1 + track.measured) - order
    chi2 = ((left_q**2).sum(1) + (left_v**2).sum(1)) / np.maximum(freedom, 1)
    return integrate(model, centre, fitted[..., 0]), fitted[..., 1] / scale[:, None], chi2


def best_span(model: mujoco.MjModel, tracks: list[Track], sigma: np.ndarray, every: int = 1) -> Span:
    """Width and order of the fit with the smallest variance whose residuals are consistent with the noise.

    Args:
      model: the model.
      tracks: measured states of the recordings.
      sigma: (2 nv,) noise of positions and velocities.
      every: smallest number of samples in which motion changes. Samples that follow each other faster share noise, so
        that no width is consistent with what it seems to be: then a fit is as wide as it has to be.
    """
    found = [Span(every * _WIDTHS[0], 6)]
    for order in (4, 6):
        for half in [every * width for width in _WIDTHS]:
            chi2 = []
            for track in tracks:
                if len(track.time) < 2 * half + 1:
                    continue
                picks = np.unique(np.linspace(half, len(track.time) - 1 - half, 40).astype(int))
                chi2.append(smooth(model, track, picks, sigma, Span(half, order))[2])
            if not chi2 or np.median(np.concatenate(chi2), axis=0).max() > _MOST_CHI2:
                break
            found.append(Span(half, order))
    # The variance falls with the width; two more coefficients need about twice the samples for the same variance.
    return max(found, key=lambda span: span.half * (1.0 if span.order == 4 else 0.5))


def activation_histories(model: mujoco.MjModel, track: Track, command: Command) -> np.ndarray:
    """Activation states along a recording, driven by measured motion and command, from zero at the start.

    Args:
      model: the believed model, with `na` activations.
      track: measured states of the recording.
      command: command of the recording.

    Returns:
      (K, na) activations at the samples.
    """
    if not model.na:
        return np.zeros((len(track.time), 0))
    world = World.of(model)
    plain = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_INTEGRATOR, mujoco.mjtDyn.mjDYN_PID)
    if not np.isin(model.actuator_dyntype, [int(kind) for kind in plain]).all() or model.actuator_actlimited.any():
        return activations(world, command, track.time, track.qpos, np.where(track.measured, track.qvel, 0.0))
    # Pure integrators: the rate does not depend on the activation, so that all samples are evaluated at once.
    rate = np.empty((len(track.time), model.na))
    qvel, ctrl = np.where(track.measured, track.qvel, 0.0), world.command(command).at(track.time)
    for rows in row_blocks(len(track.time)):
        batch = Batch(world.model, nsim=rows.stop - rows.start, nthread=available_cores())
        batch.bind("qpos")[:], batch.bind("qvel")[:], batch.bind("ctrl")[:] = track.qpos[rows], qvel[rows], ctrl[rows]
        own = batch.bind("act_dot")
        batch.forward()
        rate[rows] = own
    step = np.diff(track.time)[:, None]
    out = np.zeros((len(track.time), model.na))
    out[1:] = np.cumsum(0.5 * step * (rate[1:] + rate[:-1]), axis=0)
    return out
