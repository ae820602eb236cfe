"""Searches of the maps of `maps.py`: a hidden robot, trials of behaviours, CMA-ES for twelve lengths."""

from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

import numpy as np
from bench import Bench
from common import Config
from fig2_scans import evolve
from fig4_identification import Fig4Config, hidden, mutants_of_best
from identification import Search, away_from, cma_es
from units import Arrays, Journal, Step

from btr_mjx.errors import InputError
from btr_mjx.evaluation import EngineSettings, multiscale_fitness
from btr_mjx.optimise import cma_es as cma

Part = Literal["behaviours", "horizon", "marks", "diversity", "choice", "truth"]
"""The maps (a) to (f)."""

Choice = Literal["random", "fittest", "disagreement"]
"""How the next controllers to try in reality are chosen."""

ROUND = 3
"""Controllers tried between two searches."""

LATER_SIGMA = 0.03
"""First step size of a curriculum's later stages, as a share of each parameter's range."""


@dataclass(frozen=True, kw_only=True)
class MapsConfig(Config):
    """Settings of the maps."""

    parts: tuple[Part, ...] = get_args(Part)
    """Maps to compute; others can be added to a folder later."""
    horizon: float = 0.05
    """Last mark in (a), (c) and (d) [s]."""
    away: float = 0.25
    """How far every length is off at the start [m]."""
    members: int = 32
    """L of the searches."""
    search_generations: int = 120
    """Their generations."""
    behaviours: tuple[int, ...] = (3, 6, 15, 45)
    """Values of m in (a)."""
    noises: tuple[float, ...] = (0.0, 0.01, 0.05, 0.1)
    """Relative standard deviations of a measurement in (a)."""
    horizons: tuple[float, ...] = (0.025, 0.05, 0.1, 0.2)
    """Times of the last mark in (b) [s]."""
    horizon_noises: tuple[float, ...] = (0.0, 0.05)
    """Relative standard deviations of a measurement in (b)."""
    curriculum: tuple[float, ...] = (0.05, 0.1, 0.2)
    """Last marks of the curriculum in (b) [s]; each stage starts from what the one before found."""
    mark_counts: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of marks in (c)."""
    diversities: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5)
    """p_m of the mutants of one evolved controller that are tried in (d)."""
    pool: int = 60
    """Controllers to choose from in (e)."""
    choice_noise: float = 0.05
    """Relative standard deviation of a measurement in (e); with exact ones three trials identify all lengths."""
    believed: int = 16
    """Simulations whose disagreement counts in (e)."""
    truths: int = 10
    """Random robots in (f), one a seed of its own."""

    def check(self) -> None:
        """As `Config.check`."""
        super().check()
        if min(self.behaviours) < 2 or max(self.horizons) > self.duration or self.trials < ROUND or self.members < 4:
            raise InputError(
                f"behaviours {self.behaviours}, horizons {self.horizons}, trials {self.trials} and members "
                f"{self.members}: expected at least 2, at most {self.duration} s, at least {ROUND} and at least 4"
            )


@dataclass(frozen=True)
class Task:
    """A hidden robot and the settings of its identification.

    Attributes:
      config: the settings.
      bench: where behaviours are tried.
      journal: of the unit.
      truth: (12,) reality.
      seed: of the searches.
      reality: how reality is simulated; None for the same engine as the searches.
    """

    config: MapsConfig
    bench: Bench
    journal: Journal
    truth: np.ndarray
    seed: int
    reality: EngineSettings | None = None

    @property
    def share(self) -> float:
        """Length of a trial that ends at the last mark, in whole trials."""
        return self.bench.marks[-1] / self.bench.robot.duration

    def measure(self, controllers: np.ndarray, noise: float = 0.0) -> np.ndarray:
        """Try controllers in reality: fitness at the marks (m, K)."""
        count = len(controllers) * self.share
        marks = self.journal(lambda: self.bench.early(self.truth[None], controllers, self.reality)[0], count)
        return marks * (1 + noise * np.random.default_rng([self.seed, 6]).standard_normal(marks.shape))

    def find(
        self,
        start: np.ndarray,
        controllers: np.ndarray,
        measured: np.ndarray,
        number: int = 0,
        generations: int | None = None,
        sigma: float = cma.SIGMA,
    ) -> Search:
        """Search all lengths from a start; `number` seeds the search within the task."""

        def distance(simulations: np.ndarray) -> np.ndarray:
            count = len(simulations) * len(controllers) * self.share
            return self.journal(lambda: multiscale_fitness(self.bench.early(simulations, controllers), measured), count)

        settings, box = self.config, self.bench.robot.simulation_box
        seed = self.seed + 1000 * number
        most = generations or settings.search_generations
        return cma_es(distance, box, start, settings.members, most, seed, sigma)

    def result(self, search: Search) -> dict[str, float]:
        """Error and distance of what was found."""
        return {"error": float(search.error(self.truth)[-1]), "distance": float(np.nanmin(search.values))}


@dataclass(frozen=True)
class Point:
    """A point of a map.

    Attributes:
      m: behaviours tried.
      noise: relative standard deviation of a measurement.
      horizons: last marks [s]; several are a curriculum, whose stages share the generations. None for the usual one.
      marks: number of marks; None for the usual one.
      reality: see `Task`.
      p_m: behaviours are mutants of one evolved controller, by so many flips per bit; None for random ones.
    """

    m: int
    noise: float = 0.0
    horizons: tuple[float, ...] | None = None
    marks: int | None = None
    reality: EngineSettings | None = None
    p_m: float | None = None


def task_of(config: MapsConfig, seed: int, step: Step, journal: Journal) -> Task:
    """The task of a seed: Fig. 4's robot."""
    bench = Bench.of(config, step)
    return Task(config, bench, journal, hidden(bench), seed)


