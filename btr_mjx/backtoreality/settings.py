"""Settings of runs and of the algorithm: fields, which are flags of the commands, and checks of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from btr_mjx.errors import InputError
from btr_mjx.evaluation import MARKS, Engine, FitnessFunction, fitness_of
from btr_mjx.models import check_robot
from btr_mjx.robots import Robot


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings of a run of a robot; every field is a flag."""

    robot: Path | None = None
    """A robot.toml that describes another robot, see docs/robot_file.md; by default the hexapod of the paper."""
    seed: int = 0
    """Seed of everything random."""
    engine: Literal["auto", "lanes", "mjx", "native"] = "auto"
    """How simulations are computed. auto measures before the first trial whether lanes or native is the faster one for
    the whole run, and writes it to the run's config."""
    progress: bool = True
    """Show progress and remarks (lines now and then where there is no terminal). --quiet is another name of
    --no-progress: the result, warnings and errors only."""
    figures: bool = True
    """Draw the page and its figures at the end."""
    fitness: str | None = None
    """Fitness function: distance (the hexapod's), forward_speed, energy_per_metre, target_distance, or FILE.py:NAME; by
    default the robot's own."""
    duration: float | None = None
    """T_e, duration of a trial [s]; by default the robot's own (hexapod: 1.7)."""
    template: Path | None = None
    """Another MJCF template of the hexapod, with the same parameters and motors."""

    def fitness_of(self, robot: Robot) -> FitnessFunction:
        """The fitness function, see `fitness_function`; by default the robot's own."""
        return fitness_of(robot, self.fitness)

    @property
    def engine_or_none(self) -> Engine | None:
        """The engine as `evaluate` takes it."""
        return None if self.engine == "auto" else self.engine


Distance = Literal["fitness", "multiscale"]
"""Distance that step 3 minimises, see `BTRSettings.distance`."""


@dataclass(frozen=True)
class SearchSettings:
    """Settings of one of the two evolutionary searches.

    Attributes:
      population: M controllers or L simulations.
      generations: generations per iteration.
      p_m: mutation probability per bit.
      bits: bits per parameter.
    """

    population: int
    generations: int
    p_m: float = 0.02
    bits: int = 8

    def __post_init__(self) -> None:
        if self.population < 2 or self.generations < 1:
            raise InputError(
                f"population {self.population} and generations {self.generations}: expected at least 2 and 1"
            )
        if not 0 <= self.p_m <= 1:
            raise InputError(f"p_m: got {self.p_m}, expected a probability per bit within [0, 1]")


@dataclass(frozen=True, kw_only=True)
class BTRSettings:
    """Settings of the algorithm; every field is a flag."""

    iterations: int = 3
    """At most so many iterations of Back-to-Reality."""
    trials: int = 10
    """m, controllers tried in reality per iteration."""
    choose: Literal["best", "informative"] = "best"
    """Which controllers are tried: the best of the last generation, or the two best and those of it that tell most of
    the unknown parameters."""
    max_evaluations: int | None = None
    """Stop before exceeding so many evaluations in reality."""
    target_delta: float | None = None
    """Stop once Delta_fitness is at most this [unit of the fitness]."""
    behaviours: Literal["latest", "all"] = "all"
    """Delta_fitness over the behaviours of the latest iteration (the paper), or over all so far."""
    distance: Literal["auto", "fitness", "multiscale"] = "auto"
    """What step 3 minimises: Delta_fitness (the paper), or the fitness at several early marks of the trial, which finds
    many unknown parameters from few trials, in a fraction of the time. auto: multiscale for the hexapod against a
    simulated reality, for which the default marks are good; else fitness."""
    marks: tuple[float, ...] = MARKS
    """Marks of the multiscale distance [s]; no other distance uses them."""
    optimiser: Literal["ga", "cma"] = "ga"
    """How step 3 searches: the genetic algorithm (the paper), or CMA-ES, which finds many unknown parameters far better
    and ends early once it has converged."""

    controllers: int = 48
    """M, population of controllers."""
    controller_generations: int = 6
    """Generations of step 1."""
    first_population: Literal["random", "mutants"] = "random"
    """Controllers with which iteration 1 begins: random ones and the first controller, or mutants of it (the paper)."""
    ensemble: int = 1
    """K, simulations over which the fitness of a controller is averaged in step 1: s_(i-1) and others that trials leave
    possible, before the first ones anywhere in the range of what is unknown. 1: s_(i-1) alone (the paper)."""
    p_m: float = 0.02
    """Probability per bit of flipping a controller's bit."""
    controller_bits: int = 8
    """Bits per controller parameter."""
    simulations: int = 24
    """L, population of simulations."""
    simulation_generations: int = 8
    """Generations of step 3."""
    simulation_p_m: float = 0.1
    """Probability per bit of flipping a simulation's bit."""
    simulation_bits: int = 10
    """Bits per unknown parameter."""

    grow: bool = False
    """Where the best simulation leaves more of Delta_fitness than errors of calibration do, look for the missing effect
    and add it to the simulator."""
    grow_from: Literal["recordings", "fitness"] = "recordings"
    """Look for it in recordings of the trials where reality gives them, else by fitness alone; or by fitness alone in
    any case."""
    max_effects: int = 2
    """Effects that --grow adds, at most."""

    @property
    def step_1(self) -> SearchSettings:
        """The search for controllers."""
        return SearchSettings(self.controllers, self.controller_generations, self.p_m, self.controller_bits)

    @property
    def step_3(self) -> SearchSettings:
        """The search for simulations; CMA-ES ignores p_m and bits."""
        return SearchSettings(self.simulations, self.simulation_generations, self.simulation_p_m, self.simulation_bits)

    @property
    def compared(self) -> Distance:
        """What step 3 minimises; without a robot to judge by, auto is Delta_fitness."""
        return "multiscale" if self.distance == "multiscale" else "fitness"

    @property
    def most_effects(self) -> int:
        """Effects that may be added to the simulator."""
        return self.max_effects if self.grow else 0

    def check(self) -> None:
        """Check what depends on several settings.

        Raises:
          InputError: a number that does not fit another one.
        """
        if not 1 <= self.trials < self.step_1.population:
            raise InputError(
                f"trials m = {self.trials}: expected 1 <= m < M, the controller population of "
                f"{self.controllers}; lower m or raise the population"
            )
        if self.iterations < 1:
            raise InputError(f"iterations: got {self.iterations}, expected at least 1")
        if self.max_evaluations is not None and self.max_evaluations < self.trials + 1:
            raise InputError(
                f"max_evaluations: got {self.max_evaluations}, expected at least {self.trials + 1}: the first "
                "controller and one iteration's trials"
            )
        if self.optimiser == "cma" and self.step_3.population < 4:
            raise InputError(
                f"simulations L = {self.simulations}: CMA-ES needs at least 4; raise L or take the genetic algorithm"
            )
        if self.compared == "multiscale" and self.trials < 2:
            raise InputError("trials m = 1: the multiscale distance needs at least 2, to know the spread at each mark")


