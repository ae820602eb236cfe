"""Likelihood of recordings: a Kalman filter over linearised motion with noisy encoders and random forces.

State: error e of position and velocity (2 nv), and a random generalised force f (nv), a first-order Gauss-Markov
process with the variance q of every degree of freedom and one correlation time tau:

    e_(k+1) = A_k e_k + G_k f_k + S_k theta - d_k,      f_(k+1) = rho_k f_k + noise,      rho_k = exp(-h_k / tau)
    z_k = e_k + sensor noise of variance sigma^2 + (xdot sigma_t)^2

q -> 0 is output error (noise of the encoders only), sigma -> 0 equation error (inverse dynamics). sigma_t is the jitter
of time stamps. Innovations are linear in theta: all columns pass through the filter together, and what remains is least
squares. Variances are estimated with the disturbance smoother (Koopman and Shephard 1992; Durbin and Koopman 2012).
"""

from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.forces.motion import Linearised

NU = 3.0
"""Degrees of freedom of what is new in the random force, a Student distribution: gears stick, joints reverse, somebody
touches the robot."""

_START = 30.0
"""Standard deviation of a starting state, in units of the noise of its measurement (velocities: of their
difference quotient): wide, but not so that digits are lost."""

_QUIETEST = 0.1
"""Smallest noise of a sensor, in units of the first guess: no variance may vanish, since it could not grow again."""


@dataclass(frozen=True, eq=False)
class Variances:
    """Variances of all that is random.

    Attributes:
      sensor: (2 nv,) variance of position and velocity measurements.
      jitter: variance of time stamps [s^2].
      force: (nv,) variance of the random generalised force [N^2 or (N m)^2].
      time: its correlation time [s].
      weight: (S, K, nv) weights of what is new in the force, 1 where it is usual and less where it is not (heavy
        tails); None for 1.
    """

    sensor: np.ndarray
    jitter: float
    force: np.ndarray
    time: float
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
      force: (S, K + 1, nv) expected random force [N or N m].
      variances: updated.
      force_variance: (S, K + 1, nv) variance of what is known of the random force.
    """

    state: np.ndarray
    force: np.ndarray
    variances: Variances
    force_variance: np.ndarray


@dataclass(frozen=True, eq=False)
class _Pass:
    """Quantities of a forward pass, by sample: transition (K of them), gain, inverse covariance, predicted state."""

    transition: np.ndarray
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


def smoothed(linear: Linearised, effect: np.ndarray, variances: Variances, given_noise: bool = False) -> Smoothed:
    """Smooth what is left beside the effect of fitted numbers, and update the variances.

    Args:
      linear: the linearised motion.
      effect: (S, K, 2 nv) response to the fitted numbers.
      variances: of sensors and random force.
      given_noise: whether the noise of the sensors is known and stays.
    """
    residual = linear.stretches.residual()
    inputs = (effect - linear.defect)[..., None]
    _, _, kept = _forward(linear, inputs, residual, variances, keep=True)
    assert kept is not None
    return _backward(linear, kept, variances, given_noise)


def _parts(linear: Linearised, variances: Variances) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(S, K, nx, nx) transitions, (S, K, nv) variance of what is new in the force, (S, K + 1, ny) sensor variances."""
    s, k, two, nv = linear.force.shape
    rho = np.exp(-linear.interval / max(variances.time, 1e-6))
    transition = np.zeros((s, k, two + nv, two + nv))
    transition[..., :two, :two], transition[..., :two, two:] = linear.transition, linear.force
    transition[..., two:, two:] = rho[..., None, None] * np.eye(nv)
    fresh = (1 - rho**2)[..., None] * variances.force
    if variances.weight is not None:
        fresh = fresh / variances.weight
    return transition, fresh, _sensor(linear, variances)


def _sensor(linear: Linearised, variances: Variances) -> np.ndarray:
    """(S, K + 1, ny) variances of the measured coordinates."""
    seen = linear.stretches.seen
    return variances.sensor[seen] + variances.jitter * _rates(linear)[..., seen] ** 2


def _rates(linear: Linearised) -> np.ndarray:
    """(S, K + 1, 2 nv) rates of positions and velocities, which turn jitter into noise."""
    v = linear.stretches.qvel
    return np.concatenate([v, np.gradient(v, axis=1) / np.mean(linear.interval)], -1)


def _start(linear: Linearised, variances: Variances) -> np.ndarray:
    """(nx,) variances of a starting state."""
    nv = len(variances.force)
    seen = linear.stretches.seen
    sigma = np.sqrt(variances.sensor)
    interval = float(np.mean(linear.interval))
    spread = linear.stretches.qvel.std((0, 1))
    of_v = np.maximum(np.where(seen[nv:], sigma[nv:], 0.0), np.minimum(sigma[:nv] / interval, spread + 1e-12))
    return np.concatenate([(_START * sigma[:nv]) ** 2, (_START * of_v) ** 2 + 1e-18, variances.force])


