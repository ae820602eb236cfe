"""Fig. 5: `uv run python experiments/fig5_metrics.py`. For how long a trial are sensor distances informative?

Over bl_5, reality 0.88 m, the m = 15 behaviours of Fig. 2c: (a) the rolling mean metric of Bongard and Lipson for
headers of 1.25 % .. 100 % of T_e and the Euclidean metric of whole trials, (b) Delta_fitness and the multiscale
distance, each divided by its largest value; means over the behaviours. (c) How well they order simulations by their
error: means over 15 behaviours, single behaviours, and single behaviours where trials take three times as long.

Sensors: position and orientation of the base, its velocities, joint angles, joint velocities, and the normal contact
force at each foot, each kind scaled by its spread in reality. Series are sampled 320 times a trial, every 5.3 ms; the
rolling mean is over 1.25 % of T_e.

The run folder holds seed-0.npz, ... and, for the longer trials, long-0.npz, ...: grid (G,), headers (H,) as shares of
the trial, rolling (H, G, m), euclidean (G, m), fitness (G, m, K + 1) and real (m, K + 1) as in Fig. 2. fig5.json holds
the statistics over seeds, fig5.png the figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import Bench
from common import TINY, Config, command
from curves import curve_numbers, interval, multiscale_curve
from drawing import figure_of, letter, save, shades, truth_line, white_legend
from fig2_scans import TRUTHS, evolve, line_of
from foot_forces import foot_bodies, foot_forces
from matplotlib.axes import Axes
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx import scan
from btr_mjx.errors import InputError
from btr_mjx.evaluation import (
    FITNESS_FUNCTIONS,
    Outcome,
    delta_of,
    evaluate,
    fitness_at_marks,
    metrics,
)
from btr_mjx.models import base_address, base_model
from btr_mjx.robots import PAPER_STARTS, Robot
from btr_mjx.runs import write_json

PARAMETER = "bl_5"
TRUTH = TRUTHS[PARAMETER]
HEADERS = (0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Headers as shares of T_e, the paper's shortest and longest and seven between."""


LONGER = 3
"""How many times as long the longer trials take."""


@dataclass(frozen=True, kw_only=True)
class Fig5Config(Config):
    """Settings of Fig. 5."""

    grid: int = 49
    """Points over the parameter's range; the truth is added where it is not among them."""
    samples: int = 320
    """Samples per trial."""

    def check(self) -> None:
        """As `Config.check`."""
        super().check()
        if self.samples < 1 / HEADERS[0]:
            raise InputError(
                f"samples: got {self.samples}, expected at least {1 / HEADERS[0]:.0f} for a header of 1.25 %"
            )


PRESETS = {
    "quick": Fig5Config(seeds=3, grid=25),
    "paper": Fig5Config(preset="paper", seeds=10),
    "tiny": Fig5Config(preset="tiny", **TINY, grid=5, samples=80),
}
"""Settings by preset."""


def sensors(robot: Robot, simulations: np.ndarray, controllers: np.ndarray, outcome: Outcome) -> np.ndarray:
    """Sensor series (L, m, N, n_q + n_v + feet): positions and velocities of everything, contact forces at the feet."""
    assert outcome.qpos is not None
    assert outcome.qvel is not None
    forces = foot_forces(robot, simulations, controllers, outcome)
    return np.concatenate([outcome.qpos, outcome.qvel, forces], axis=-1)


def kinds(robot: Robot) -> list[str]:
    """Kind of every sensor; sensors of a kind share their scale."""
    address, model = base_address(robot), base_model(robot)
    n_q = model.nq
    names = ["joint angle"] * n_q + ["joint velocity"] * model.nv + ["foot force"] * len(foot_bodies(model))
    if address is not None:
        q, v = address[0], n_q + address[1]
        names[q : q + 7] = ["base position"] * 3 + ["base orientation"] * 4
        names[v : v + 6] = ["base velocity"] * 3 + ["base rotation"] * 3
    return names