MAX_PAIRS = 10**9
"""Most simulated trials of a run; at a million steps a second that are decades."""

MAX_POPULATION = 1_000_000
"""Largest population, number of trials or points of a grid: each is held in memory."""

_RANGES: Mapping[str, tuple[float, float]] = {
    "seed": (0, 2**63 - 1),
    "grid": (2, MAX_POPULATION),
    **dict.fromkeys(("trials", "controllers", "ensemble", "simulations"), (1, MAX_POPULATION)),
    **dict.fromkeys(("iterations", "generations", "controller_generations", "simulation_generations"), (1, 10**6)),
    "max_evaluations": (1, 2**63 - 1),
    "max_effects": (0, 100),
    **dict.fromkeys(("controller_bits", "simulation_bits"), (1, 32)),
    **dict.fromkeys(("p_m", "simulation_p_m"), (0, 1)),
    "noise": (0, 1000),
    "target_delta": (0, 1e12),
    "signal_rate": (1, 1e5),
    "duration": (1e-6, 1e6),
}
"""Smallest and largest value of a setting, by its name; a setting that is None is not checked."""


def check_settings(config: Any, robot: Robot) -> None:
    """Check the numbers of a command's config, and that its robot can be tried.

    Raises:
      InputError: a number outside its range, more trials than `MAX_PAIRS`, or see `check_robot`.
    """
    for name, (low, high) in _RANGES.items():
        value = getattr(config, name, None)
        if value is not None and not low <= value <= high:
            raise InputError(f"{name}: got {_short(value)}, expected a value within [{low:.10g}, {high:.10g}]")
    for mark in getattr(config, "marks", ()):
        if not (math.isfinite(mark) and mark > 0):
            raise InputError(f"marks: got {mark}, expected times in seconds above 0")
    pairs = _pairs(config)
    if pairs > MAX_PAIRS:
        raise InputError(f"these settings ask for {_short(pairs)} simulated trials, at most {MAX_PAIRS:.3g} are run")
    check_robot(robot)


def _pairs(config: Any) -> int:
    """Trials that the settings ask for, at most."""

    def value(name: str) -> int:
        return int(getattr(config, name, None) or 0)

    if hasattr(config, "grid"):
        return value("controllers") * value("generations") + value("trials") * (value("grid") + 1)
    step_1 = value("ensemble") * value("controllers") * value("controller_generations")
    step_3 = value("simulations") * value("simulation_generations") * value("trials") * value("iterations")
    return value("iterations") * (step_1 + step_3)


def _short(value: float) -> str:
    return f"{value:.6g}" if abs(value) >= 1e15 else f"{value!r}"
