"""What trials tell of the unknown numbers: Fisher information of fitness, intervals, what is told of combinations.

In the best simulation s, N measured values of fitness leave residuals r, whose slopes J (N, p) along the unknown
numbers are found by finite differences. With each number's range as a prior of the same variance P^-1, the linear
picture gives

    covariance C = (J'J / v + P)^-1        estimate = s - C (J'r / v + P (s - middle))

with the variance v of a value: that of repeated measurements, that by which fitness differs from a parabola, and N
times that of the residuals where these are larger than noise: trials of similar controllers share what the simulator
lacks, and many of them tell no more of the numbers than one. What a slope owes to roughness is taken from
J'J. A difference is as wide as the interval that it gives: motion with contacts has rough fitness, whose slope
at a point says nothing of a simulation that is a tenth of the range away.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy

from btr_mjx.backtoreality.run_state import Problem, Trials
from btr_mjx.backtoreality.simulation_search import compared_fitness, counting_trials

SLOPE_STEPS = (0.3, 0.15, 0.075)
"""Steps of finite differences, as shares of a number's range; each also takes the values at half of it. With the widest
alone, or a narrower one, fewer true numbers are within their intervals (`benchmarks/told_numbers.py`)."""

LEVEL = 0.9
"""Probability of an interval."""

TOLD = 0.5
"""Part of its range that the interval of a number that is told does not exceed."""

_MIRRORED = 1.5
"""Where a step would leave the range, it goes so many times as far to the other side."""

_CHANCE = 0.05
"""Probability with which known noise leaves residuals that count as more than noise."""

_INVOLVED = 0.1
"""Least part of a number in a direction, squared, that is said."""

PLANNED_SCATTER = 0.05
"""Scatter of measurements that is assumed before any, as a part of the planned controllers' fitness."""

_PRIOR = 12.0
"""One over the variance of a number that may be anywhere in its range."""

_QUANTILE = NormalDist().inv_cdf((1 + LEVEL) / 2)
"""Half the width of an interval, in standard errors."""

