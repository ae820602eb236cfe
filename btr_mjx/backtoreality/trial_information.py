"""What trials tell of the unknown numbers: Fisher information of fitness, intervals, what is told of combinations.

In the best simulation s, N measured values of fitness leave residuals r. A regression over simulations around it gives
the slopes J (N, p) of fitness along the unknown numbers. With each number's range as a prior of the same variance P^-1,
the linear picture is

    covariance C = (J'J / v + P)^-1        estimate = s - C (J'r / v + P (s - middle))

with the variance v of a value: that of repeated measurements, that by which fitness differs from the regression, and N
times that of the residuals where these are larger than noise: trials of similar controllers share what the simulator
lacks, and many of them tell no more of the numbers than one. What slopes owe to roughness is taken from J'J.

The regression is over the simulations that C leaves possible, so that it is found in rounds, from the prior on: fitness
is no straight line over the whole range, and motion with contacts is so rough that a slope at a point says nothing.
"""

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
import scipy

from btr_mjx.backtoreality.run_state import Problem, Trials
from btr_mjx.backtoreality.simulation_search import compared_fitness, counting_trials

LEVEL = 0.9
"""Probability of an interval."""

TOLD = 0.5
"""Part of its range that the interval of a number that is told does not exceed."""

_ROUNDS = 4
"""Regressions, each over what the one before leaves possible: on the arm of `benchmarks/told_numbers.py` intervals are
7, 2.6 and 1.4 times as wide after one, two and three, and no narrower after six."""

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
    """Regression of N values of fitness over simulations with p unknown numbers, in units of their ranges.

    Attributes:
      slopes: (N, p) derivatives; NaN where a pair diverged.
      rough: mean square difference of fitness from the regression.
      gain: (p, p) covariance of a value's slopes, in units of `rough`.
    """

    slopes: np.ndarray
    rough: float
    gain: np.ndarray


