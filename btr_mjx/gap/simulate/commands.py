"""Commands of a recording as functions of time, with exact delays and first-order lags.

A command is a piecewise polynomial, one column per control. Its response to a first-order lag T dy/dt = u - y is a
polynomial plus an exponential on each piece, so that delays and lags have no discretisation error.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import scipy
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Interpolation
from btr_mjx.gap.simulate.rate_limit import rate_limited

_WITHOUT_FILTER = int(mujoco.mjtDyn.mjDYN_NONE), int(mujoco.mjtDyn.mjDYN_PID)
"""Kinds of actuators whose force depends on the command itself."""


@dataclass(frozen=True)
class Command:
    """A sampled command as a function of time; constant before the first and after the last sample.

    Attributes:
      times: (K,) ascending [s].
      values: (K, nu) in the units of the controls.
      interpolation: "hold" (zero-order hold), "linear" or "cubic" (spline).
      delay: (nu,) delay of each control [s]; negative values advance it.
      lags: time constants (nu,) [s] of first-order lags in series; 0 is no lag.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: Interpolation = "linear"
    delay: np.ndarray | None = None
    lags: tuple[np.ndarray, ...] = ()

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.times.shape != (len(self.values),) or not len(self.times):
            raise InputError(
                f"command: got times {self.times.shape} and values {self.values.shape}, expected (K,) and (K, nu)"
            )
        if self.interpolation not in ("hold", "linear", "cubic"):
            raise InputError(f"interpolation: got {self.interpolation!r}, expected 'hold', 'linear' or 'cubic'")

    @property
    def n(self) -> int:
        """Number of controls."""
        return self.values.shape[1]

    def shifted(self, delay: ArrayLike) -> "Command":
        """The command delayed by `delay` [s], a number or (nu,)."""
        return self._with(delay=self._delay + np.asarray(delay, float))

    def filtered(self, time_constant: ArrayLike) -> "Command":
        """The command after a first-order lag, T dy/dt = u - y, at rest before the first sample.

        Args:
          time_constant: T [s], a number or (nu,); 0 leaves a control unchanged.

        Raises:
          InputError: a negative time constant.
        """
        constant = np.broadcast_to(np.asarray(time_constant, float), (self.n,))
        if (constant < 0).any():
            raise InputError(f"time constant of a lag: got {constant.min()} s, expected 0 or more")
        return self._with(lags=(*self.lags, constant))

    def rate_limited(self, rate: ArrayLike) -> "Command":
        """The command behind a limit of its rate, before delays and lags.

        Args:
          rate: largest rate [units of the control per s], a number or (nu,); inf leaves a control unchanged.

        Raises:
          InputError: a rate that is not positive.
        """
        rate = np.broadcast_to(np.asarray(rate, float), (self.n,))
        if not (rate > 0).all():
            raise InputError(f"rate limit: got {rate.min()}, expected more than 0")
        times, polynomial = rate_limited(self.times, self._polynomial, rate)
        if times is self.times:
            return self
        other = replace(self, times=times, values=polynomial[0])
        other.__dict__["_polynomial"] = polynomial
        return other

    def at(self, times: ArrayLike) -> np.ndarray:
        """Values (..., nu) at times (...) [s]."""
        return self._delayed(times, self._evaluate)

    def over_step(self, times: ArrayLike, length: float, phase: ArrayLike = 0.0) -> np.ndarray:
        """Control of simulation steps: the value within a step, or the mean over it for a held command.

        A held command jumps, also inside a step, and its mean keeps the time of the jump.

        Args:
          times: (...) starts of the steps [s].
          length: of a step [s].
          phase: of the value, as a fraction of the step, a number or (nu,); see `command_phase`. Not for held commands.

        Returns:
          (..., nu) controls.
        """
        if self.interpolation != "hold":
            phase = np.asarray(phase, float)
            return (self.shifted(-length * phase) if phase.any() else self).at(times)

        def mean(begin: np.ndarray, columns: np.ndarray) -> np.ndarray:
            return (self._integral(begin + length, columns) - self._integral(begin, columns)) / length

        return self._delayed(times, mean)

    def _delayed(self, times: ArrayLike, of: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """What a function gives (N, columns) at times (N,) of the undelayed command, at times (...): (..., nu)."""
        times, delays = np.asarray(times, float), self._delay
        flat, out = times.reshape(-1), np.empty((times.size, self.n))
        for delay in np.unique(delays):
            columns = np.flatnonzero(delays == delay)
            out[:, columns] = of(flat - delay, columns)
        return out.reshape(*times.shape, self.n)

    def _integral(self, times: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Integral (N, columns) of the undelayed command from its first sample to times (N,)."""
        polynomial, exponentials = self._solution
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 1)
        since = times - self.times[piece]
        found = self._whole[piece] + _piecewise(polynomial, exponentials, piece, np.maximum(since, 0.0)[:, None])
        early = np.minimum(since, 0.0)[:, None]  # constant before the first sample
        return (found + early * self._evaluate(self.times[:1], np.arange(self.n)))[:, columns]

    @cached_property
    def _whole(self) -> np.ndarray:
        """(K, nu) integral from the first sample to the start of each piece."""
        polynomial, exponentials = self._solution
        each = _piecewise(polynomial, exponentials, np.arange(len(self.times) - 1), np.diff(self.times)[:, None])
        return np.concatenate([np.zeros((1, self.n)), np.cumsum(each, axis=0)])

    def _with(self, **changes: Any) -> "Command":
        """A changed copy that shares the cached coefficients that are still valid."""
        other = replace(self, **changes)
        other.__dict__["_polynomial"] = self._polynomial
        if other.lags is self.lags:
            other.__dict__["_solution"] = self._solution
        return other

    @property
    def _delay(self) -> np.ndarray:
        return np.zeros(self.n) if self.delay is None else np.broadcast_to(self.delay, (self.n,))

    def _evaluate(self, times: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Values (N, columns) of the undelayed command at times (N,)."""
        polynomial, exponentials = self._solution
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 1)
        since = np.maximum(times - self.times[piece], 0.0)[:, None]
        out = _horner(polynomial[:, piece] if len(columns) == self.n else polynomial[:, piece[:, None], columns], since)
        for weight, constant in exponentials:
            slow = columns[constant[columns] > 0]
            out[:, constant[columns] > 0] += weight[piece[:, None], slow] * np.exp(-since / constant[slow])
        return out

    @cached_property
    def _polynomial(self) -> np.ndarray:
        """Coefficients (order, K, nu) of each piece before any lag."""
        return _polynomial(self.times, self.values, self.interpolation)

    @cached_property
    def _solution(self) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
        """Coefficients (order, K, nu) in the time since the start of a piece, and (weights (K, nu), time constants)."""
        polynomial = self._polynomial
        exponentials: list[tuple[np.ndarray, np.ndarray]] = []
        for constant in self.lags:
            polynomial, exponentials = _lagged(self.times, polynomial, exponentials, constant)
        return polynomial, exponentials


def command_phase(model: mujoco.MjModel) -> np.ndarray:
    """When within a step MuJoCo's integrators need the value of a command, as a fraction of the step.

    Semi-implicit Euler, q_{k+1} - 2 q_k + q_{k-1} = h^2 a(q_k, u_k), is of second order in the positions with u_k at
    the start of the step; a later value would be early. Runge-Kutta holds u_k over the whole step, and so does the
    state of a filter or an integrator between two steps: there the middle is of second order.

    Args:
      model: the model.

    Returns:
      (nu,) 0 or 0.5.
    """
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return np.full(model.nu, 0.5)
    phase = np.zeros(model.nu)
    for actuator, first in enumerate(model.actuator_ctrladr):
        if int(model.actuator_dyntype[actuator]) not in _WITHOUT_FILTER:
            phase[first : first + model.actuator_ctrlnum[actuator]] = 0.5
    return phase


def _polynomial(times: np.ndarray, values: np.ndarray, interpolation: Interpolation) -> np.ndarray:
    """(order, K, nu) coefficients, lowest first; the last piece is constant."""
    if interpolation == "hold" or len(times) == 1:
        return values[None].astype(float)
    if interpolation == "linear" or len(times) < 4:
        slope = np.zeros_like(values, float)
        slope[:-1] = np.diff(values, axis=0) / np.diff(times)[:, None]
        return np.stack([values.astype(float), slope])
    spline = scipy.interpolate.CubicSpline(times, values, axis=0).c[::-1]
    return np.concatenate([spline, np.stack([values[-1], *np.zeros((3, values.shape[1]))])[:, None]], axis=1)


def _lagged(
    times: np.ndarray,
    polynomial: np.ndarray,
    exponentials: list[tuple[np.ndarray, np.ndarray]],
    constant: np.ndarray,
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """The exact response of T dy/dt = u - y, in steady state at the first value."""
    order, count, n = polynomial.shape
    # Equal time constants in series would need terms t exp(-t / T); a relative shift of 1e-4 avoids them.
    for _, other in exponentials:
        resonant = (constant > 0) & np.isclose(constant, other, rtol=9e-5, atol=0)
        constant = np.where(resonant, other * (1 + 1e-4), constant)
    response, derivative, sign = np.zeros_like(polynomial), polynomial, np.ones(n)
    for _ in range(order):
        response = response + sign * derivative
        powers = np.arange(1, order)[:, None, None]
        derivative = np.concatenate([powers * derivative[1:], np.zeros((1, count, n))]) if order > 1 else derivative * 0
        sign = -sign * constant
    carried = []
    for weight, other in exponentials:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(other > 0, 1.0 / (1.0 - constant / np.where(other > 0, other, 1.0)), 0.0)
        carried.append((weight * ratio, other))
    # Weight of the exponential of a piece: w_{k+1} = y_k(end) - particular_{k+1}(0).
    slow = constant > 0
    length = np.diff(times)[:, None]
    end = _horner(response[:, :-1], length)
    begin = response[0].copy()
    for weight, other in carried:
        decayed = np.exp(-length / np.where(other > 0, other, 1.0))
        end = end + weight[:-1] * np.where(other > 0, decayed, 0.0)
        begin = begin + weight
    start = polynomial[0, 0] + sum((weight[0] for weight, _ in exponentials), np.zeros(n))
    drive = np.empty((count, n))
    drive[0] = start - begin[0]
    drive[1:] = end - begin[1:]
    decay = np.zeros((count, n))
    decay[1:] = np.exp(-length / np.where(slow, constant, 1.0))
    weight = np.where(slow, _recurrence(decay, drive), 0.0)
    return response, [*carried, (weight, constant)]


def _piecewise(
    polynomial: np.ndarray, exponentials: list[tuple[np.ndarray, np.ndarray]], piece: np.ndarray, since: np.ndarray
) -> np.ndarray:
    """Integrals (N, nu) over pieces (N,) from their starts to times (N, 1) after the start."""
    powers = np.arange(1, len(polynomial) + 1)[:, None, None]
    out = since * _horner((polynomial / powers)[:, piece], since)
    for weight, constant in exponentials:
        slow = np.where(constant > 0, constant, 1.0)
        out = out + np.where(constant > 0, weight[piece] * slow * -np.expm1(-since / slow), 0.0)
    return out


def _horner(coefficients: np.ndarray, x: np.ndarray) -> np.ndarray:
    out = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        out = out * x + coefficient
    return out


def _recurrence(decay: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """w_k = decay_k w_{k-1} + drive_k along the first axis, in log2(K) vectorised passes."""
    decay, drive, shift = decay.copy(), drive.copy(), 1
    while shift < len(drive):
        drive[shift:] += decay[shift:] * drive[:-shift]
        decay[shift:] *= decay[:-shift]
        shift *= 2
    return drive
