"""Fig. 2: `uv run python experiments/fig2_scans.py`. Reality gap, and Delta_fitness as a guide to the true simulation.

(a) Controllers evolve in a simulation whose left rear tibia is short (bl_14 = 0.4 m); the m = 15 best are tried in a
reality where it is long (1.6 m). (b) delta_k of these behaviours and their mean, Delta_fitness, over all of bl_14.
(c) The same for the right rear femur: evolved at its default of bl_5 = 0.64 m, reality 0.88 m.

The run folder holds seed-0.npz, ...: per parameter P the grid (G,), which includes the truth, the controllers (m, 36),
their fitness at the marks and at T_e along the grid P/fitness (G, m, K + 1), in reality P/real and in s_0 P/start
(m, K + 1) [m/s], and the scores of their evolution P/scores (g, M).
fig2.json holds the statistics over seeds, fig2.png the figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import Bench
from common import TINY, Config, command
from curves import curve_numbers, intervals, multiscale_curve, plateau_sensitivity
from drawing import delta_panel, figure_of, letter, save, white_legend
from matplotlib.axes import Axes
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx import scan
from btr_mjx.backtoreality import evolve_controllers, select_transferable
from btr_mjx.evaluation import delta_of
from btr_mjx.robots import PAPER_STARTS
from btr_mjx.runs import write_json

TRUTHS = {"bl_14": 1.6, "bl_5": 0.88}
"""The paper's realities [m]."""

PLATEAUS = {"bl_14": (0.4, 1.1), "bl_5": (1.3, 1.6)}
"""Ranges in which the paper finds no influence of the parameter [m]: the foot does not reach the ground."""


@dataclass(frozen=True, kw_only=True)
class Fig2Config(Config):
    """Settings of Fig. 2."""

    grid: int = 49
    """Points over the parameter's range; the truth is added where it is not among them."""


PRESETS = {
    "quick": Fig2Config(seeds=3, grid=25),
    "paper": Fig2Config(preset="paper", seeds=10),
    "tiny": Fig2Config(preset="tiny", **TINY, grid=5),
}
"""Settings by preset."""


def grid_with(low: float, high: float, points: int, truth: float) -> np.ndarray:
    """An even grid, and the truth: (points,) or (points + 1,)."""
    even = np.linspace(low, high, points)
    even = np.where(np.abs(even - truth) < 1e-9, truth, even)  # 1.6 as the end of the grid is 1.6 as the truth
    return np.union1d(even, [truth])


