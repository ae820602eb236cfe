"""Fig. 3: `uv run python experiments/fig3_behaviours.py`. Effect of more, and of more diverse, behaviours.

The best controller c_1 of an evolution in s_0 is mutated. (a) delta_k of M = 45 mutants with p_m = 0.02 over bl_5,
reality 0.88 m. (b) Delta_fitness of the first m of them, m = 1 .. 45; insets: their fitness in reality and in s_0.
(c) Delta_fitness of m = 15 mutants for 16 values of p_m. Below: (d) rank correlation with the error and roughness, over
the parameter's range of influence, against m (means over random choices of m behaviours), (e) against p_m, and (f) how
far the least Delta_fitness lies from the truth where f_r is measured with noise.

The run folder holds seed-0.npz, ...: grid (G,); fitness (G, M, K + 1) of the mutants at the marks and at T_e, real
(M, K + 1) and start (M,) in s_0 [m/s]; p_m (P,), diverse (P, G, m, K + 1) and diverse_real (P, m, K + 1). fig3.json
holds the statistics over seeds, fig3.png the figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats
from bench import Bench
from common import TINY, Config, command
from curves import Draws, curve_numbers, influence, interval, multiscale_curve, noise_numbers, subset_numbers
from drawing import delta_panel, figure_of, letter, save, shades, truth_line, white_legend
from fig2_scans import TRUTHS, evolve, line_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx import scan
from btr_mjx.errors import InputError
from btr_mjx.evaluation import delta_of, metrics
from btr_mjx.optimise import mutate
from btr_mjx.robots import PAPER_STARTS
from btr_mjx.runs import write_json

PARAMETER = "bl_5"
TRUTH = TRUTHS[PARAMETER]
NOISES = (0.0, 0.01, 0.05, 0.1)
"""Relative standard deviations of measured fitness."""


@dataclass(frozen=True, kw_only=True)
class Fig3Config(Config):
    """Settings of Fig. 3."""

    grid: int = 49
    """Points over the parameter's range; the truth is added where it is not among them."""
    mutants: int = 45
    """M, mutants of c_1."""
    p_m: float = 0.02
    """Their probability per bit."""
    diversities: int = 16
    """Values of p_m, from 0.005 to 0.5 (random controllers) in equal ratios."""

    @property
    def p_m_values(self) -> np.ndarray:
        """The values of p_m."""
        return np.geomspace(0.005, 0.5, self.diversities)

    def check(self) -> None:
        """As `Config.check`."""
        super().check()
        if self.mutants < 3 or self.diversities < 2:
            raise InputError(f"mutants {self.mutants}, diversities {self.diversities}: expected at least 3 and 2")


PRESETS = {
    "quick": Fig3Config(seeds=3, grid=25, diversities=6),
    "paper": Fig3Config(preset="paper", seeds=10),
    "tiny": Fig3Config(preset="tiny", **TINY, grid=7, mutants=9, diversities=3),
}
"""Settings by preset."""


