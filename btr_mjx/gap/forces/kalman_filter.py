"""Likelihood of recordings: a Kalman filter over linearised motion with noisy encoders and random forces.

State: error e of position and velocity, and of forces that drives report (nx). A random generalised force f (nv) is
new in every interval h,

    e_(k+1) = A_k e_k + G_k f_k + S_k theta - d_k,      var f_k = q SPAN / h_k
    z_k = e_k + sensor noise of variance sigma^2 + (xdot sigma_t)^2

It has no memory: what lasts is for names to explain. q -> 0 is output error (noise of the encoders only), sigma -> 0
equation error (inverse dynamics). sigma_t is the jitter of time stamps. Innovations are linear in theta: all columns
pass through the filter together, and what remains is least squares. Variances are estimated with the disturbance
smoother (Koopman and Shephard 1992; Durbin and Koopman 2012).
"""

from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.forces.motion import Linearised

NU = 3.0
"""Degrees of freedom of the random force, a Student distribution: gears stick, joints reverse, somebody touches the
robot."""

LASTS = 0.03
"""Time for which a force is unusual [s]: a joint turns round and a hand touches for more than a sample."""

SPAN = 0.01
"""Time over which the random force is averaged where its size is told [s]; the sampling rate has no part in it."""

_START = 30.0
"""Standard deviation of a starting state, in units of the noise of its measurement (velocities: of their
difference quotient): wide, but not so that digits are lost."""


@dataclass(frozen=True, eq=False)
class Variances:
    """Variances of all that is random.

    Attributes:
      sensor: (nx,) variance of measurements: positions, velocities, forces.
      jitter: variance of time stamps [s^2].
      force: (nv,) variance of the random generalised force, averaged over `SPAN` [N^2 or (N m)^2].
      weight: (S, blocks, nv) weights of the force, 1 where it is usual and less where it is not (heavy tails), over
        blocks of `LASTS`; None for 1.
    """

    sensor: np.ndarray
    jitter: float
    force: np.ndarray
    weight: np.ndarray | None = None

    @property
    def penalty(self) -> float:
        """-2 ln of the density of the weights, without a constant."""
        return 0.0 if self.weight is None else float(self.share_of_penalty().sum())

    def share_of_penalty(self) -> np.ndarray:
        """(S,) the same by stretch."""
        assert self.weight is not None
        return NU * (self.weight - 1 - np.log(self.weight)).sum((1, 2))


