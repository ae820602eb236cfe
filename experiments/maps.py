"""How many trials does a robot need to know itself: `uv run python experiments/maps.py`.

Twelve unknown lengths, CMA-ES on `distances.multiscale_fitness`, error of the simulation found:
(a) against the number m of random controllers tried in reality, for several levels of noise on every measurement, and
for a reality that is native MuJoCo at another time step and integrator;
(b) against the last of the eight marks, m = 15, with exact and with noisy measurements;
(c) against m where trials are chosen three at a time: at random, the fittest of an evolution in s_0 (the paper's
choice), or those on which simulations that explain the trials so far disagree most;
(d) for random truths, m = 15.

The run folder holds one file per search and seed, NAME-0.npz, ...: error [m] of the best simulation, distance, m, and
for choices one entry a round. maps.json holds medians and intervals over seeds, maps.png the figure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from bench import Bench
from common import TINY, Config, command
from curves import interval
from drawing import figure_of, letter, save
from fig2_scans import evolve
from fig4_identification import OTHER_PHYSICS, hidden
from identification import Search, away_from, cma_es
from matplotlib.axes import Axes
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx.behaviour import EngineSettings
from btr_mjx.distances import multiscale_fitness
from btr_mjx.errors import InputError
from btr_mjx.files import write_json

Part = Literal["behaviours", "horizon", "choice", "truth"]
"""The maps (a) to (d)."""

Choice = Literal["random", "fittest", "disagreement"]
"""How the next controllers to try in reality are chosen."""

ROUND = 3
"""Controllers tried between two searches."""


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
    truths: int = 10
    """Random robots in (d), one a seed of its own."""
    pool: int = 60
    """Controllers to choose from in (c)."""
    believed: int = 16
    """Simulations whose disagreement counts in (c)."""

    def check(self) -> None:
        """As `Config.check`."""
        super().check()
        if min(self.behaviours) < 2 or max(self.horizons) > self.duration or self.trials < ROUND or self.members < 4:
            raise InputError(
                f"behaviours {self.behaviours}, horizons {self.horizons}, trials {self.trials} and members "
                f"{self.members}: expected at least 2, at most {self.duration} s, at least {ROUND} and at least 4"
            )


PRESETS = {
    "quick": MapsConfig(
        seeds=1, truths=2, noises=(0.0, 0.05), search_generations=60, horizons=(0.05, 0.2), behaviours=(3, 15),
    ),
    "paper": MapsConfig(preset="paper", seeds=5),
    "tiny": MapsConfig(
        preset="tiny", **TINY, members=6, search_generations=2, behaviours=(2, 4), horizons=(0.02, 0.05), pool=5,
        believed=3, truths=2, noises=(0.0, 0.05),
    ),
}  # fmt: skip
"""Settings by preset."""


@dataclass(frozen=True)
class Task:
    """A hidden robot and a way to look for it.

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

    def find(self, start: np.ndarray, controllers: np.ndarray, measured: np.ndarray, number: int = 0) -> Search:
        """Search all lengths from a start."""

        def distance(simulations: np.ndarray) -> np.ndarray:
            count = len(simulations) * len(controllers) * self.share
            return self.journal(lambda: multiscale_fitness(self.bench.early(simulations, controllers), measured), count)

        settings, box = self.config, self.bench.robot.simulation_box
        seed = self.seed + 1000 * number
        return cma_es(distance, box, start, settings.members, settings.search_generations, seed)

    def result(self, search: Search) -> dict[str, float]:
        """Error and distance of what was found."""
        return {"error": float(search.error(self.truth)[-1]), "distance": float(np.nanmin(search.values))}


def task_of(config: MapsConfig, seed: int, step: Step, journal: Journal, horizon: float | None = None) -> Task:
    """The task of a seed: Fig. 4's robot."""
    bench = Bench.of(replace(config, horizon=horizon or config.horizon), step)
    return Task(config, bench, journal, hidden(bench), seed)


def random_controllers(task: Task, count: int) -> np.ndarray:
    """Diverse behaviours (count, n_c)."""
    return task.bench.robot.controller_box.sample(np.random.default_rng([task.seed, 5]), count)


