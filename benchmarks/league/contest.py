"""What a contestant of the league gets: a robot, a room where it can be tried, a number of trials, and a seed.

The room is an exchange folder. Whoever measures there is a process of its own (`sealed.py`), which this module starts
and never imports: only files pass.
"""

import csv
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

import btr_mjx as btr
from btr_mjx.backtoreality import FolderReality, Waiting
from btr_mjx.errors import InputError
from btr_mjx.evaluation import Engine, fitness_of
from btr_mjx.gap.data import Recording
from btr_mjx.optimise import GAConfig, GeneticAlgorithm
from btr_mjx.robots import Robot

BENCHMARKS = Path(__file__).parents[1]
EXAMPLES = BENCHMARKS.parent / "examples"
SEALED = Path(__file__).with_name("sealed.py")
FOLDERS: Mapping[str, Path | None] = {
    "thrower": EXAMPLES / "thrower",
    "quadruped": EXAMPLES / "quadruped",
    "finger": BENCHMARKS / "league_robots/finger",
    "cart": BENCHMARKS / "league_robots/cart",
    "hopper": BENCHMARKS / "league_robots/hopper",
    "hexapod": None,
}
"""Robot -> folder of its robot.toml; None for the hexapod of the package."""

UNKNOWN: Mapping[str, tuple[str, ...]] = {"hexapod": ("bl_5", "bl_14")}
"""Robot -> what is unknown of it, where that is not all of S."""

REALITIES = tuple(
    f"{robot}-{i}"
    for robot, count in (("thrower", 4), ("quadruped", 4), ("finger", 3), ("cart", 3), ("hopper", 3), ("hexapod", 3))
    for i in range(count)
)
"""Names of the realities."""


def league_robot(reality: str) -> Robot:
    """The believed robot of a reality."""
    folder = FOLDERS[reality.partition("-")[0]]
    return btr.hexapod() if folder is None else btr.load_robot(folder)


def unknown_of(robot: Robot) -> tuple[str, ...]:
    """Names of the parameters of S that nobody knows."""
    return UNKNOWN.get(robot.name, robot.simulation_box.names)


@dataclass(frozen=True)
class Room:
    """A reality behind an exchange folder, in which a limited number of trials is measured.

    Attributes:
      reality: its name.
      folder: the exchange folder.
      trials: number of trials, repeats included, after which whoever measures there refuses.
      exact: sensors have no noise.
    """

    reality: str
    folder: Path
    trials: int
    exact: bool = False

    @property
    def desk(self) -> FolderReality:
        """The project's own side of the folder."""
        robot = league_robot(self.reality)
        return FolderReality(robot, self.folder, fitness_of(robot))

    def measure(self, controllers: ArrayLike, trial: int, times: tuple[float, ...] = ()) -> np.ndarray:
        """Fitness of controllers (m, n_c), see `btr_mjx.backtoreality.Reality`; (m, 1) without times.

        Raises:
          InputError: more trials than are left.
        """
        rows, times = np.atleast_2d(np.asarray(controllers, float)), times or (self.desk.robot.duration,)
        try:
            return self.desk.measure(rows, trial, times)
        except Waiting:
            words = ["measure", self.reality, self.folder, self.trials, *["--exact"] * self.exact]
            run_sealed(*map(str, words))
        return self.desk.measure(rows, trial, times)

    def record(self, controllers: ArrayLike, trials: ArrayLike) -> list[Recording]:
        """Recordings of trials, see `FolderReality.record`."""
        return self.desk.record(np.asarray(controllers, float), trials)

    def tried(self) -> tuple[np.ndarray, np.ndarray]:
        """Controllers (n, n_c) that were measured so far, and their fitness (n,)."""
        controllers, fitness = list[list[float]](), list[float]()
        for path in sorted((self.folder / "used").glob("*.csv")):
            controllers += [row[1:] for row in _numbers(self.folder / "trials" / path.name)]
            times = sum(name.startswith("fitness") for name in path.read_text().partition("\n")[0].split(","))
            fitness += [row[times] for row in _numbers(path)]
        return np.array(controllers), np.array(fitness)