def random_controllers(task: Task, count: int) -> np.ndarray:
    """Diverse behaviours (count, n_c)."""
    return task.bench.robot.controller_box.sample(np.random.default_rng([task.seed, 5]), count)


def start_of(task: Task) -> np.ndarray:
    """Where searches of a task start (12,)."""
    return away_from(task.truth, task.bench.robot.simulation_box, task.config.away, task.seed)


def search_at(config: MapsConfig, point: Point, seed: int, step: Step, journal: Journal) -> Arrays:
    """One search."""
    config = replace(config, marks=point.marks or config.marks)
    task = replace(task_of(config, seed, step, journal), reality=point.reality)
    if point.p_m is None:
        controllers = random_controllers(task, point.m)
    else:
        own = Fig4Config(**{f.name: getattr(config, f.name) for f in fields(Config)} | {"trials": point.m})
        controllers = mutants_of_best(replace(own, p_m=point.p_m), task.bench, start_of(task), seed, journal)
    return searched(task, controllers, point.noise, point.horizons or (config.horizon,))


def other_truth(config: MapsConfig, seed: int, step: Step, journal: Journal) -> Arrays:
    """One search for a random robot."""
    task = task_of(config, seed, step, journal)
    drawn = task.bench.robot.simulation_box.sample(np.random.default_rng([seed, 8]))
    task = replace(task, truth=drawn)
    return searched(task, random_controllers(task, config.trials), 0.0, (config.horizon,))


def searched(task: Task, controllers: np.ndarray, noise: float, horizons: tuple[float, ...]) -> Arrays:
    """Try controllers in reality and search, stage by stage where there are several horizons."""
    start, found, sigma = start_of(task), {}, cma.SIGMA
    for number, horizon in enumerate(horizons):
        stage = replace(task, bench=task.bench.with_marks_until(horizon))
        generations = task.config.search_generations // len(horizons)
        search = stage.find(start, controllers, stage.measure(controllers, noise), number, generations, sigma)
        start, found, sigma = search.best[-1], stage.result(search), LATER_SIGMA
    return {name: np.array(value) for name, value in (found | {"m": len(controllers)}).items()}


def disagreement(task: Task, search: Search, pool: np.ndarray) -> np.ndarray:
    """Disagreement on controllers among simulations that agree with the trials about as well as the best one.

    Args:
      task: the task.
      search: the last search; simulations within twice its least distance count.
      pool: (P, n_c).

    Returns:
      (P,) standard deviation of the fitness over simulations, in units of its spread over controllers, mean of the
      marks.
    """
    values = np.where(np.isfinite(search.values), search.values, np.inf).ravel()
    parameters = search.parameters.reshape(len(values), -1)
    near = np.flatnonzero(values <= 2 * values.min())
    rng = np.random.default_rng([task.seed, 7, len(near)])
    chosen = rng.choice(near, min(len(near), task.config.believed), replace=False)
    count = len(chosen) * len(pool) * task.share
    fitness = task.journal(lambda: task.bench.early(parameters[chosen], pool), count)
    spread = np.nanmean(np.nanstd(fitness, axis=1), axis=0)
    return np.nan_to_num((np.nanstd(fitness, axis=0) / np.where(spread > 0, spread, 1.0)).mean(axis=-1))


def choose(config: MapsConfig, choice: Choice, seed: int, step: Step, journal: Journal) -> Arrays:
    """Try controllers three at a time, search after each three."""
    task = task_of(config, seed, step, journal)
    start = start_of(task)
    pool = random_controllers(task, max(config.pool, config.trials))
    if choice == "fittest":
        cost = config.population * config.generations
        genomes = journal(lambda: evolve(task.bench, config, start, seed)[0], cost)
        pool = task.bench.robot.controller_box.with_bits(config.search.bits).decode(genomes)
    left = list(range(len(pool)))
    tried: list[int] = []
    rows: list[dict[str, float]] = []
    search: Search | None = None
    while len(tried) + ROUND <= min(config.trials, len(pool)):
        if choice == "disagreement" and search is not None:
            order = np.argsort(-disagreement(task, search, pool[left]), kind="stable")
            left = [left[i] for i in order]
        tried += left[:ROUND]
        left = left[ROUND:]
        controllers = pool[tried]
        measured = task.measure(controllers, config.choice_noise)
        # Later searches start from the result of the previous one.
        generations = config.search_generations // (2 if rows else 1)
        search = task.find(start, controllers, measured, len(rows), generations)
        start = search.best[-1]
        rows.append(task.result(search) | {"m": float(len(tried))})
    return {name: np.array([row[name] for row in rows]) for name in ("error", "distance", "m")}