def work(config: Fig5Config, longer: int, seed: int, step: Step, journal: Journal) -> Arrays:
    """All simulations of one seed, in trials `longer` times as long."""
    bench = Bench.of(config, step)
    grid, line, reality = line_of(bench, PARAMETER, config.grid)
    start = scan.along(bench.robot, PARAMETER, [PAPER_STARTS[PARAMETER]])[0]
    genomes = journal(lambda: evolve(bench, config, start, seed)[0], config.population * config.generations)
    controllers = bench.robot.controller_box.with_bits(config.search.bits).decode(genomes)
    duration = longer * config.duration
    times = duration * np.arange(1, config.samples + 1) / config.samples
    simulations = np.concatenate([reality, line])
    trials = evaluate(
        replace(bench.robot, duration=duration),
        simulations,
        controllers,
        engine=bench.engine,
        times=times,
        states=True,
        progress=lambda pairs: step(longer * pairs),
    )
    series = sensors(bench.robot, simulations, controllers, trials.outcome)
    series = np.where(trials.diverged[..., None, None], np.nan, series)
    scale = metrics.sensor_scale(series[0], kinds(bench.robot))
    headers = [max(1, round(share * config.samples)) for share in HEADERS]
    window = max(1, round(HEADERS[0] * config.samples))
    # One simulation at a time, to limit memory.
    rolling = [metrics.rolling_mean_metric(series[0], row, headers, window, scale) for row in series[1:]]
    euclidean = [metrics.euclidean_metric(series[0], row, scale=scale) for row in series[1:]]
    at = np.append(np.searchsorted(times[:-1], np.array(config.mark_times) - 1e-9), config.samples - 1)
    fitness = fitness_at_marks(trials.outcome, FITNESS_FUNCTIONS["distance"])[..., at]
    fitness = np.where(trials.diverged[..., None], np.nan, fitness)
    return {
        "grid": grid,
        "headers": np.array(HEADERS),
        "rolling": np.moveaxis(np.array(rolling), -1, 0),
        "euclidean": np.array(euclidean),
        "fitness": fitness[1:],
        "real": fitness[0],
    }


def units(config: Fig5Config) -> list[Unit]:
    """Two units per seed: trials of T_e, and longer ones."""
    evolved, scanned = config.population * config.generations, config.trials * (config.grid + 2)
    return [
        Unit(f"{name}-{seed}", evolved + longer * scanned, partial(work, config, longer, seed))
        for name, longer in (("seed", 1), ("long", LONGER))
        for seed in range(config.seeds)
    ]


def compute(config: Fig5Config) -> int:
    """Compute the seeds that are missing; returns how many there were."""
    return run_units(config, units(config), "fig5")


def curves_of(arrays: Arrays) -> dict[str, np.ndarray]:
    """Every distance over the grid, means over behaviours (G,), by name; rolling means by header, "1.25 %"."""
    single = single_curves(arrays)
    multiscale = multiscale_curve(arrays["fitness"], arrays["real"])
    return {name: curves.mean(axis=0) for name, curves in single.items()} | {"multiscale": multiscale}


def single_curves(arrays: Arrays) -> dict[str, np.ndarray]:
    """The same of every behaviour (m, G); of Delta_fitness that is delta_k. The multiscale distance needs several."""
    rolling = {percent(share): curves.T for share, curves in zip(arrays["headers"], arrays["rolling"], strict=True)}
    delta_k = delta_of(arrays["fitness"][..., -1], arrays["real"][:, -1])
    return {**rolling, "euclidean": arrays["euclidean"].T, "delta_fitness": delta_k.T}


def percent(share: float) -> str:
    """1.25 %."""
    return f"{100 * share:g} %"


def summarise(seeds: Sequence[Arrays]) -> dict[str, Any]:
    """Numbers of every distance over all of the parameter's range, with intervals and the seeds' values.

    Returns:
      distances: by name, see `curves.curve_numbers`, of the means over behaviours; single: means of the numbers of
      single behaviours; like_euclidean: per header, Pearson's r between its curve and the Euclidean metric's.
    """
    grid, together = seeds[0]["grid"], [curves_of(arrays) for arrays in seeds]
    result: dict[str, Any] = {}
    for kind, each in (("distances", together), ("single", [single_curves(arrays) for arrays in seeds])):
        result[kind] = {}
        for name in each[0]:
            rows = [curve_numbers(grid, curves[name], TRUTH) for curves in each]
            result[kind][name] = {
                key: {**interval(values), "values": values}
                for key in rows[0]
                for values in [[row[key] for row in rows]]
            }
    result["like_euclidean"] = {}
    for share in seeds[0]["headers"]:
        values = [float(np.corrcoef(each[percent(share)], each["euclidean"])[0, 1]) for each in together]
        result["like_euclidean"][percent(share)] = {**interval(values), "values": values}
    return result