@dataclass(frozen=True, eq=False)
class Filtered:
    """Whitened innovations.

    Attributes:
      gram: (S, 1 + C, 1 + C) inner products of the whitened innovations of each stretch: of the residual
        (first), and of the columns.
      log_determinant: (S,) of the innovations' covariances.
      count: number of measured values in a stretch.
    """

    gram: np.ndarray
    log_determinant: np.ndarray
    count: int


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What the disturbance smoother says of a residual.

    Attributes:
      state: (S, K + 1, 2 nv) expected error e.
      force: (S, K, nv) expected random force [N or N m].
      variances: updated.
      loss: -2 ln p of the residual with the variances as they were.
    """

    state: np.ndarray
    force: np.ndarray
    variances: Variances
    loss: float


@dataclass(frozen=True, eq=False)
class _Pass:
    """Quantities of a forward pass, by sample: gain, inverse covariance and value of innovations, predicted state."""

    gain: np.ndarray
    precision: np.ndarray
    innovation: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray


def filtered(linear: Linearised, columns: np.ndarray, variances: Variances) -> Filtered:
    """Whiten the residual of a hypothesis and columns.

    Args:
      linear: the linearised motion.
      columns: (S, K, 2 nv, C) responses to numbers.
      variances: of sensors and random force.
    """
    residual = linear.stretches.residual()
    inputs = np.concatenate([-linear.defect[..., None], columns], -1)
    gram, logs, _ = _forward(linear, inputs, residual, variances, keep=False)
    return Filtered(gram, logs, int(linear.stretches.seen.sum()) * residual.shape[1])


def smoothed(linear: Linearised, effect: np.ndarray, variances: Variances) -> Smoothed:
    """Smooth what is left beside the effect of fitted numbers, and update the variances.

    Args:
      linear: the linearised motion.
      effect: (S, K, 2 nv) response to the fitted numbers.
      variances: of sensors and random force.
    """
    residual = linear.stretches.residual()
    inputs = (effect - linear.defect)[..., None]
    gram, logs, kept = _forward(linear, inputs, residual, variances, keep=True)
    assert kept is not None
    return _backward(linear, kept, variances, float(gram.sum() + logs.sum()) + variances.penalty)


def _usual(linear: Linearised, variances: Variances) -> np.ndarray:
    """(S, K, nv) variances of the random force in each interval where its weight is 1."""
    return SPAN / linear.interval[..., None] * variances.force


def _fresh(linear: Linearised, variances: Variances) -> np.ndarray:
    """(S, K, nv) variances of the random force in each interval."""
    usual = _usual(linear, variances)
    if variances.weight is None:
        return usual
    return usual / variances.weight[:, np.arange(usual.shape[1]) // _lasting(linear)]


def _lasting(linear: Linearised) -> int:
    """Intervals of a block in which the weights of the force are the same."""
    return int(np.clip(round(LASTS / float(np.median(linear.interval))), 1, linear.interval.shape[1]))


def _weights(linear: Linearised, square: np.ndarray) -> np.ndarray:
    """(S, blocks, nv) from the expected square (S, K, nv) of the force, in units of its variance at weight 1."""
    first = np.arange(0, square.shape[1], _lasting(linear))
    count = np.diff([*first, square.shape[1]])[:, None]
    return (count + NU) / (NU + np.add.reduceat(square, first, axis=1))


def _sensor(linear: Linearised, variances: Variances) -> np.ndarray:
    """(S, K + 1, ny) variances of the measured coordinates."""
    seen = linear.stretches.seen
    return variances.sensor[seen] + variances.jitter * _rates(linear)[..., seen] ** 2


def _rates(linear: Linearised) -> np.ndarray:
    """(S, K + 1, 2 nv) rates of positions and velocities, which turn jitter into noise."""
    v, interval = linear.stretches.qvel, np.mean(linear.interval)
    rates = np.gradient(v, axis=1), np.gradient(linear.stretches.reported, axis=1)
    return np.concatenate([v, *(own / interval for own in rates)], -1)


def _start(linear: Linearised, variances: Variances) -> np.ndarray:
    """(nx,) variances of a starting state."""
    nv = len(variances.force)
    seen = linear.stretches.seen
    sigma = np.sqrt(variances.sensor[: 2 * nv])
    interval = float(np.mean(linear.interval))
    spread = linear.stretches.qvel.std((0, 1))
    of_v = np.maximum(np.where(seen[nv : 2 * nv], sigma[nv:], 0.0), np.minimum(sigma[:nv] / interval, spread + 1e-12))
    of_forces = linear.stretches.reported.var((0, 1)) + variances.sensor[2 * nv :]
    return np.concatenate([(_START * sigma[:nv]) ** 2, (_START * of_v) ** 2 + 1e-18, of_forces])


def _forward(
    linear: Linearised, inputs: np.ndarray, residual: np.ndarray, variances: Variances, keep: bool
) -> tuple[np.ndarray, np.ndarray, _Pass | None]:
    """Kalman filter. Inputs (S, K, 2 nv, C), whose first column belongs to the residual (S, K + 1, 2 nv)."""
    s, k, nx, _ = linear.force.shape
    c, seen = inputs.shape[-1], np.flatnonzero(linear.stretches.seen)
    sensor = _sensor(linear, variances)
    pushed = np.sqrt(_fresh(linear, variances))[..., None, :] * linear.force
    noise = pushed @ np.swapaxes(pushed, 2, 3)
    mean, cov = np.zeros((s, nx, c)), np.broadcast_to(np.diag(_start(linear, variances)), (s, nx, nx)).copy()
    gram, logs = np.zeros((s, c, c)), np.zeros(s)
    store: list[list[np.ndarray]] = [[] for _ in range(5)]
    eye = np.eye(len(seen))
    for t in range(k + 1):
        of_seen = cov[:, seen]
        inner = of_seen[:, :, seen] + sensor[:, t, :, None] * eye
        root = np.linalg.cholesky(inner)
        logs += 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(1)
        innovation = -mean[:, seen]
        innovation[..., 0] += residual[:, t, seen]
        inverse = np.linalg.inv(root)
        white, half = inverse @ innovation, inverse @ of_seen
        gram += np.swapaxes(white, 1, 2) @ white
        across = np.swapaxes(half, 1, 2)  # P C^T F^(-1/2)
        if keep:
            store[0].append(across @ inverse)  # gain
            store[1].append(np.swapaxes(inverse, 1, 2) @ inverse)
            store[2].append(innovation[..., 0])
            store[3].append(mean[..., 0])
            store[4].append(cov)
        mean = mean + across @ white
        cov = cov - across @ half
        if t < k:
            mean = linear.transition[:, t] @ mean + inputs[:, t]
            cov = linear.transition[:, t] @ cov @ np.swapaxes(linear.transition[:, t], 1, 2)
            cov = 0.5 * (cov + np.swapaxes(cov, 1, 2)) + noise[:, t]
    if not keep:
        return gram, logs, None
    gain, precision, innovations, means, covs = (np.stack(own, 1) for own in store)
    return gram, logs, _Pass(gain, precision, innovations, means, covs)


def _backward(linear: Linearised, kept: _Pass, variances: Variances, loss: float) -> Smoothed:
    """Disturbance smoother: scores of all variances, and smoothed states."""
    s, k, nx, nv = linear.force.shape
    seen = np.flatnonzero(linear.stretches.seen)
    fresh, usual = _fresh(linear, variances), _usual(linear, variances)
    rates = _rates(linear)[..., seen] ** 2
    score, information = np.zeros((s, nx)), np.zeros((s, nx, nx))
    state, force, spread = np.empty((s, k + 1, nx)), np.empty((s, k, nv)), np.empty((s, k, nv))
    push, push_n = np.zeros(nv), np.zeros(nv)
    noise, noise_n = np.zeros(len(seen)), np.zeros(len(seen))
    jitter, jitter_n = 0.0, 0.0
    for t in range(k, -1, -1):
        gain, precision, innovation = kept.gain[:, t], kept.precision[:, t], kept.innovation[:, t]
        if t < k:
            across = np.swapaxes(linear.force[:, t], 1, 2)
            felt = (across @ score[..., None])[..., 0]
            own = np.einsum("sij,sij->si", across @ information, across)
            push += (fresh[:, t] * felt**2).sum(0)
            push_n += (fresh[:, t] * own).sum(0)
            force[:, t] = fresh[:, t] * felt
            spread[:, t] = np.maximum(fresh[:, t] - fresh[:, t] ** 2 * own, 0.0)
            turn = np.swapaxes(linear.transition[:, t], 1, 2)
            score = (turn @ score[..., None])[..., 0]
            information = turn @ information @ linear.transition[:, t]
        weighted = (precision @ innovation[..., None])[..., 0]
        back = np.swapaxes(gain, 1, 2)
        error = weighted - (back @ score[..., None])[..., 0]
        known = np.diagonal(precision + back @ information @ gain, axis1=1, axis2=2)
        noise += (error**2).sum(0)
        noise_n += known.sum(0)
        jitter += float((rates[:, t] * error**2).sum())
        jitter_n += float((rates[:, t] * known).sum())
        # Through the update: r <- C^T u + r, N <- C^T F^-1 C + (I - K C)^T N (I - K C).
        score = score.copy()
        score[:, seen] += error
        keep = np.broadcast_to(np.eye(nx), (s, nx, nx)).copy()
        keep[:, :, seen] -= gain
        information = np.swapaxes(keep, 1, 2) @ information @ keep
        information[:, seen[:, None], seen] += precision
        state[:, t] = kept.mean[:, t] + (kept.covariance[:, t] @ score[..., None])[..., 0]
    new_sensor = variances.sensor.copy()
    new_sensor[seen] *= _ratio(noise, noise_n)
    new_sensor = np.maximum(new_sensor, linear.stretches.least**2)
    updated = replace(
        variances,
        sensor=new_sensor,
        jitter=variances.jitter * float(_ratio(np.array(jitter), np.array(jitter_n))),
        force=variances.force * _ratio(push, push_n),
        weight=_weights(linear, (force**2 + spread) / usual),
    )
    return Smoothed(state, force, updated, loss)


def _ratio(score: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Factor of a variance whose scores are these: the two are equal where the likelihood is largest."""
    return np.clip(score / np.maximum(information, 1e-300), 0.05, 20.0)