_BEST_FIRST = 2
"""Trials that are the best controllers' in any case."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """Fitness of trials around a simulation, with p unknown numbers in units of their ranges.

    Attributes:
      values: (N,) fitness in the simulation.
      slopes: (S, N, p) derivatives, by steps of S sizes.
      rough: (S, p) mean square difference of fitness from the parabola behind a slope.
      gain: (S, p) variance of a slope, in units of `rough`.
    """

    values: np.ndarray
    slopes: np.ndarray
    rough: np.ndarray
    gain: np.ndarray

    def weighted(self, weight: np.ndarray) -> "Slopes":
        """The same in other units: values times a weight (N,)."""
        rough = self.rough * np.mean(weight**2)
        return Slopes(self.values * weight, self.slopes * weight[:, None], rough, self.gain)


@dataclass(frozen=True, eq=False)
class Told:
    """What trials tell of p numbers, in units of their ranges.

    Attributes:
      at: (p,) the simulation's numbers.
      estimate: (p,) those that the linear picture prefers, within the ranges.
      covariance: (p, p) of their errors.
    """

    at: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """(p,) half the widths of the intervals around the estimates."""
        return _QUANTILE * np.sqrt(np.diag(self.covariance))

    @property
    def interval(self) -> np.ndarray:
        """(2, p) low and high ends, with the simulation's numbers within; of what is not told, those of the range."""
        low, high = self._ends
        return np.where(self.told, [np.maximum(low, 0.0), np.minimum(high, 1.0)], [[0.0], [1.0]])

    @property
    def told(self) -> np.ndarray:
        """(p,) bool: numbers whose interval is a part of their range only."""
        return np.ptp(self._ends, axis=0) <= TOLD

    @property
    def _ends(self) -> np.ndarray:
        low, high = self.estimate - self.reach, self.estimate + self.reach
        return np.array([np.minimum(low, self.at), np.maximum(high, self.at)])

    def possible(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, p) random numbers that trials leave possible, within the ranges."""
        return np.clip(rng.multivariate_normal(self.estimate, self.covariance, count), 0.0, 1.0)

    def combinations(self) -> dict[tuple[int, ...], list[np.ndarray]]:
        """Numbers that are not told each by itself -> their shares in directions that are told."""
        variance, directions = np.linalg.eigh(self.covariance)
        found: dict[tuple[int, ...], list[np.ndarray]] = {}
        for size, direction in zip(variance, directions.T, strict=True):
            own = np.flatnonzero((direction**2 >= _INVOLVED) & ~self.told)
            if 2 * _QUANTILE * np.sqrt(size) <= TOLD and len(own) > 1:
                found.setdefault(tuple(own.tolist()), []).append(direction[own])
        return found


def fitness_slopes(problem: Problem, simulation: np.ndarray, controllers: np.ndarray) -> Slopes:
    """Fitness that step 3 compares, of controllers (M, n_c) in a simulation (n_s,), and its slopes.

    One batch of `slope_simulations` simulations. N is M times the marks; values of controllers that diverged are NaN.
    """
    box, at = problem.simulation_box, shares_of(problem, simulation)
    own = simulation[problem.robot.simulation_box.indices(problem.unknown)]
    sizes = np.array([*SLOPE_STEPS, SLOPE_STEPS[-1] / 2])
    offsets = np.concatenate([-sizes, sizes])[:, None]
    outside = np.abs(at + offsets - 0.5) > 0.5
    places = at + np.where(outside, -_MIRRORED * offsets, offsets)
    rows = np.tile(own, (box.n, len(places), 1))
    for i in range(box.n):
        rows[i, :, i] = np.clip(box.low[i] + box.span[i] * places[:, i], box.low[i], box.high[i])
    members = problem.embed(np.concatenate([own[None], rows.reshape(-1, box.n)]))
    found = compared_fitness(problem, members, controllers).reshape(len(members), -1)
    centre, beside = found[0], found[1:].reshape(box.n, len(places), -1)
    slopes = np.empty((len(SLOPE_STEPS), len(centre), box.n))
    rough, gain = np.empty((2, len(SLOPE_STEPS), box.n))
    for size in range(len(SLOPE_STEPS)):
        pick = [size, size + 1, size + len(sizes), size + 1 + len(sizes)]
        for i in range(box.n):
            powers = np.vander(np.append(0.0, places[pick, i] - at[i]), 3, increasing=True)
            fit, values = np.linalg.pinv(powers), np.concatenate([centre[None], beside[i, pick]])
            left = values - powers @ (fit @ values)
            slopes[size, :, i] = fit[1] @ values
            squares = (left**2).sum(0) / (len(powers) - powers.shape[1])
            rough[size, i] = np.mean(squares, where=np.isfinite(squares)) if np.isfinite(squares).any() else 0.0
            gain[size, i] = (fit[1] ** 2).sum()
    return Slopes(centre, slopes, rough, gain)


def slope_simulations(problem: Problem) -> int:
    """Simulations behind the slopes."""
    return 2 * (len(SLOPE_STEPS) + 1) * len(problem.unknown) + 1


def told_by(slopes: Slopes, residual: np.ndarray, at: np.ndarray, noise: float = 0.0) -> Told:
    """Estimates of numbers and their errors.

    Args:
      slopes: of N values.
      residual: (N,) simulated less measured values; those that are NaN, or whose slopes are, do not count.
      at: (p,) the simulation's numbers, as shares of their ranges.
      noise: known standard deviation of a measured value.

    Returns:
      What is told, in units of the ranges.
    """
    good = np.isfinite(residual) & np.isfinite(slopes.slopes).all(axis=(0, 2))
    residual, jacobians = residual[good], slopes.slopes[:, good]
    count, p = len(residual), len(at)
    square = float(residual @ residual)
    more = square > noise**2 * scipy.stats.chi2.isf(_CHANCE, max(count, 1))
    # The fit hides a part of what the simulator lacks.
    shared = max(square - count * noise**2, 0.0) * count / max(count - p, 1) if more else 0.0
    least = np.finfo(float).eps * float(np.mean(slopes.values[good] ** 2)) if count else 1.0
    size, numbers = np.zeros(p, int), np.arange(p)
    while True:
        jacobian, rough = jacobians[size, :, numbers].T, slopes.rough[size, numbers]
        variance = max(noise**2 + shared + float(np.mean(rough)), least)
        by_roughness = np.diag(count * rough * slopes.gain[size, numbers])
        squares, axes = np.linalg.eigh(jacobian.T @ jacobian - by_roughness)
        covariance = (axes / (np.maximum(squares, 0.0) / variance + _PRIOR)) @ axes.T
        estimate = at - covariance @ (jacobian.T @ residual / variance + _PRIOR * (at - 0.5))
        told = Told(at, np.clip(estimate, 0.0, 1.0), covariance)
        smaller = (told.reach < np.array(SLOPE_STEPS)[size] / 2) & (size < len(SLOPE_STEPS) - 1)
        if not smaller.any():
            return told
        size = size + smaller


def told_by_trials(problem: Problem, simulation: np.ndarray, trials: Trials, iteration: int) -> Told:
    """What the trials that step 3 compared tell of the unknown numbers, beside the simulation (n_s,) that it found."""
    use = counting_trials(problem, trials, iteration)
    slopes = fitness_slopes(problem, simulation, trials.controllers[use])
    known = 0.0
    if problem.settings.compared == "fitness":
        real, scale, noise = trials.f_r[use][:, None], np.ones(1), getattr(problem.reality, "noise", np.nan)
        if getattr(problem.reality, "truth", None) is None and np.isfinite(noise):
            known = float(noise)
    else:
        real = trials.f_marks[use]
        scale = 1 / np.maximum(real.std(axis=0), np.finfo(float).tiny)
    weight = np.tile(scale, len(real))
    residual = (slopes.values - real.reshape(-1)) * weight
    return told_by(slopes.weighted(weight), residual, shares_of(problem, simulation), known)


def informative(problem: Problem, simulation: np.ndarray, tried: np.ndarray, candidates: np.ndarray) -> list[int]:
    """Candidates (M, n_c) by how much their trials tell, beside those tried (n, n_c): a greedy D-optimal order.

    The first two keep their places. Each of the others is the one with which the log-volume of what is not known falls
    most, if measurements scatter as in `told_words.told_by_plan`.
    """
    slopes = fitness_slopes(problem, simulation, np.concatenate([tried, candidates]))
    scatter = PLANNED_SCATTER * np.sqrt(np.nanmean(slopes.values**2))
    variance = float(scatter**2 + slopes.rough[0].mean())
    p = slopes.slopes.shape[2]
    rows = np.nan_to_num(slopes.slopes[0]).reshape(len(tried) + len(candidates), -1, p) / np.sqrt(variance)
    own, others = rows[len(tried) :], rows[: len(tried)].reshape(-1, p)
    information = others.T @ others + _PRIOR * np.eye(p)
    order, left = list[int](), list(range(len(own)))
    while left:
        volumes = [np.linalg.slogdet(information + own[i].T @ own[i])[1] for i in left]
        order.append(left.pop(0 if len(order) < _BEST_FIRST else int(np.argmax(volumes))))
        information = information + own[order[-1]].T @ own[order[-1]]
    return order


def shares_of(problem: Problem, simulation: np.ndarray) -> np.ndarray:
    """(p,) the unknown numbers of a simulation (n_s,), as shares of their ranges."""
    box = problem.simulation_box
    own: np.ndarray = simulation[problem.robot.simulation_box.indices(problem.unknown)]
    return (own - box.low) / box.span