def _forward(
    linear: Linearised, inputs: np.ndarray, residual: np.ndarray, variances: Variances, keep: bool
) -> tuple[np.ndarray, np.ndarray, _Pass | None]:
    """Kalman filter. Inputs (S, K, 2 nv, C), whose first column belongs to the residual (S, K + 1, 2 nv)."""
    s, k, two, nv = linear.force.shape
    nx, c, seen = two + nv, inputs.shape[-1], np.flatnonzero(linear.stretches.seen)
    transition, fresh, sensor = _parts(linear, variances)
    mean, cov = np.zeros((s, nx, c)), np.broadcast_to(np.diag(_start(linear, variances)), (s, nx, nx)).copy()
    gram, logs = np.zeros((s, c, c)), np.zeros(s)
    store: list[list[np.ndarray]] = [[] for _ in range(5)]
    index, eye = np.arange(nv) + two, np.eye(len(seen))
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
            mean = transition[:, t] @ mean
            mean[:, :two] += inputs[:, t]
            cov = transition[:, t] @ cov @ np.swapaxes(transition[:, t], 1, 2)
            cov = 0.5 * (cov + np.swapaxes(cov, 1, 2))
            cov[:, index, index] += fresh[:, t]
    if not keep:
        return gram, logs, None
    gain, precision, innovations, means, covs = (np.stack(own, 1) for own in store)
    return gram, logs, _Pass(transition, gain, precision, innovations, means, covs)


def _backward(linear: Linearised, kept: _Pass, variances: Variances, given_noise: bool) -> Smoothed:
    """Disturbance smoother: scores of all variances, and smoothed states."""
    s, k, two, nv = linear.force.shape
    nx, seen = two + nv, np.flatnonzero(linear.stretches.seen)
    _, fresh, _ = _parts(linear, variances)
    rates = _rates(linear)[..., seen] ** 2
    score, information = np.zeros((s, nx)), np.zeros((s, nx, nx))
    state, force, spread = np.empty((s, k + 1, two)), np.empty((s, k + 1, nv)), np.empty((s, k + 1, nv))
    push, push_n = np.zeros(nv), np.zeros(nv)
    noise, noise_n = np.zeros(len(seen)), np.zeros(len(seen))
    jitter, jitter_n = 0.0, 0.0
    weight = np.ones((s, k, nv))
    for t in range(k, -1, -1):
        gain, precision, innovation = kept.gain[:, t], kept.precision[:, t], kept.innovation[:, t]
        if t < k:
            own = np.diagonal(information, axis1=1, axis2=2)[:, two:]
            push += (fresh[:, t] * score[:, two:] ** 2).sum(0)
            push_n += (fresh[:, t] * own).sum(0)
            # The expected square of what is new, in units of its variance at weight 1.
            square = (fresh[:, t] * score[:, two:]) ** 2 + fresh[:, t] - fresh[:, t] ** 2 * own
            usual = (1 - np.exp(-2 * linear.interval[:, t] / variances.time))[:, None] * variances.force
            weight[:, t] = (1 + NU) / (NU + np.maximum(square, 0) / usual)
            turn = np.swapaxes(kept.transition[:, t], 1, 2)
            score = (turn @ score[..., None])[..., 0]
            information = turn @ information @ kept.transition[:, t]
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
        estimate = kept.mean[:, t] + (kept.covariance[:, t] @ score[..., None])[..., 0]
        state[:, t], force[:, t] = estimate[:, :two], estimate[:, two:]
        rows = kept.covariance[:, t, two:]
        spread[:, t] = np.diagonal(kept.covariance[:, t], axis1=1, axis2=2)[:, two:] - np.einsum(
            "sij,sjk,sik->si", rows, information, rows
        )
    push += (variances.force * score[:, two:] ** 2).sum(0)
    push_n += variances.force * np.diagonal(information, axis1=1, axis2=2)[:, two:].sum(0)
    new_sensor = variances.sensor.copy()
    if not given_noise:
        new_sensor[seen] *= _ratio(noise, noise_n)
        new_sensor = np.maximum(new_sensor, (_QUIETEST * linear.stretches.sigma) ** 2)
    updated = replace(
        variances,
        sensor=new_sensor,
        jitter=variances.jitter * float(_ratio(np.array(jitter), np.array(jitter_n))),
        force=variances.force * _ratio(push, push_n),
        weight=weight,
    )
    return Smoothed(state, force, updated, np.maximum(spread, 0.0))


def _ratio(score: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Factor of a variance whose scores are these: the two are equal where the likelihood is largest."""
    return np.clip(score / np.maximum(information, 1e-300), 0.05, 20.0)
