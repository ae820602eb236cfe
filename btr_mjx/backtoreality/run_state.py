"""Problem and state of Back-to-Reality."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from btr_mjx.backtoreality.reality.simulated import Reality
from btr_mjx.backtoreality.settings import BTRSettings
from btr_mjx.evaluation import Engine, FitnessFunction, evaluate
from btr_mjx.optimise import GAState, ga_state_from_arrays, ga_state_to_arrays
from btr_mjx.robots import Box, Robot

Phase = Literal["baseline", "controllers", "transfer", "simulations", "growth", "done"]
"""Next piece of work: the first controller in reality, steps 1, 2 and 3, the search for a missing effect, none."""

Progress = Callable[[int], object]
"""Callback for the number of pairs simulated since its last call."""

CMA_BITS = 30
"""Bits per parameter of stored members of CMA-ES: a grid of a billionth of the range."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A co-evolution problem.

    Attributes:
      robot: the robot.
      reality: the real robot, or a simulation of it.
      unknown: names of the parameters of S that are searched; the others keep their values of `start`.
      start: (n_s,) s_0.
      settings: the algorithm's settings.
      fitness: the fitness function.
      engine: the engine of the searches; None for the fastest.
      seed: of all random numbers.
      progress: called with the number of pairs simulated since the last call.
    """

    robot: Robot
    reality: Reality
    unknown: tuple[str, ...]
    start: np.ndarray
    settings: BTRSettings
    fitness: FitnessFunction
    engine: Engine | None = None
    seed: int = 0
    progress: Progress | None = None

    def __post_init__(self) -> None:
        self.settings.check()

    @property
    def simulation_box(self) -> Box:
        """Box of the unknown parameters, with the bits of step 3."""
        bits = CMA_BITS if self.settings.optimiser == "cma" else self.settings.simulation_bits
        return self.robot.simulation_box.subspace(self.unknown).with_bits(bits)

    @property
    def controller_box(self) -> Box:
        """Box of the controllers, with the bits of step 1."""
        return self.robot.controller_box.with_bits(self.settings.controller_bits)

    @property
    def times(self) -> tuple[float, ...]:
        """Times [s] at which a trial in reality is measured: the marks, if the distance needs them, and T_e."""
        marks = self.settings.marks if self.settings.compared == "multiscale" else ()
        return (*marks, self.robot.duration)

    def embed(self, unknown_values: np.ndarray) -> np.ndarray:
        """(..., n_s) simulations with these values (..., n_unknown) of the unknown parameters."""
        return self.robot.simulation_box.embed(self.start, self.unknown, unknown_values)

    def simulate(self, simulations: np.ndarray, controllers: np.ndarray) -> np.ndarray:
        """Fitness (L, M) of controllers (M, n_c) in simulations (L, n_s)."""
        evaluation = evaluate(
            self.robot, simulations, controllers, engine=self.engine, fitness=self.fitness, progress=self.progress
        )
        return evaluation.fitness

    def rng(self, iteration: int, step: int) -> np.random.Generator:
        """An independent random generator for a step of an iteration."""
        return np.random.default_rng([self.seed, iteration, step])


@dataclass(frozen=True, eq=False)
class Trials:
    """All evaluations in reality so far, one row each.

    Attributes:
      controllers: (n, n_c).
      f_r: (n,) fitness in reality.
      f_marks: (n, K) fitness in reality as if the trial had ended at each mark; K is 0 for Delta_fitness.
      f_s: (n,) fitness in the simulation in which the controller was found, the mean of those of an ensemble.
      iteration: (n,) iteration of the trial, 0 for the first controller c_0.
    """

    controllers: np.ndarray
    f_r: np.ndarray
    f_marks: np.ndarray
    f_s: np.ndarray
    iteration: np.ndarray

    def __len__(self) -> int:
        return len(self.f_r)

    def add(self, controllers: np.ndarray, measured: np.ndarray, f_s: np.ndarray, iteration: int) -> "Trials":
        """These and further trials, of controllers (m, n_c) with results (m, K + 1) of `Reality.measure`."""
        return Trials(
            np.concatenate([self.controllers, controllers]),
            np.concatenate([self.f_r, measured[:, -1]]),
            np.concatenate([self.f_marks, measured[:, :-1]]),
            np.concatenate([self.f_s, f_s]),
            np.concatenate([self.iteration, np.full(len(f_s), iteration)]),
        )


@dataclass(frozen=True, eq=False)
class State:
    """State of the algorithm. Arrays and plain values only, so that it can be saved.

    Attributes:
      phase: the next piece of work.
      iteration: 1, 2, ...
      simulation: (n_s,) best simulation so far, s_(i-1) until step 3 of iteration i ends.
      ensemble: (K, n_s) simulations of step 1: s_(i-1), and others that trials leave possible.
      genome: (bits,) of c_(i-1), from which step 1 starts.
      trials: all evaluations in reality.
      search: state of the present search, None between searches.
      genomes: (g, population, bits) all generations of the present search; (1, m, bits) the chosen ones before trials.
      scores: (g, population) their fitness or distance.
      delta_before: the distance of s_(i-1) over the behaviours of iteration i.
      stop: the stop criterion that was met, "" before.
      grown: effects that were added to the simulator, as JSON-able values; see `growth.grown`.
      sought: growth events so far: iteration, verdict, what was added and Delta_fitness.
      told: what the trials of the last iteration that ended tell, see `told_words.told_record`.
    """

    phase: Phase
    iteration: int
    simulation: np.ndarray
    ensemble: np.ndarray
    genome: np.ndarray
    trials: Trials
    search: GAState | None = None
    genomes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0), bool))
    scores: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    delta_before: float = np.nan
    stop: str = ""
    grown: tuple[dict[str, Any], ...] = ()
    sought: tuple[dict[str, Any], ...] = ()
    told: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sought_here(self) -> bool:
        """Whether a missing effect was looked for in this iteration."""
        return any(row["iteration"] == self.iteration for row in self.sought)


def state_to_arrays(state: State) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """A state as named arrays and JSON-able values; the inverse of `state_from_arrays`."""
    arrays = {
        "simulation": state.simulation,
        "ensemble": state.ensemble,
        "genome": state.genome,
        "genomes": state.genomes,
        "scores": state.scores,
        "delta_before": np.array(state.delta_before),
        **{f"trials/{name}": value for name, value in vars(state.trials).items()},
    }
    if state.search is not None:
        arrays |= {f"search/{name}": value for name, value in ga_state_to_arrays(state.search).items()}
    named = {name: list(getattr(state, name)) for name in ("grown", "sought")} | {"told": dict(state.told)}
    return arrays, {"phase": state.phase, "iteration": state.iteration, "stop": state.stop, **named}


def state_from_arrays(arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> State:
    """The state from the arrays and values of `state_to_arrays`."""
    part = lambda prefix: {  # noqa: E731
        name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)
    }
    search = part("search/")
    return State(
        phase=values["phase"],
        iteration=values["iteration"],
        simulation=arrays["simulation"],
        ensemble=arrays["ensemble"],
        genome=arrays["genome"],
        trials=Trials(**part("trials/")),
        search=ga_state_from_arrays(search) if search else None,
        genomes=arrays["genomes"],
        scores=arrays["scores"],
        delta_before=float(arrays["delta_before"]),
        stop=values["stop"],
        grown=tuple(values["grown"]),
        sought=tuple(values["sought"]),
        told=values["told"],
    )