def line_of(bench: Bench, parameter: str, points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A scan: values of the parameter (G,), the simulations along it (G, n_s) and reality (1, n_s)."""
    box, truth = bench.robot.simulation_box, TRUTHS[parameter]
    index = box.index(parameter)
    grid = grid_with(box.low[index], box.high[index], points, truth)
    return grid, scan.along(bench.robot, parameter, grid), scan.along(bench.robot, parameter, [truth])


def evolve(bench: Bench, config: Config, simulation: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Step 1: genomes (m, bits) of the best controllers, and the scores (g, M) of the search."""
    genomes, scores = evolve_controllers(
        bench.robot, simulation, config.search, seed=seed, engine=bench.engine, progress=bench.step
    )
    return select_transferable(genomes, scores, config.trials, maximise=True)[0], scores


def work(config: Fig2Config, seed: int, step: Step, journal: Journal) -> Arrays:
    """All simulations of one seed."""
    bench = Bench.of(config, step)
    arrays: Arrays = {}
    for parameter, truth in TRUTHS.items():
        grid, line, reality = line_of(bench, parameter, config.grid)
        start = scan.along(bench.robot, parameter, [PAPER_STARTS[parameter]])
        genomes, scores = evolve(bench, config, start[0], seed)
        controllers = bench.robot.controller_box.with_bits(config.search.bits).decode(genomes)
        # Reality is evaluated separately, so that zero distance at the truth is a result and not an assumption.
        real = bench.whole(reality, controllers)[0]
        fitness = bench.whole(np.concatenate([start, line]), controllers)
        values = {"grid": grid, "truth": truth, "controllers": controllers, "scores": scores}
        values |= {"real": real, "start": fitness[0], "fitness": fitness[1:]}
        arrays |= {f"{parameter}/{name}": np.asarray(value) for name, value in values.items()}
    return arrays


def units(config: Fig2Config) -> list[Unit]:
    """One unit per seed."""
    trials = len(TRUTHS) * (config.population * config.generations + config.trials * (config.grid + 3))
    return [Unit(f"seed-{seed}", trials, partial(work, config, seed)) for seed in range(config.seeds)]


def compute(config: Fig2Config) -> int:
    """Compute the seeds that are missing; returns how many there were."""
    return run_units(config, units(config), "fig2")


def deltas(arrays: Arrays, parameter: str) -> np.ndarray:
    """delta_k along the grid (G, m)."""
    return delta_of(arrays[f"{parameter}/fitness"][..., -1], arrays[f"{parameter}/real"][..., -1])


def summarise(seeds: Sequence[Arrays]) -> dict[str, Any]:
    """The numbers of every seed, and their intervals.

    Returns:
      For each parameter: at_truth, the largest delta_k there; the least Delta_fitness elsewhere; the curve's numbers of
      Delta_fitness and of the multiscale distance; felt, see `curves.plateau_sensitivity`. For bl_14 also the fitness
      gained in the search and lost in reality [m/s].
    """
    rows: dict[str, list[dict[str, float]]] = {parameter: [] for parameter in TRUTHS}
    for arrays in seeds:
        for parameter, truth in TRUTHS.items():
            part = {key.partition("/")[2]: value for key, value in arrays.items() if key.startswith(parameter + "/")}
            grid, each = part["grid"], deltas(arrays, parameter)
            at = grid == truth
            row = {
                "at_truth": float(each[at].max()),
                "mean_at_truth": float(each[at].mean()),
                "elsewhere": float(np.nanmin(each.mean(axis=1)[~at])),
                **curve_numbers(grid, each.mean(axis=1), truth),
                **curve_numbers(grid, multiscale_curve(part["fitness"], part["real"]), truth, "multiscale "),
                "felt": plateau_sensitivity(grid, part["fitness"][..., -1], *PLATEAUS[parameter]),
            }
            scores, start, real = part["scores"], part["start"][:, -1], part["real"][:, -1]
            row |= {
                "gained": float(np.nanmax(scores[-1]) - np.nanmax(scores[0])),
                "lost": float(np.nanmean(start - real)),
                "gap": float(np.nanmean(np.abs(start - real))),
            }
            rows[parameter].append(row)
    return {parameter: {"seeds": values, "intervals": intervals(values)} for parameter, values in rows.items()}


def search_panel(axes: Axes, arrays: Arrays) -> None:
    """Fitness over the generations in s_0, then the transferred controllers in reality."""
    scores, start = arrays["bl_14/scores"], arrays["bl_14/start"][:, -1]
    real = arrays["bl_14/real"][:, -1]
    x = 1 + np.arange(len(scores))
    axes.fill_between(
        x, *np.nanquantile(scores, [0.1, 0.9], axis=1), color="0.88", linewidth=0, label="middle 80 % of $M$"
    )
    axes.plot(x, np.nanmean(scores, axis=1), "--", color="0.35", linewidth=1.1, label="mean")
    axes.plot(x, np.nanmax(scores, axis=1), "k.-", label="best")
    places = len(scores) + 1.2 + np.linspace(0, 0.3 * len(scores), len(real))
    axes.vlines(places, start, real, color="0.7", linewidth=0.7)
    axes.plot(places, start, "ko", fillstyle="none", markersize=3.2, linestyle="none", label="tried, in $s_0$")
    axes.plot(places, real, "kD", markersize=3, linestyle="none", label="tried, in reality")
    top = 1.55 * np.nanmax(scores)
    axes.set(xlabel="generation", ylabel="fitness [m/s]", xlim=(0.5, None), ylim=(0, top))
    axes.set_xticks([tick for tick in axes.get_xticks() if 1 <= tick <= len(scores) and tick == int(tick)])
    axes.legend(loc="upper center", fontsize=7, ncols=2)


def draw(folder: Path) -> list[Path]:
    """fig2.json and fig2.png from the saved seeds; the figure shows seed 0."""
    seeds = load(folder, "seed")
    summary = summarise(seeds)
    write_json(folder / "fig2.json", summary)
    with figure_of(9.6, 3.1) as figure:
        panels = figure.subplots(1, 3, width_ratios=[0.9, 1, 1])
        search_panel(panels[0], seeds[0])
        letter(panels[0], "a", "evolution in $s_0$, then reality")
        for axes, name, parameter in zip(panels[1:], "bc", TRUTHS, strict=True):
            numbers = summary[parameter]["intervals"]["rho"]
            curves = [deltas(arrays, parameter).mean(axis=1) for arrays in seeds[1:]]
            delta_panel(axes, seeds[0][f"{parameter}/grid"], deltas(seeds[0], parameter), TRUTHS[parameter], curves)
            axes.axvspan(*PLATEAUS[parameter], ymax=0.025, color="0.75", linewidth=0)
            axes.set(xlabel=f"{parameter} [m]")
            letter(axes, name, rf"median $\rho$ of {len(seeds)} seeds {numbers['median']:.2f}")
            if name == "b":
                white_legend(axes, loc="best")
        return [folder / "fig2.json", save(figure, folder / "fig2.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "fig2_scans", argv, compute, draw)


if __name__ == "__main__":
    main()