def once(
    config: MapsConfig,
    m: int,
    noise: float,
    horizon: float | None,
    reality: EngineSettings | None,
    seed: int,
    step: Step,
    journal: Journal,
) -> Arrays:
    """One search with m random controllers."""
    task = replace(task_of(config, seed, step, journal, horizon), reality=reality)
    return _searched(task, m, noise)


def other_truth(config: MapsConfig, seed: int, step: Step, journal: Journal) -> Arrays:
    """One search for a random robot."""
    task = task_of(config, seed, step, journal)
    drawn = task.bench.robot.simulation_box.sample(np.random.default_rng([seed, 8]))
    return _searched(replace(task, truth=drawn), config.trials, 0.0)


def _searched(task: Task, m: int, noise: float) -> Arrays:
    controllers = random_controllers(task, m)
    measured = task.measure(controllers, noise)
    start = away_from(task.truth, task.bench.robot.simulation_box, task.config.away, task.seed)
    found = task.result(task.find(start, controllers, measured))
    return {name: np.array(value) for name, value in (found | {"m": m}).items()}


def disagreement(task: Task, search: Search, pool: np.ndarray) -> np.ndarray:
    """How much simulations that explain the trials about as well as the best one disagree on controllers.

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
    start = away_from(task.truth, task.bench.robot.simulation_box, config.away, seed)
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
        search = task.find(start, controllers, task.measure(controllers), len(rows))
        start = search.best[-1]
        rows.append(task.result(search) | {"m": float(len(tried))})
    return {name: np.array([row[name] for row in rows]) for name in ("error", "distance", "m")}


def units(config: MapsConfig) -> list[Unit]:
    """One unit per point of a map and seed."""
    share, searched = config.horizon / config.duration, config.members * config.search_generations
    rounds = range(ROUND, config.trials + 1, ROUND)
    found = []
    for seed in range(config.seeds):

        def add(name: str, trials: float, work: Callable[..., Arrays], *given: Any, seed: int = seed) -> None:
            found.append(Unit(f"{name}-{seed}", trials, partial(work, config, *given, seed)))

        for m in config.behaviours if "behaviours" in config.parts else ():
            for noise in config.noises:
                add(f"m{m}-noise{100 * noise:g}", (searched + 1) * m * share, once, m, noise, None, None)
            add(f"m{m}-native", (searched + 1) * m * share, once, m, 0.0, None, OTHER_PHYSICS)
        for horizon in config.horizons if "horizon" in config.parts else ():
            cost = (searched + 1) * config.trials * horizon / config.duration
            for noise in config.horizon_noises:
                add(f"horizon{1000 * horizon:g}-{100 * noise:g}", cost, once, config.trials, noise, horizon, None)
        for choice in get_args(Choice) if "choice" in config.parts else ():
            cost = (searched + 1) * sum(rounds) * share
            if choice == "fittest":
                cost += config.population * config.generations
            if choice == "disagreement":
                cost += (len(rounds) - 1) * config.believed * config.pool * share
            add(f"choice-{choice}", cost, choose, choice)
    for seed in range(config.truths if "truth" in config.parts else 0):
        cost = (searched + 1) * config.trials * share
        found.append(Unit(f"truth-{seed}", cost, partial(other_truth, config, seed)))
    return found


def compute(config: MapsConfig) -> int:
    """Compute the points that are missing; returns how many there were."""
    return run_units(config, units(config), "maps")


def summarise(folder: Path) -> dict[str, Any]:
    """Median error [m] with its interval over seeds, by the name of the map's point; per round for choices."""
    names = sorted({path.stem.rpartition("-")[0] for path in folder.glob("*.npz") if not path.stem.startswith("check")})
    result = {}
    for name in names:
        found = load(folder, name)
        errors, m = np.array([np.atleast_1d(a["error"]) for a in found]), np.atleast_1d(found[0]["m"])
        result[name] = [
            {"m": float(m[i]), **interval(errors[:, i], np.median), "values": errors[:, i]} for i in range(len(m))
        ]
    return result


