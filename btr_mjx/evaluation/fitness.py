"""Fitness functions, delta_k and Delta_fitness (eq. 3 and 4 of the paper), learning performance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError
from btr_mjx.robots import Robot
from btr_mjx.runs import load_object


@dataclass(frozen=True, eq=False)
class Outcome:
    """Data of behaviours B(E, c) from which fitness is computed, for a batch of any leading shape (...).

    Attributes:
      times: (K,) sample times [s], ascending; the last one is the end of the trial.
      start: (..., 3) base position at t = 0 [m].
      position: (..., K, 3) base position at the sample times [m].
      energy: (..., K) mechanical work of the motors so far, the integral of sum |force x velocity| dt [J].
      qpos: (..., K, nq) generalised positions, or None where they were not recorded.
      qvel: (..., K, nv) generalised velocities, likewise.
      act: (..., K, na) activations of the actuators, likewise.
    """

    times: NDArray[np.float64]
    start: NDArray[np.float64]
    position: NDArray[np.float64]
    energy: NDArray[np.float64]
    qpos: NDArray[np.float64] | None = None
    qvel: NDArray[np.float64] | None = None
    act: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class FitnessFunction:
    """A named fitness: `function` maps an Outcome of leading shape (...) to f of shape (...).

    Attributes:
      name: used in tables and settings.
      unit: of the fitness.
      maximise: whether larger is better.
      function: the map; its result is NaN where the fitness is not defined.
      needs_states: whether it reads qpos, qvel or act.
    """

    name: str
    unit: str
    maximise: bool
    function: Callable[[Outcome], np.ndarray]
    needs_states: bool = False

    def __call__(self, outcome: Outcome) -> np.ndarray:
        """Fitness of each behaviour.

        Raises:
          InputError: the function gives something else than one number for each.
        """
        values, expected = self.function(outcome), outcome.position.shape[:-2]
        if np.shape(values) != expected:
            raise InputError(
                f"fitness {self.name!r}: gave shape {np.shape(values)} for trials of shape {expected}, expected one "
                "number for each trial"
            )
        return values


def _speed(outcome: Outcome) -> np.ndarray:
    return np.linalg.norm((outcome.position[..., -1, :] - outcome.start)[..., :2], axis=-1) / outcome.times[-1]


def _forward(outcome: Outcome) -> np.ndarray:
    return (outcome.position[..., -1, 0] - outcome.start[..., 0]) / outcome.times[-1]


def _energy_per_metre(outcome: Outcome) -> np.ndarray:
    travelled = np.linalg.norm((outcome.position[..., -1, :] - outcome.start)[..., :2], axis=-1)
    return outcome.energy[..., -1] / np.where(travelled > 1e-3, travelled, np.nan)


FITNESS_FUNCTIONS: dict[str, FitnessFunction] = {
    function.name: function
    for function in (
        # The paper's: horizontal distance between start and end, over T_e.
        FitnessFunction("distance", "m/s", True, _speed),
        FitnessFunction("forward_speed", "m/s", True, _forward),
        # Not defined for a robot that moved less than a millimetre.
        FitnessFunction("energy_per_metre", "J/m", False, _energy_per_metre),
    )
}
"""The built-in fitness functions by name."""

FitnessLike = FitnessFunction | Callable[[Outcome], np.ndarray] | str
"""A fitness as it may be given, see `fitness_function`."""


def fitness_function(fitness: FitnessLike, target: Sequence[float] = ()) -> FitnessFunction:
    """A fitness function by name, or of a function.

    Args:
      fitness: a `FitnessFunction`, or a function of an `Outcome` with states whose value is maximised; or the name of
        a built-in one, "target_distance", or FILE.py:NAME of one of the first two.
      target: (3,) point that "target_distance" refers to [m].

    Raises:
      InputError: an unknown name, no target, a file without such a function, neither a name nor a function.
    """
    if isinstance(fitness, FitnessFunction):
        return fitness
    if not isinstance(fitness, str):
        return _of_callable(fitness, getattr(fitness, "__name__", type(fitness).__name__))
    name = fitness
    if name == "target_distance":
        if len(target) != 3:
            raise InputError(f"fitness {name!r}: got the target {tuple(target)}, expected [x, y, z] in metres")
        return FitnessFunction(name, "m", False, partial(_target_distance, np.array(target, float)))
    if ".py:" in name:
        own = load_object(name, "fitness")
        return own if isinstance(own, FitnessFunction) else _of_callable(own, Path(name).name)
    if name not in FITNESS_FUNCTIONS:
        known = ", ".join([*FITNESS_FUNCTIONS, "target_distance", "FILE.py:NAME"])
        raise InputError(f"fitness: got {name!r}, expected one of: {known}")
    return FITNESS_FUNCTIONS[name]


def fitness_of(robot: Robot, fitness: FitnessLike | None = None) -> FitnessFunction:
    """The fitness function of a robot, or another one that refers to its target.

    Args:
      robot: the robot.
      fitness: see `fitness_function`; None for the robot's own.

    Raises:
      InputError: see `fitness_function`.
    """
    return fitness_function(robot.fitness if fitness is None else fitness, robot.target)


def _of_callable(own: Any, name: str) -> FitnessFunction:
    if not callable(own):
        raise InputError(
            f"fitness {name!r}: got {type(own).__name__}, expected a name, a function or a FitnessFunction"
        )
    return FitnessFunction(name, "", True, own, needs_states=True)


def _target_distance(target: np.ndarray, outcome: Outcome) -> np.ndarray:
    return np.linalg.norm(outcome.position[..., -1, :] - target, axis=-1)


def delta_of(f_s: ArrayLike, f_r: ArrayLike) -> np.ndarray:
    """delta_k = |f_sk - f_rk|, eq. 3, of fitness f_s (..., m) and f_r (m,); NaN where either is NaN.

    Raises:
      InputError: the last axes differ.
    """
    simulated, real = np.asarray(f_s, np.float64), np.asarray(f_r, np.float64)
    if real.ndim != 1 or simulated.shape[-1:] != real.shape:
        raise InputError(
            f"f_r: got shape {real.shape} for f_s of shape {simulated.shape}, expected one fitness per controller, "
            f"({simulated.shape[-1] if simulated.ndim else 'm'},)"
        )
    return np.abs(simulated - real)


def delta_fitness_of(f_s: ArrayLike, f_r: ArrayLike) -> np.ndarray:
    """Delta_fitness = mean of delta_k over the m behaviours, eq. 4, of fitness f_s (..., m) and f_r (m,).

    NaN for a simulation in which any of the behaviours diverged: leaving these out would favour simulations that
    diverge.
    """
    return delta_of(f_s, f_r).mean(axis=-1)


def learning_performance(
    f_0: float, f_end: float, f_max: float, dimension: int, evaluations: int, maximise: bool = True
) -> float:
    """Learning performance LP = IF d / e with IF = (f_end - f_0) / f_max, the paper's first footnote.

    Args:
      f_0: fitness in reality before learning.
      f_end: fitness in reality after learning.
      f_max: largest absolute fitness measured in reality, which normalises the improvement.
      dimension: d, number of controller parameters.
      evaluations: e, number of evaluations in reality.
      maximise: whether larger fitness is better; else IF = (f_0 - f_end) / f_max.

    Returns:
      LP; 0 where f_max is 0.

    Raises:
      InputError: fewer than one evaluation.
    """
    if evaluations < 1:
        raise InputError(f"evaluations: got {evaluations}, expected at least one evaluation in reality")
    improvement = (f_end - f_0) / abs(f_max) if f_max else 0.0
    return float((improvement if maximise else -improvement) * dimension / evaluations)