def _numbers(path: Path) -> list[list[float]]:
    lines = [line for line in path.read_text().splitlines()[1:] if not line.startswith("#")]
    return [[float(cell) for cell in row] for row in csv.reader(lines)]


def run_sealed(*words: str) -> None:
    """Run `sealed.py` in a process of its own.

    Raises:
      InputError: it refuses, or fails.
    """
    done = subprocess.run([sys.executable, SEALED, *words], capture_output=True, text=True)
    if done.returncode:
        raise InputError((done.stderr.strip() or f"{SEALED.name}: exit code {done.returncode}").splitlines()[-1])


@dataclass(frozen=True)
class Budget:
    """What every contestant may simulate.

    Attributes:
      controllers: population of a search for controllers.
      generations: its generations, in each round.
      rounds: times that the real robot is visited.
      draws: simulations of domain randomisation.
      ensemble: simulations for whose mean Back-to-Reality evolves controllers.
      simulations: population of a search for simulations.
      simulation_generations: its generations, in each round.
      jacobians: steps of a least-squares fit, in each round.
    """

    controllers: int = 48
    generations: int = 8
    rounds: int = 3
    draws: int = 8
    ensemble: int = 8
    simulations: int = 24
    simulation_generations: int = 15
    jacobians: int = 6


@dataclass(frozen=True)
class Task:
    """What a contestant gets.

    Attributes:
      robot: as it is believed to be; what is unknown of it has its nominal values.
      unknown: names of the parameters of S that are unknown, with their bounds in the robot's box.
      reality: the real robot.
      trials: trials that may be measured there.
      seed: of everything random.
      budget: of simulations.
    """

    robot: Robot
    unknown: tuple[str, ...]
    reality: Room
    trials: int
    seed: int
    budget: Budget


@dataclass(frozen=True)
class Answer:
    """What a contestant hands in.

    Attributes:
      controller: (n_c,) the controller that it would deploy.
      robot: its last simulator; None for none.
      simulations: (L, n_s) parameters of it, over which predictions are averaged.
      found: effects that it added to the simulator.
    """

    controller: np.ndarray
    robot: Robot | None = None
    simulations: np.ndarray | None = None
    found: tuple[str, ...] = ()


def predicted(robot: Robot, simulations: np.ndarray, controllers: np.ndarray) -> np.ndarray:
    """Fitness (M,) of controllers (M, n_c), the mean over simulations (L, n_s); NaN where one diverged."""
    found = btr.evaluate(robot, simulations, controllers, engine=engine_of(robot), fitness=robot.fitness)
    return found.fitness.mean(axis=0)


def engine_of(robot: Robot) -> Engine:
    """The engine of all contestants; a simulator of a robot's own counts as native."""
    return "lanes" if robot.simulator is None else "native"


def evolved(
    robot: Robot,
    simulations: np.ndarray,
    budget: Budget,
    generations: int,
    seed: list[int],
    genome: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Controllers evolved for the mean fitness in simulations, by the genetic algorithm that all contestants share.

    Args:
      robot: the robot.
      simulations: (L, n_s).
      budget: has the population.
      generations: number of generations.
      seed: of the search.
      genome: (bits,) to start from; None for random ones.

    Returns:
      (g, M, bits) genomes and (g, M) their fitness.
    """
    maximise = fitness_of(robot).maximise
    algorithm = GeneticAlgorithm(coded(robot), GAConfig(maximise=maximise, population=budget.controllers))
    state = algorithm.init(np.random.default_rng(seed), genome=genome)
    genomes, scores = [], []
    for _ in range(generations):
        asked, state = algorithm.ask(state)
        scores.append(predicted(robot, simulations, coded(robot).decode(asked)))
        genomes.append(asked)
        state = algorithm.tell(state, asked, scores[-1])
    return np.array(genomes), np.array(scores)


def coded(robot: Robot) -> btr.Box:
    """The box of controllers, with the bits of the search."""
    return robot.controller_box.with_bits(8)


def best_index(robot: Robot, fitness: np.ndarray) -> int:
    """Index of the best finite fitness."""
    maximise = fitness_of(robot).maximise
    return int(np.nanargmax(fitness) if maximise else np.nanargmin(fitness))