def error_line(axes: Axes, x: Sequence[float], rows: Sequence[dict[str, Any]], label: str, **look: Any) -> None:
    """Medians with intervals."""
    middle = np.array([row["estimate"] for row in rows])
    ends = np.array([[row["low"], row["high"]] for row in rows]).T
    error = np.abs(np.where(np.isfinite(ends), ends, middle) - middle)
    axes.errorbar(x, middle, error, color="black", lw=1, capsize=2, label=label, **look)


def fill(panels: Sequence[Axes], summary: dict[str, Any]) -> None:
    """All panels; those whose map was not computed stay empty."""
    noises = sorted({float(name.partition("noise")[2]) for name in summary if "-noise" in name})
    looks = [("o", "-", "full"), ("s", "--", "none"), ("^", ":", "full"), ("D", "-.", "none"), ("v", "-", "none")]
    kinds = [(f"-noise{noise:g}", f"noise {noise:g} %") for noise in noises] + [("-native", "other physics")]
    for (end, label), (marker, line, fillstyle) in zip(kinds, looks, strict=False):
        rows = sorted((v[0] for k, v in summary.items() if k.endswith(end)), key=lambda row: row["m"])
        m = [row["m"] for row in rows]
        if rows:
            error_line(panels[0], m, rows, label, marker=marker, linestyle=line, fillstyle=fillstyle)
            panels[0].set(xscale="log", xticks=m, xticklabels=[f"{i:g}" for i in m])
    horizons = {k.removeprefix("horizon").partition("-")[::2]: v[0] for k, v in summary.items() if k[:7] == "horizon"}
    for noise, (marker, line, fillstyle) in zip(sorted({float(n) for _, n in horizons}), looks, strict=False):
        at = sorted(
            ((float(time) / 1000, row) for (time, n), row in horizons.items() if float(n) == noise),
            key=lambda pair: pair[0],
        )
        times, rows = [time for time, _ in at], [row for _, row in at]
        error_line(panels[1], times, rows, f"noise {noise:g} %", marker=marker, linestyle=line, fillstyle=fillstyle)
        panels[1].set(xscale="log", xticks=times, xticklabels=[f"{time:g}" for time in times])
        panels[1].minorticks_off()
    for choice, (marker, line, fillstyle) in zip(get_args(Choice), looks[1::-1] + looks[2:], strict=False):
        rows = summary.get(f"choice-{choice}", [])
        m = [row["m"] for row in rows]
        if rows:
            error_line(panels[2], m, rows, choice, marker=marker, linestyle=line, fillstyle=fillstyle)
    values = np.sort(summary["truth"][0]["values"]) if "truth" in summary else np.zeros(0)
    if len(values):
        panels[3].plot(values, (np.arange(len(values)) + 1) / len(values), "k.-", drawstyle="steps-post")
        panels[3].set(xscale="log")
    panels[3].set(ylim=(0, 1.05), ylabel="share of truths", xlabel="mean error of lengths [m]")
    titles = ("behaviours", "horizon", "choice", "random truths")
    below = ("$m$", "last mark [s]", "trials in reality")
    for axes, name, text in zip(panels, "abcd", titles, strict=True):
        letter(axes, name, text)
    for axes, words in zip(panels, below, strict=False):
        axes.set(xlabel=words, ylabel="mean error of lengths [m]")
        if axes.lines:
            axes.set(yscale="log")
    panels[0].minorticks_off()
    for axes in panels[:3]:
        if axes.lines:
            axes.legend(fontsize=7)


def draw(folder: Path) -> list[Path]:
    """maps.json and maps.png from the saved searches."""
    summary = summarise(folder)
    if not summary:
        raise InputError(f"{folder} holds no results: nothing was computed yet; run without --draw-only")
    write_json(folder / "maps.json", summary)
    with figure_of(9.6, 2.9) as figure:
        panels: Any = figure.subplots(1, 4)
        fill(panels, summary)
        return [folder / "maps.json", save(figure, folder / "maps.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "maps", argv, compute, draw)


if __name__ == "__main__":
    main()