def curves_panel(axes: Axes, arrays: Arrays) -> None:
    """The sensor metrics over the grid, darker for longer headers, each relative to its largest value."""
    curves, headers = curves_of(arrays), arrays["headers"]
    for share, grey in zip(headers, shades(len(headers), 0.8), strict=True):
        curve = curves[percent(share)]
        axes.plot(arrays["grid"], curve / np.nanmax(curve), color=grey, linewidth=1.2, label=percent(share))
    whole = curves["euclidean"]
    axes.plot(arrays["grid"], whole / np.nanmax(whole), "k--", linewidth=1.6, label="Euclidean")
    truth_line(axes, TRUTH)
    axes.set(xlabel=f"{PARAMETER} [m]", ylabel="metric / its maximum", ylim=(0, 1.42))
    white_legend(axes, ncols=4, loc="upper center", columnspacing=1.0, handlelength=1.6)


def fitness_panel(axes: Axes, seeds: Sequence[Arrays]) -> None:
    """Delta_fitness and the multiscale distance, thick for seed 0 and thin for the others."""
    looks = (
        ("delta_fitness", r"$\Delta_{fitness}$, full $T_e$", "black", "-"),
        ("multiscale", "multiscale", "0.5", "--"),
    )
    for number, arrays in enumerate(seeds):
        curves = curves_of(arrays)
        for name, label, color, line in looks:
            curve = curves[name] / np.nanmax(curves[name])
            width, words = (0.5, None) if number else (2.0, label)
            axes.plot(arrays["grid"], curve, color=color, linestyle=line, linewidth=width, label=words)
    truth_line(axes, TRUTH)
    axes.set(xlabel=f"{PARAMETER} [m]", ylabel="distance / its maximum", ylim=(0, 1.3))
    white_legend(axes, ncols=2, loc="upper center")


def header_panel(axes: Axes, summary: dict[str, Any], headers: np.ndarray) -> None:
    """Order against the header, with the other distances as levels."""
    together, single, longer = summary["distances"], summary["single"], summary["long"]["single"]
    series = (
        (together, "o", "full", "-", "rolling mean, $m$ together"),
        (single, "s", "none", "--", "rolling mean, one behaviour"),
        (longer, "^", "none", ":", f"the same, {LONGER} $T_e$"),
    )
    for numbers, marker, fillstyle, line, label in series:
        rows = [numbers[percent(share)]["monotonicity"] for share in headers]
        middle = np.array([row["estimate"] for row in rows])
        ends = np.array([[row["low"], row["high"]] for row in rows]).T
        error = np.abs(np.where(np.isfinite(ends), ends, middle) - middle)
        look: dict[str, Any] = {"marker": marker, "fillstyle": fillstyle, "linestyle": line}
        axes.errorbar(100 * headers, middle, error, color="black", lw=1, capsize=2, label=label, **look)
    levels = (
        (together["delta_fitness"], "-", r"$\Delta_{fitness}$, $m$ together"),
        (single["delta_fitness"], "--", r"$\delta_k$, one behaviour"),
        (together["multiscale"], ":", "multiscale, $m$ together"),
    )
    for numbers, line, label in levels:
        axes.axhline(numbers["monotonicity"]["estimate"], color="0.55", linestyle=line, linewidth=1.2, label=label)
    axes.set(xscale="log", xlabel="header [% of the trial]", ylabel="share of neighbours in order")
    low = axes.get_ylim()[0]
    axes.set_ylim(low - 0.9 * (1 - low), 1 + 0.03 * (1 - low))
    axes.set_xticks([1.25, 5, 20, 100], ["1.25", "5", "20", "100"])
    axes.minorticks_off()
    axes.legend(fontsize=6.5, loc="lower left")


def draw(folder: Path) -> list[Path]:
    """fig5.json and fig5.png from the saved seeds; (a) shows seed 0."""
    seeds = load(folder, "seed")
    summary = {**summarise(seeds), "long": summarise(load(folder, "long"))}
    write_json(folder / "fig5.json", summary)
    with figure_of(9.6, 3.3) as figure:
        panels: Any = figure.subplots(1, 3, width_ratios=[1.25, 1, 1.1])
        curves_panel(panels[0], seeds[0])
        letter(panels[0], "a", "rolling mean metric by header")
        fitness_panel(panels[1], seeds)
        letter(panels[1], "b", "by fitness")
        header_panel(panels[2], summary, seeds[0]["headers"])
        letter(panels[2], "c", f"order by error, seeds: {len(seeds)}")
        return [folder / "fig5.json", save(figure, folder / "fig5.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "fig5_metrics", argv, compute, draw)


if __name__ == "__main__":
    main()