@dataclass(frozen=True, eq=False)
class Told:
    """What trials tell of p numbers, in units of their ranges.

    Attributes:
      at: (p,) the simulation's numbers.
      estimate: (p,) those that the linear picture prefers, within the ranges.
      covariance: (p, p) of their errors.
      scatter: variance of a value, over the sum of the squares of the residuals; 0 where these vanish.
      others: (K, p) other simulations that fit as well as the intervals' ends do.
    """

    at: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray
    scatter: float
    others: np.ndarray

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
        ends = np.vstack([self.estimate - self.reach, self.estimate + self.reach, self.at, self.others])
        return np.array([ends.min(axis=0), ends.max(axis=0)])

    def beside(self, shares: np.ndarray, distances: np.ndarray, least: float) -> "Told":
        """The same with those of other simulations (K, p) that are possible: the linear picture knows one valley.

        Args:
          shares: their numbers.
          distances: (K,) from reality, as step 3 minimises them; NaN for one that diverged.
          least: distance of the simulation.
        """
        possible = distances <= least * np.sqrt(1 + _QUANTILE**2 * self.scatter)
        return replace(self, others=np.concatenate([self.others, shares[possible]]))

    def possible(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, p) random numbers that trials leave possible, within the ranges."""
        return np.clip(rng.multivariate_normal(self.estimate, self.covariance, count), 0.0, 1.0)

    def combinations(self) -> dict[tuple[int, ...], list[np.ndarray]]:
        """Numbers that are not told each by itself -> their shares in directions that are told."""
        variance, directions = np.linalg.eigh(self.covariance)
        found: dict[tuple[int, ...], list[np.ndarray]] = {}
        apart = np.ptp(np.vstack([self.at, self.others]) @ directions, axis=0)
        width = np.maximum(2 * _QUANTILE * np.sqrt(np.maximum(variance, 0.0)), apart)
        for size, direction in zip(width, directions.T, strict=True):
            own = np.flatnonzero((direction**2 >= _INVOLVED) & ~self.told)
            if size <= TOLD and len(own) > 1:
                found.setdefault(tuple(own.tolist()), []).append(direction[own])
        return found


def fitness_slopes(
    problem: Problem, at: np.ndarray, covariance: np.ndarray, controllers: np.ndarray, weight: np.ndarray, seed: int
) -> Slopes:
    """Regression of the fitness that step 3 compares, over twice as many simulations as it has coefficients.

    Args:
      problem: the problem.
      at: (p,) unknown numbers around which simulations are drawn, as shares of their ranges.
      covariance: (p, p) of what is drawn.
      controllers: (M, n_c).
      weight: (N,) units of the values, N being M times the marks.
      seed: of the draws.
    """
    p = len(at)
    draws = np.random.default_rng([problem.seed, seed]).standard_normal((p + 1, p))
    variances, axes = np.linalg.eigh(covariance)
    # In pairs, so that bends leave slopes alone, and of exactly this covariance.
    steps = np.sqrt(len(draws)) * np.linalg.qr(draws)[0] @ (axes * np.sqrt(np.maximum(variances, 0.0))).T
    places = 1 - np.abs(np.mod(at + np.concatenate([steps, -steps]), 2) - 1)  # mirrored at the ends of the ranges
    values = _compared(problem, places, controllers) * weight
    columns = np.column_stack([np.ones(len(places)), places - at])
    fit = np.linalg.pinv(columns)
    left = values - columns @ (fit @ values)
    squares = (left**2).sum(axis=0) / (len(places) - p - 1)
    good = np.isfinite(squares)
    return Slopes((fit @ values)[1:].T, float(squares[good].mean()) if good.any() else 0.0, (fit @ fit.T)[1:, 1:])


def slope_simulations(problem: Problem) -> int:
    """Simulations behind what trials tell."""
    return _ROUNDS * 2 * (len(problem.unknown) + 1) + 1


def told_by(
    problem: Problem,
    simulation: np.ndarray,
    controllers: np.ndarray,
    measured: np.ndarray | None = None,
    noise: float = 0.0,
    weight: np.ndarray | None = None,
) -> Told:
    """Estimates of unknown numbers and their errors.

    Args:
      problem: the problem.
      simulation: (n_s,) that fits the trials best.
      controllers: (M, n_c) of the trials.
      measured: (N,) values, N being M times the marks; None before any: those of the simulation itself, with the
        noise that is assumed (`PLANNED_SCATTER`).
      noise: known standard deviation of a measured value.
      weight: (N,) by which values are multiplied before they are compared; None for 1.
    """
    at = shares_of(problem, simulation)
    told = Told(at, np.full(len(at), 0.5), np.eye(len(at)) / _PRIOR, 0.0, np.zeros((0, len(at))))
    if not len(controllers):
        return told
    values = _compared(problem, at[None], controllers)[0]
    weight = np.ones(len(values)) if weight is None else weight
    if measured is None:
        measured, noise = values, float(PLANNED_SCATTER * np.sqrt(np.nanmean((values * weight) ** 2)))
    residual = (values - measured) * weight
    for seed in range(_ROUNDS):
        slopes = fitness_slopes(problem, at, told.covariance, controllers, weight, seed)
        good = np.isfinite(residual) & np.isfinite(slopes.slopes).all(axis=1)
        least = np.finfo(float).eps * float(np.mean((values * weight)[good] ** 2)) if good.any() else 1.0
        told = _posterior(at, residual[good], slopes.slopes[good], slopes, noise, least)
    return told


def _posterior(
    at: np.ndarray, residual: np.ndarray, jacobian: np.ndarray, slopes: Slopes, noise: float, least: float
) -> Told:
    """The linear picture of N values: residuals (N,) and slopes (N, p); `least` is the least variance of a value."""
    count, square = len(residual), float(residual @ residual)
    more = square > noise**2 * scipy.stats.chi2.isf(_CHANCE, max(count, 1))
    # The fit hides a part of what the simulator lacks.
    shared = max(square - count * noise**2, 0.0) * count / max(count - len(at), 1) if more else 0.0
    variance = max(noise**2 + shared + slopes.rough, least)
    squares, axes = np.linalg.eigh(jacobian.T @ jacobian - count * slopes.rough * slopes.gain)
    covariance = (axes / (np.maximum(squares, 0.0) / variance + _PRIOR)) @ axes.T
    estimate = at - covariance @ (jacobian.T @ residual / variance + _PRIOR * (at - 0.5))
    scatter = variance / square if square else 0.0
    return Told(at, np.clip(estimate, 0.0, 1.0), covariance, scatter, np.zeros((0, len(at))))


def told_by_trials(problem: Problem, simulation: np.ndarray, trials: Trials, iteration: int) -> Told:
    """What the trials that step 3 compared tell of the unknown numbers, beside the simulation (n_s,) that it found."""
    use = counting_trials(problem, trials, iteration)
    if problem.settings.compared == "fitness":
        real, scale, known = trials.f_r[use][:, None], np.ones(1), getattr(problem.reality, "noise", np.nan)
        noise = float(known) if getattr(problem.reality, "truth", None) is None and np.isfinite(known) else 0.0
    else:
        real, noise = trials.f_marks[use], 0.0
        scale = 1 / np.maximum(real.std(axis=0), np.finfo(float).tiny)
    weight = np.tile(scale, len(real))
    return told_by(problem, simulation, trials.controllers[use], real.reshape(-1), noise, weight)


def informative(problem: Problem, told: Told, candidates: np.ndarray) -> list[int]:
    """Candidates (M, n_c) by how much their trials tell beside what is told already: a greedy D-optimal order.

    The first two keep their places. Each of the others is the one with which the log-volume of what is not known falls
    most, if measurements scatter as in `told_words.told_by_plan`.
    """
    values = _compared(problem, told.at[None], candidates)[0]
    slopes = fitness_slopes(problem, told.at, told.covariance, candidates, np.ones(len(values)), _ROUNDS)
    variance = float(PLANNED_SCATTER**2 * np.nanmean(values**2) + slopes.rough)
    rows = np.nan_to_num(slopes.slopes).reshape(len(candidates), -1, len(told.at)) / np.sqrt(variance)
    information = np.linalg.inv(told.covariance)
    order, left = list[int](), list(range(len(rows)))
    while left:
        volumes = [np.linalg.slogdet(information + rows[i].T @ rows[i])[1] for i in left]
        order.append(left.pop(0 if len(order) < _BEST_FIRST else int(np.argmax(volumes))))
        information = information + rows[order[-1]].T @ rows[order[-1]]
    return order


def _compared(problem: Problem, shares: np.ndarray, controllers: np.ndarray) -> np.ndarray:
    """(L, N) values that step 3 compares, in simulations whose unknown numbers are shares (L, p) of their ranges."""
    box = problem.simulation_box
    members = problem.embed(box.low + box.span * shares)
    return compared_fitness(problem, members, controllers).reshape(len(shares), -1)


def shares_of(problem: Problem, simulation: np.ndarray) -> np.ndarray:
    """(p,) the unknown numbers of a simulation (n_s,), as shares of their ranges."""
    box = problem.simulation_box
    own: np.ndarray = simulation[problem.robot.simulation_box.indices(problem.unknown)]
    return (own - box.low) / box.span
