"""Motion from one sample to the next, linearised around smoothed states, by simulations of single intervals.

With the state x_k = x^_k + e_k around a reference x^_k, the step map f_k of a hypothesis and a random force w_k,

    e_(k+1) = A_k e_k + S_k theta - d_k + G_k w_k,      d_k = x^_(k+1) - f_k(x^_k).

All simulations last one interval and start at measured states, so that none can diverge, however wrong the model.
Forces y_k that drives report are further coordinates, g_k = C_k e_k + D_k theta + F(x^_k) - y_k of the state at the
same time, see `reported`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import scipy

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.forces.reported import force_slopes, reported_forces
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import Counter, accelerations, simulate
from btr_mjx.gap.windows import MakeWorld
from btr_mjx.models import between, difference, integrate


@dataclass(frozen=True)
class FreeNumber:
    """One free number of a hypothesis: where its derivative is taken.

    Attributes:
      candidate: the effect that it belongs to.
      index: of the parameter.
      at: values (p,) of the effect at which the derivative is taken; its null for an effect that is not yet there.
      step: of the difference quotient.
    """

    candidate: Candidate
    index: int
    at: tuple[float, ...]
    step: float


@dataclass(frozen=True, eq=False)
class Linearised:
    """S stretches of K intervals, linearised around a hypothesis: nx coordinates, 2 nv and those of reported forces.

    Attributes:
      stretches: with the states around which they are linearised.
      defect: (S, K, nx) d_k.
      transition: (S, K, nx, nx) A_k.
      inertia: (S, K, nv, nv) mass matrices at the starts of the intervals.
      force: (S, K, nx, nv) G_k, the response to a constant generalised force.
      slope: (S, K, nx - 2 nv, 2 nv) C_k, of reported forces at the ends of the intervals.
      interval: (S, K) lengths [s].
    """

    stretches: Stretches
    defect: np.ndarray
    transition: np.ndarray
    inertia: np.ndarray
    force: np.ndarray
    slope: np.ndarray
    interval: np.ndarray

    def responses(self, pushes: np.ndarray) -> np.ndarray:
        """(S, K, nx, C) responses of the state to `pushes` (S, K, nv + m, C)."""
        nv = self.force.shape[-1]
        out = self.force @ pushes[..., :nv, :]
        out[..., 2 * nv :, :] += pushes[..., nv:, :]
        return out


def linearise_motion(
    stretches: Stretches, make: MakeWorld, counter: Counter | None = None, known: Linearised | None = None
) -> Linearised:
    """Linearise a hypothesis.

    Args:
      stretches: where.
      make: the hypothesis.
      counter: adds up the simulated steps.
      known: a linearisation whose derivatives are kept; None to compute them.
    """
    interval = np.diff(stretches.time, axis=1)
    model = stretches.data.recordings[0].model
    nv = model.nv
    target = np.concatenate([stretches.qpos[:, 1:], stretches.qvel[:, 1:]], -1)
    defect = np.nan_to_num(_minus(model, target, _extrapolated(stretches, make, counter)))
    shifts = _shifts(stretches)
    slope = force_slopes(stretches, make, shifts, counter) if known is None else known.slope
    (reported,) = reported_forces(stretches, [make], counter)
    defect = np.concatenate([defect, (slope @ defect[..., None])[..., 0] + stretches.reported[:, 1:] - reported], -1)
    if known is not None:
        return replace(known, stretches=stretches, defect=defect)
    transition, reach = _flow(_slopes_of_motion(stretches, make, shifts, counter), interval)
    inertia = _inertia(stretches, make)
    force = reach @ np.linalg.inv(inertia)
    unused = np.zeros((*interval.shape, 2 * nv + slope.shape[-2], slope.shape[-2]))
    transition = np.concatenate([np.concatenate([transition, slope @ transition], -2), unused], -1)
    force = np.concatenate([force, slope @ force], -2)
    return Linearised(stretches, defect, transition, inertia, force, slope, interval)


def _slopes_of_motion(stretches: Stretches, make: MakeWorld, shifts: np.ndarray, counter: Counter | None) -> np.ndarray:
    """(S, K, 2 nv, 2 nv) Jacobian of the continuous motion, d (v, a) / d (q, v), in the middle of the intervals."""
    qpos, qvel = _middles(stretches)
    model, nv = stretches.data.recordings[0].model, qvel.shape[-1]
    out = np.zeros((*qpos.shape[:2], 2 * nv, 2 * nv))
    out[..., :nv, nv:] = np.eye(nv)
    (usual,) = accelerations_at(stretches, [make], (qpos, qvel), counter)
    # Either side in turn, so that what is not smooth is met on both.
    sign = np.where(np.arange(qpos.shape[1]) % 2, -1.0, 1.0)[:, None]
    for i, size in enumerate(shifts):
        moved = np.zeros((*qpos.shape[:2], 2 * nv))
        moved[..., i] = (sign * size)[..., 0]
        states = integrate(model, qpos, moved[..., :nv]), qvel + moved[..., nv:]
        (found,) = accelerations_at(stretches, [make], states, counter)
        out[..., nv:, i] = (found - usual) / (sign * size)
    return np.nan_to_num(out)


def _flow(slopes: np.ndarray, interval: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What becomes of a change of the state, and of a constant acceleration, until the end of an interval.

    Exact for motion whose Jacobian is constant, however stiff: with B = (0, I), exp(A T) and the integral of
    exp(A t) B over T are blocks of one matrix exponential (Van Loan, 1978).

    Args:
      slopes: (S, K, 2 nv, 2 nv) Jacobian A of the continuous motion.
      interval: (S, K) lengths T [s].

    Returns:
      (S, K, 2 nv, 2 nv) and (S, K, 2 nv, nv).
    """
    n = slopes.shape[-1]
    both = np.zeros((*interval.shape, n + n // 2, n + n // 2))
    both[..., :n, :n] = slopes
    both[..., n // 2 : n, n:] = np.eye(n // 2)
    found = scipy.linalg.expm(both * interval[..., None, None])
    return found[..., :n, :n], found[..., :n, n:]


def _middles(stretches: Stretches) -> tuple[np.ndarray, np.ndarray]:
    """States in the middle of the intervals, between the references at both ends: (S, K, nq) and (S, K, nv)."""
    model = stretches.data.recordings[0].model
    both = [
        x.reshape(-1, x.shape[-1])
        for s in (slice(-1), slice(1, None))
        for x in (stretches.qpos[:, s], stretches.qvel[:, s])
    ]
    interval = np.diff(stretches.time, axis=1).reshape(-1, 1)
    half = np.full(len(interval), 0.5)
    qpos, qvel = between(model, (both[0], both[1]), (both[2], both[3]), half, interval)
    shape = len(stretches), stretches.intervals, -1
    return qpos.reshape(shape), qvel.reshape(shape)


def accelerations_at(
    stretches: Stretches,
    makes: Sequence[MakeWorld],
    states: tuple[np.ndarray, np.ndarray],
    counter: Counter | None = None,
) -> list[np.ndarray]:
    """Accelerations (S, K, nv) of hypotheses at states, with the mean commands of the intervals.

    Args:
      stretches: whose intervals.
      makes: the hypotheses.
      states: qpos (S, K, nq) and qvel (S, K, nv).
      counter: adds up the evaluations.
    """
    interval = np.diff(stretches.time, axis=1)
    out = [np.empty(states[1].shape) for _ in makes]
    for own, model, segments in stretches.segments(slice(-1), *states, interval):
        found = accelerations([(make(model), segments) for make in makes], float(np.median(interval[own])), counter)
        for own_rates, target in zip(found, out, strict=True):
            target[own] = own_rates.reshape(len(own), stretches.intervals, -1)
    return out


def pushes(
    linear: Linearised, base: Hypothesis, numbers: Sequence[FreeNumber], counter: Counter | None = None
) -> np.ndarray:
    """Generalised forces with which a unit of each number pushes a hypothesis, and what drives report of it.

    An effect changes the acceleration in the middle of an interval, which stands for the whole of it. As forces these
    changes hardly depend on what moves: where another rotor or servo is found, `Linearised.responses` changes with it.

    Args:
      linear: of the hypothesis.
      base: the hypothesis without the effects of `numbers`.
      numbers: the numbers.
      counter: adds up the evaluations.

    Returns:
      (S, K, nv + m, C).
    """
    makes: list[MakeWorld] = []
    where: dict[tuple, int] = {}
    stretches, inertia = linear.stretches, linear.inertia

    def place(candidate: Candidate, values: tuple[float, ...]) -> int:
        plain = bool(np.all(np.array(values) == candidate.null)) and not any(p.shape for p in candidate.parameters)
        key = ("base",) if plain else (candidate.name, values)
        if key not in where:
            where[key] = len(makes)
            makes.append(base if plain else base.with_effect(candidate, values))
        return where[key]

    pairs = []
    for number in numbers:
        moved = list(number.at)
        moved[number.index] += number.step
        pairs.append((place(number.candidate, number.at), place(number.candidate, tuple(moved))))
    found = accelerations_at(stretches, makes, _middles(stretches), counter)
    forces = reported_forces(stretches, makes, counter)
    out = np.empty((*linear.interval.shape, inertia.shape[-1] + linear.slope.shape[-2], len(numbers)))
    for c, ((a, b), number) in enumerate(zip(pairs, numbers, strict=True)):
        of_motion = (inertia @ np.nan_to_num(found[b] - found[a])[..., None])[..., 0]
        out[..., c] = np.concatenate([of_motion, forces[b] - forces[a]], -1) / number.step
    return out


def ends(
    stretches: Stretches,
    makes: Sequence[MakeWorld],
    start: tuple[np.ndarray, np.ndarray] | None = None,
    counter: Counter | None = None,
    factor: float = 1.0,
) -> list[np.ndarray]:
    """States (S, K, nq + nv) of hypotheses at the ends of all intervals, each from the reference at its start.

    Args:
      stretches: where.
      makes: the hypotheses.
      start: other starting states, qpos (S, K, nq) and qvel (S, K, nv).
      counter: adds up the simulated steps.
      factor: time steps in units of those of the model.
    """
    qpos, qvel = start or (stretches.qpos[:, :-1], stretches.qvel[:, :-1])
    shape = qpos.shape[:2]
    interval = np.diff(stretches.time, axis=1)
    out = [np.empty((*shape, qpos.shape[-1] + qvel.shape[-1])) for _ in makes]
    for own, model, segments in stretches.segments(slice(-1), qpos, qvel, interval):
        step = time_step(model, interval[own], factor)
        found = simulate([(make(model), segments) for make in makes], timestep=step, threads=1, counter=counter)
        for states, target in zip(found, out, strict=True):
            target[own] = states[:, 0].reshape(len(own), shape[1], -1)
    return out


def _extrapolated(stretches: Stretches, make: MakeWorld, counter: Counter | None) -> np.ndarray:
    """States (S, K, nq + nv) at the ends of intervals, extrapolated to vanishing time steps.

    Semi-implicit Euler damps a stiff servo k by k h / 2 too little, and its velocities are those of half a step before.
    Both errors are of first order in the step h: 2 f(h / 2) - f(h) has neither (Richardson).
    """
    model = stretches.data.recordings[0].model
    whole, half = (ends(stretches, [make], counter=counter, factor=factor)[0] for factor in (1.0, 0.5))
    more = _minus(model, half, whole)
    more = np.where(np.isfinite(more), more, 0.0)
    position = integrate(model, half[..., : model.nq], more[..., : model.nv])
    return np.concatenate([position, half[..., model.nq :] + more[..., model.nv :]], -1)


def time_step(model: mujoco.MjModel, interval: np.ndarray, factor: float = 1.0) -> float:
    """The longest time step that divides the usual interval and is no longer than that of the model, times a factor.

    Half a step is exactly that, as extrapolation needs it.
    """
    usual = float(np.median(interval))
    return factor * usual / max(1, math.ceil(usual / float(model.opt.timestep) - 1e-3))


def _minus(model: mujoco.MjModel, states: np.ndarray, other: np.ndarray) -> np.ndarray:
    """States minus others (..., 2 nv), both (..., nq + nv)."""
    nq = model.nq
    position = difference(model, other[..., :nq], states[..., :nq])
    return np.concatenate([position, states[..., nq:] - other[..., nq:]], -1)


def _shifts(stretches: Stretches) -> np.ndarray:
    """(2 nv,) perturbations of the state: small beside the motion, no smaller than what is known of the state."""
    model = stretches.data.recordings[0].model
    nv = model.nv
    size_q = difference(model, stretches.qpos[:, :1], stretches.qpos).std((0, 1))
    size_v = stretches.qvel.std((0, 1))
    interval = float(np.median(np.diff(stretches.time, axis=1)))
    low_q, low_v = 1e-4 * size_q + 1e-9, 5e-2 * size_v + 1e-9
    known_q = stretches.sigma[:nv]
    return np.concatenate([np.maximum(low_q, known_q), np.maximum(low_v, np.minimum(known_q / interval, 0.1 * size_v))])


def _inertia(stretches: Stretches, make: MakeWorld) -> np.ndarray:
    """(S, K, nv, nv) mass matrices at the starts of the intervals."""
    count, nv = stretches.intervals, stretches.qvel.shape[-1]
    out = np.empty((len(stretches), count, nv, nv))
    for s, r in enumerate(stretches.recording):
        model = make(stretches.data.recordings[r].model).update_constants()
        data, full = mujoco.MjData(model), np.zeros((nv, nv))
        for k in range(count):
            data.qpos[:] = stretches.qpos[s, k]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fullM(model, data, full)
            out[s, k] = full
    return out