def sizes_of(mutants: int) -> list[int]:
    """Values of m that are compared: 1, 5, 15, 45 of 45."""
    return sorted({1, max(mutants // 9, 1), mutants // 3, mutants})


def work(config: Fig3Config, seed: int, step: Step, journal: Journal) -> Arrays:
    """All simulations of one seed."""
    bench = Bench.of(config, step)
    grid, line, reality = line_of(bench, PARAMETER, config.grid)
    start = scan.along(bench.robot, PARAMETER, [PAPER_STARTS[PARAMETER]])
    box = bench.robot.controller_box.with_bits(config.search.bits)
    best = journal(lambda: evolve(bench, config, start[0], seed)[0][0], config.population * config.generations)
    rng = np.random.default_rng([seed, 3])
    mutants = box.decode(mutate(np.tile(best, (config.mutants, 1)), config.p_m, rng))

    def tried(controllers: np.ndarray) -> np.ndarray:
        """Fitness in s_0, in reality and along the grid (2 + G, m, K + 1)."""
        count = len(controllers) * (len(grid) + 2)
        return journal(lambda: bench.whole(np.concatenate([start, reality, line]), controllers), count)

    fitness = tried(mutants)
    diverse = np.stack(
        [tried(box.decode(mutate(np.tile(best, (config.trials, 1)), p, rng))) for p in config.p_m_values.tolist()]
    )
    return {
        "grid": grid,
        "start": fitness[0, :, -1],
        "real": fitness[1],
        "fitness": fitness[2:],
        "p_m": config.p_m_values,
        "diverse_real": diverse[:, 1],
        "diverse": diverse[:, 2:],
    }


def units(config: Fig3Config) -> list[Unit]:
    """One unit per seed."""
    behaviours = config.mutants + config.diversities * config.trials
    trials = config.population * config.generations + behaviours * (config.grid + 3)
    return [Unit(f"seed-{seed}", trials, partial(work, config, seed)) for seed in range(config.seeds)]


def compute(config: Fig3Config) -> int:
    """Compute the seeds that are missing; returns how many there were."""
    return run_units(config, units(config), "fig3")


def deltas(arrays: Arrays) -> np.ndarray:
    """delta_k of the mutants (G, M)."""
    return delta_of(arrays["fitness"][..., -1], arrays["real"][:, -1])


def every_behaviour(arrays: Arrays) -> np.ndarray:
    """Fitness along the grid of all mutants, of whatever p_m, (G, M + P m)."""
    diverse = np.moveaxis(arrays["diverse"][..., -1], 0, 1)
    return np.concatenate([arrays["fitness"][..., -1], diverse.reshape(len(diverse), -1)], axis=1)


def diverse_curves(arrays: Arrays) -> np.ndarray:
    """Delta_fitness for every p_m (P, G)."""
    return np.abs(arrays["diverse"][..., -1] - arrays["diverse_real"][:, None, :, -1]).mean(axis=-1)


def crosses_elsewhere(arrays: Arrays, away: float = 0.1) -> float:
    """Fraction of behaviours whose f_s - f_r changes its sign (delta_k = 0) further than `away` from the truth."""
    grid, difference = arrays["grid"], arrays["fitness"][..., -1] - arrays["real"][:, -1]
    far = (grid[1:] < TRUTH - away) | (grid[:-1] > TRUTH + away)
    return float((difference[1:] * difference[:-1] < 0)[far].any(axis=0).mean())


def summarise(seeds: Sequence[Arrays]) -> dict[str, Any]:
    """Numbers over the range of influence, with intervals over seeds.

    Returns:
      influence: the range [m]; by_m: per m and number the interval and the seeds' values, by_p_m likewise; steps:
      paired differences over seeds between successive m; trend: Spearman's rho between p_m and a number, per
      seed; noise: per level and m; multiscale: of that distance.
    """
    grid = seeds[0]["grid"]
    keep = influence(grid, [every_behaviour(arrays) for arrays in seeds], TRUTH)
    sizes = sizes_of(seeds[0]["fitness"].shape[1])
    by_m = [subset_numbers(grid, deltas(a), TRUTH, sizes, keep, Draws(seed=i)) for i, a in enumerate(seeds)]
    by_p_m = [[curve_numbers(grid, row, TRUTH, keep=keep) for row in diverse_curves(arrays)] for arrays in seeds]
    p_m = seeds[0]["p_m"]
    names = list(by_m[0][1])
    steps, trend = {}, {}
    for name in names:
        for less, more in pairwise(sizes):
            steps[f"{name} {less} to {more}"] = paired([row[more][name] - row[less][name] for row in by_m])
        ranks = [float(metrics.spearman([row[name] for row in rows], p_m)) for rows in by_p_m]
        trend[name] = {**interval(ranks), "values": ranks}
    noise = {
        str(level): {
            str(m): interval([row[m]["off"] for row in rows]) | {"values": [row[m]["off"] for row in rows]}
            for m in sizes
        }
        for level in NOISES
        for rows in [
            [
                noise_numbers(grid, a["fitness"][..., -1], a["real"][:, -1], TRUTH, sizes, level, keep, Draws(seed=i))
                for i, a in enumerate(seeds)
            ]
        ]
    }
    multiscale = [
        curve_numbers(grid, multiscale_curve(arrays["fitness"], arrays["real"]), TRUTH, keep=keep) for arrays in seeds
    ]
    at = grid == TRUTH
    return {
        "influence": [float(grid[keep].min()), float(grid[keep].max())],
        "by_m": {
            str(m): {name: {**interval(v), "values": v} for name in names for v in [[r[m][name] for r in by_m]]}
            for m in sizes
        },
        "by_p_m": [
            {"p_m": float(p), **{name: interval([rows[i][name] for rows in by_p_m]) for name in names}}
            for i, p in enumerate(p_m)
        ],
        "steps": steps,
        "trend": trend,
        "noise": noise,
        "crosses_elsewhere": interval([crosses_elsewhere(arrays) for arrays in seeds]),
        "multiscale": {name: interval([row[name] for row in multiscale]) for name in names},
        "at_truth": float(max(deltas(arrays)[at].max() for arrays in seeds)),
    }


def paired(differences: Sequence[float]) -> dict[str, Any]:
    """Mean paired difference over seeds with its interval, and Wilcoxon's signed-rank p (two-sided)."""
    known = np.asarray(differences)[np.isfinite(differences)]
    enough = len(known) > 1 and np.any(known != 0)
    p = float(scipy.stats.wilcoxon(known).pvalue) if enough else np.nan
    return {**interval(known), "p": p, "values": list(differences)}


# ---- the figure ----


def nested_panel(axes: Axes, arrays: Arrays) -> None:
    """Delta_fitness for m = 1 .. M with the two insets."""
    grid, each = arrays["grid"], deltas(arrays)
    means = np.cumsum(each, axis=1) / np.arange(1, each.shape[1] + 1)
    for column, shade in zip(means.T, shades(means.shape[1], 0.86), strict=True):
        axes.plot(grid, column, color=shade, linewidth=0.7)
    truth_line(axes, TRUTH)
    axes.set(xlabel=f"{PARAMETER} [m]", ylabel=r"$\Delta_{fitness}$ [m/s]", ylim=(0, 1.75 * np.nanmax(means[:, 2:])))
    low, high = np.nanmin([arrays["real"][:, -1], arrays["start"]]), np.nanmax([arrays["real"][:, -1], arrays["start"]])
    insets = (("reality", arrays["real"][:, -1], 0.08), ("starting simulation", arrays["start"], 0.58))
    for name, values, left in insets:
        inset = axes.inset_axes((left, 0.72, 0.41, 0.22))
        inset.bar(np.arange(1, len(values) + 1), values, width=0.8, color="0.35")
        inset.set(ylim=(min(low, 0), high), xticks=[1, len(values)])
        inset.tick_params(labelsize=6, length=2, pad=1)
        inset.set_title(f"$f$ in {name}", fontsize=6, pad=2)


def diverse_panel(axes: Axes, arrays: Arrays) -> None:
    """Delta_fitness for every p_m; the inset shows the values."""
    curves = diverse_curves(arrays)
    greys = shades(len(curves))
    for curve, grey in zip(curves, greys, strict=True):
        axes.plot(arrays["grid"], curve, color=grey, linewidth=1.0)
    truth_line(axes, TRUTH)
    axes.set(xlabel=f"{PARAMETER} [m]", ylabel=r"$\Delta_{fitness}$ [m/s]", ylim=(0, 1.55 * np.nanmax(curves)))
    inset = axes.inset_axes((0.56, 0.72, 0.42, 0.24))
    inset.bar(np.arange(1, len(curves) + 1), arrays["p_m"], width=0.8, color=greys, edgecolor="black", linewidth=0.3)
    inset.set(yscale="log", xticks=[1, len(curves)])
    inset.tick_params(labelsize=6, length=2, pad=1)
    inset.set_title("$p_m$", fontsize=6.5, pad=2)


def number_panel(axes: Axes, x: Sequence[float], rows: Sequence[dict[str, Any]], label: str) -> None:
    """Rank correlation (filled, left) and roughness (open, right) with intervals."""
    other = axes.twinx()
    other.spines["right"].set_visible(True)
    looks = (
        ("rho_sides", axes, "o", "full", "-", "\u25cf Spearman's \u03c1 by side"),
        ("roughness_sides", other, "s", "none", "--", "\u25a1 roughness by side"),
    )
    for name, where, marker, fill, line, words in looks:
        middle = np.array([row[name]["estimate"] for row in rows])
        ends = np.array([[row[name]["low"], row[name]["high"]] for row in rows]).T
        error = np.abs(np.where(np.isfinite(ends), ends, middle) - middle)
        where.errorbar(x, middle, error, marker=marker, fillstyle=fill, linestyle=line, color="black", lw=1, capsize=2)
        where.set_ylabel(words)
    axes.set(xscale="log", xlabel=label)


def noise_panel(axes: Axes, summary: dict[str, Any]) -> None:
    """Distance of the least Delta_fitness from the truth against m, per noise."""
    styles = zip(summary["noise"].items(), (":", "-.", "--", "-"), ("v", "^", "s", "o"), strict=True)
    for (level, by_m), style, marker in styles:
        m = [int(name) for name in by_m]
        values = [row["estimate"] for row in by_m.values()]
        axes.plot(m, values, linestyle=style, marker=marker, color="black", lw=1, label=f"{100 * float(level):.0f} %")
    axes.set(xscale="log", xlabel="$m$", ylabel="|argmin − truth| [m]", xticks=m, xticklabels=[str(i) for i in m])
    axes.minorticks_off()
    axes.legend(title="noise on $f_r$", title_fontsize=7, fontsize=7)


def draw(folder: Path) -> list[Path]:
    """fig3.json and fig3.png from the saved seeds; the upper row shows seed 0."""
    seeds = load(folder, "seed")
    summary = summarise(seeds)
    write_json(folder / "fig3.json", summary)
    with figure_of(9.6, 5.6) as figure:
        fill(figure, seeds[0], summary)
        return [folder / "fig3.json", save(figure, folder / "fig3.png")]


def fill(figure: Figure, first: Arrays, summary: dict[str, Any]) -> None:
    """All panels."""
    panels: Any = figure.subplots(2, 3, height_ratios=[1.25, 1])
    delta_panel(panels[0, 0], first["grid"], deltas(first), TRUTH, headroom=1.4)
    panels[0, 0].set_xlabel(f"{PARAMETER} [m]")
    white_legend(panels[0, 0], loc="upper center")
    low, high = summary["influence"]
    panels[0, 0].axvspan(low, high, ymax=0.02, color="0.4", linewidth=0)
    mutants = first["fitness"].shape[1]
    letter(panels[0, 0], "a", rf"$\delta_k$ of {mutants} mutants of $c_1$")
    nested_panel(panels[0, 1], first)
    letter(panels[0, 1], "b", f"$m$ = 1 .. {mutants}, darker for more")
    diverse_panel(panels[0, 2], first)
    letter(panels[0, 2], "c", f"{len(first['p_m'])} values of $p_m$, darker for more")
    sizes = [int(name) for name in summary["by_m"]]
    number_panel(panels[1, 0], sizes, list(summary["by_m"].values()), "$m$")
    panels[1, 0].set(xticks=sizes, xticklabels=[str(m) for m in sizes])
    panels[1, 0].minorticks_off()
    letter(panels[1, 0], "d", "number of behaviours")
    number_panel(panels[1, 1], [row["p_m"] for row in summary["by_p_m"]], summary["by_p_m"], "$p_m$")
    letter(panels[1, 1], "e", "diversity")
    noise_panel(panels[1, 2], summary)
    letter(panels[1, 2], "f", "noise is averaged out")


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "fig3_behaviours", argv, compute, draw)


if __name__ == "__main__":
    main()
