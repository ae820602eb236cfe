"""Figures of a run: each function makes one matplotlib Figure from saved data and accesses no file.

The x axis counts generations. An iteration of Back-to-Reality is a block: the generations of its search, and for step 1
the trials in reality that follow them. Missing values (diverged pairs, failed trials) are left out.
"""

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from btr_mjx.gap.results import number_in_words
from btr_mjx.plotting.axes import (
    ABOVE,
    block_offsets,
    figure_width,
    generation_axis,
    legend_above,
    positive_scale,
    search_spacing,
)
from btr_mjx.plotting.run_data import RunData, ScanData, Search, with_unit

SIMULATED, REAL = "#1f5fa8", "#c8641e"
"""Colours of simulation and reality; open circles and filled diamonds distinguish them in grey scale."""

MARKERS = "osD^vPX*<>"
"""Markers of the iterations, used cyclically."""


def controller_fitness(run: RunData) -> Figure:
    """Fitness over the generations of step 1, and fitness in simulation and reality of the controllers tried."""
    figure = Figure(figsize=(figure_width(run.controllers, 0.32), 3.4))
    axes = figure.subplots()
    slot = _slot(run)
    offsets = block_offsets(run.controllers, slot, first=0.4 * slot - 0.4)
    _population(axes, run.controllers, offsets, np.max if run.maximise else np.min)
    trials = run.trials
    for iteration in np.unique(trials["iteration"]):
        rows = np.flatnonzero(trials["iteration"] == iteration)
        if iteration == 0:
            centre, spread = 0.0, 0.0
        else:
            centre, spread = offsets[iteration - 1] + len(run.controllers[iteration - 1].scores) + slot / 2 + 0.5, slot
            axes.axvspan(centre - spread / 2, centre + spread / 2, color="#f6ece3", linewidth=0, zorder=0)
        x = centre + (np.arange(len(rows)) - (len(rows) - 1) / 2) * 0.84 * spread / max(len(rows) - 1, 1)
        f_s, f_r = trials["f_s"][rows], trials["f_r"][rows]
        last = iteration == trials["iteration"].max()
        axes.vlines(x, f_s, f_r, color="0.6", linewidth=0.6, zorder=2)
        style: dict[str, Any] = {"linestyle": "none", "zorder": 3}
        label = lambda text, last=last: text if last else None  # noqa: E731
        axes.plot(x, f_s, "o", color=SIMULATED, fillstyle="none", label=label("tried: in simulation"), **style)
        axes.plot(x, f_r, "D", color=REAL, markersize=3.8, label=label("tried: in reality"), **style)
    generation_axis(axes, run.controllers, offsets, slot, border=0.5)
    axes.set(ylabel=run.fitness_label)
    axes.annotate("$c_0$", (0, 0), xycoords=("data", "axes fraction"), xytext=(0, -5), **ABOVE | {"va": "top"})
    legend_above(figure, axes)
    return figure


def delta_fitness_curve(run: RunData) -> Figure:
    """Delta_fitness over the generations of step 3, before and after each."""
    figure = Figure(figsize=(figure_width(run.simulations, 0.32), 3.2))
    axes = figure.subplots()
    spacing = search_spacing(run.simulations)
    offsets = block_offsets(run.simulations, spacing, first=(spacing - 1) / 2)
    shown = [run.iterations["delta_before"].to_numpy(), run.iterations["delta_after"].to_numpy()]
    shown += _population(axes, run.simulations, offsets, np.min)
    starts = np.array(offsets) + 1 - (spacing + 1) / 2
    ends = np.array(offsets) + [len(search.scores) for search in run.simulations]
    mark: dict[str, Any] = {"linestyle": "none", "markersize": 6, "zorder": 4}
    axes.plot(starts, shown[0], "o", color=REAL, fillstyle="none", label="before the search", **mark)
    axes.plot(ends, shown[1], "s", color=SIMULATED, label="after the search", **mark)
    generation_axis(axes, run.simulations, offsets, spacing, border=1 - 0.75 * (spacing + 1))
    positive_scale(axes, np.concatenate([np.ravel(values) for values in shown]))
    axes.set(ylabel=run.distance_label)
    legend_above(figure, axes)
    return figure


def parameter_values(run: RunData) -> Figure:
    """Parameters of all simulations of all generations, one panel per unknown parameter; Fig. 4b of the paper."""
    box = run.box
    columns = min(box.n, 2 if box.n <= 4 else 3 if box.n <= 9 else 4)
    rows = math.ceil(box.n / columns)
    figure = Figure(figsize=(2.2 + 2.4 * columns, 0.9 + 1.75 * rows))
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False)).ravel()
    spacing = search_spacing(run.simulations)
    offsets = block_offsets(run.simulations, spacing, first=(spacing - 1) / 2)
    x, values, darkness = _members(run.simulations, offsets)
    size = float(np.clip(4000 / len(x), 2.0, 7.0))
    for i, axes in enumerate(panels[: box.n]):
        label = f"simulations, darker for a smaller {run.distance_symbol}"
        shades: dict[str, Any] = {"c": darkness, "cmap": "Greys", "vmin": 0, "vmax": 1}
        axes.scatter(x, values[:, i], s=size, linewidths=0, zorder=1, label=label, **shades)
        for number, (search, offset) in enumerate(zip(run.simulations, offsets, strict=True)):
            best = [_member_best(search, g)[i] for g in range(len(search.scores))]
            least = "the one with the least" if number == 0 else None
            axes.plot(offset + 1 + np.arange(len(best)), best, color="black", linewidth=1.1, zorder=3, label=least)
        if run.truth is not None and np.isfinite(run.truth[i]):
            axes.axhline(run.truth[i], color=REAL, linestyle="--", linewidth=1.4, zorder=3.5, label="truth")
        style: dict[str, Any] = {"linestyle": "none", "zorder": 4, "clip_on": False}
        axes.plot(0, run.start[i], "o", color="black", fillstyle="none", markersize=6, label="start", **style)
        end = offsets[-1] + len(run.simulations[-1].scores)
        axes.plot(end, run.identified[i], "s", color=SIMULATED, markersize=5.5, label="identified", **style)
        margin = 0.04 * box.span[i]
        axes.set(
            ylim=(box.low[i] - margin, box.high[i] + margin),
            ylabel=textwrap.fill(
                with_unit(number_in_words(box.names[i]), box.units[i].replace(" ", "\N{NO-BREAK SPACE}")), 24
            ),
        )
        sides = ("t" if i < columns else "") + ("b" if i >= box.n - columns else "")
        generation_axis(axes, run.simulations, offsets, spacing, border=1 - 0.5 * (spacing + 1), sides=sides)
        axes.tick_params(labelbottom=i >= box.n - columns)
    for axes in panels[box.n :]:
        axes.remove()
    legend = legend_above(figure, panels[0], columns=2 if columns == 1 else 4)
    for handle in legend.legend_handles:
        if isinstance(handle, PathCollection):
            handle.set_sizes([12.0])  # dots of the scatter plot are too small for a legend
    return figure


def sim_versus_reality(run: RunData) -> Figure:
    """Fitness in simulation against fitness in reality of all controllers that were tried."""
    figure = Figure(figsize=(4.2, 4.2))
    axes = figure.subplots()
    f_s, f_r, iteration = (run.trials[name] for name in ("f_s", "f_r", "iteration"))
    numbers = np.unique(iteration)
    # Name a limited number of iterations in the legend.
    named = {0, numbers.max(), *numbers[numbers > 0][:: math.ceil(len(numbers) / 8)]}
    for number in numbers:
        rows = iteration == number
        grey = 0.8 * (1 - (number - 1) / max(numbers.max() - 1, 1))
        axes.plot(
            f_s[rows],
            f_r[rows],
            MARKERS[(number - 1) % len(MARKERS)] if number else "*",
            color="black",
            markerfacecolor=str(grey) if number else "white",
            markeredgewidth=0.7,
            markersize=5.5 if number else 10,
            label=None if number not in named else f"iteration {number}" if number else "first controller $c_0$",
            zorder=3,
            linestyle="none",
        )
    both = np.isfinite(f_s) & np.isfinite(f_r)
    finite = np.concatenate([f_s[both], f_r[both]])
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 1.0)
    room = 0.06 * ((high - low) or 1.0)
    limits = (low - room, high + room)
    axes.plot(limits, limits, "--", color="0.5", linewidth=1, zorder=1, label="no reality gap")
    axes.set(xlim=limits, ylim=limits, aspect="equal")
    axes.set(xlabel=with_unit("fitness in simulation $f_s$", run.unit))
    axes.set(ylabel=with_unit("fitness in reality $f_r$", run.unit))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    if not both.all():
        axes.set_title(f"{(~both).sum()} of {len(both)} trials failed and are not shown", loc="left", color="0.3")
    # Legend on the side of the diagonal with fewer points.
    axes.legend(loc="upper left" if (f_r[both] > f_s[both]).sum() <= both.sum() / 2 else "lower right")
    return figure


def scan_curve(data: ScanData) -> Figure:
    """delta_k of every behaviour and their mean over one parameter; Fig. 2b of the paper."""
    figure = Figure(figsize=(5.6, 3.5))
    axes = figure.subplots()
    lines = axes.plot(data.grid, data.delta, color="0.65", linewidth=0.7, zorder=1)
    if lines:
        lines[0].set_label(rf"$\delta_k$ of {data.delta.shape[1]} behaviours")
    axes.plot(
        data.grid, data.delta_fitness, color="black", linewidth=2.4, zorder=3, label=r"$\Delta_{fitness}$, their mean"
    )
    if np.isfinite(data.truth):
        axes.axvline(data.truth, color=REAL, linestyle="--", linewidth=1.2, zorder=2, label="truth")
    axes.set(xlabel=with_unit(data.parameter, data.parameter_unit))
    axes.set(ylabel=with_unit(r"$\delta_k$, $\Delta_{fitness}$", data.unit))
    finite = data.delta[np.isfinite(data.delta)]
    axes.set_ylim(0 - 0.03 * (finite.max() if len(finite) else 1.0), None)
    numbers = {name: float(data.result.get(name, np.nan)) for name in ("spearman", "spearman_left", "spearman_right")}
    parts = [rf"Spearman's $\rho$ = {numbers['spearman']:.2f}"] if np.isfinite(numbers["spearman"]) else []
    inside = np.isfinite(data.truth) and data.grid.min() < data.truth < data.grid.max()
    for side in ("left", "right"):
        if np.isfinite(numbers[f"spearman_{side}"]) and inside:
            parts.append(f"{side} of the truth {numbers[f'spearman_{side}']:.2f}")
    more = [
        f"{name} {float(data.result[name]):.2f}"
        for name in ("monotonicity", "roughness")
        if np.isfinite(float(data.result.get(name, np.nan)))
    ]
    # Two lines: one would be wider than the figure.
    axes.set_title("\n".join(", ".join(words) for words in (parts, more) if words), loc="left", color="0.3")
    legend_above(figure, axes)
    return figure


def _slot(run: RunData) -> float:
    """Width of the trials in reality on an axis of generations."""
    return max(2.0, 0.6 * max(len(search.scores) for search in run.controllers))


def _members(searches: Sequence[Search], offsets: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, parameters and grey level of every member; darker for a smaller distance."""
    places, values, scores = [], [], []
    for search, offset in zip(searches, offsets, strict=True):
        generations, population = search.scores.shape
        places.append(np.repeat(offset + 1 + np.arange(generations), population))
        values.append(search.parameters.reshape(generations * population, -1))
        scores.append(search.scores.ravel())
    score = np.concatenate(scores)
    # By rank, since outliers would compress the scale. Diverged simulations rank last.
    rank = np.argsort(np.argsort(np.where(np.isnan(score), np.inf, score), kind="stable"), kind="stable")
    return np.concatenate(places), np.concatenate(values), 0.68 - 0.5 * rank / max(len(rank) - 1, 1)


def _member_best(search: Search, generation: int) -> np.ndarray:
    """Parameters (n,) of a generation's best simulation, NaN where all diverged."""
    scores = search.scores[generation]
    if not np.isfinite(scores).any():
        return np.full(search.parameters.shape[-1], np.nan)
    return search.parameters[generation, np.nanargmin(scores)]


def _finite(function: Callable[[np.ndarray], float], scores: np.ndarray) -> np.ndarray:
    """A function of the finite members of each generation (g, population); NaN where there is none."""
    return np.array([function(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in scores])


def _population(
    axes: Axes, searches: Sequence[Search], offsets: list[float], best_of: Callable[[np.ndarray], float]
) -> list[np.ndarray]:
    """Draw best, mean and spread of every generation; gives the values that determine the range of the y axis."""
    shown = []
    for number, (search, offset) in enumerate(zip(searches, offsets, strict=True)):
        x = offset + 1 + np.arange(len(search.scores))
        low, mean, high = (_finite(f, search.scores) for f in (_tenth, np.mean, _ninetieth))
        best = _finite(best_of, search.scores)
        names = ("middle 80 % of the population", "mean", "best") if number == 0 else (None, None, None)
        axes.fill_between(x, low, high, color="0.87", linewidth=0, label=names[0])
        axes.plot(x, mean, "--", color="0.35", linewidth=1.1, label=names[1])
        axes.plot(x, best, "-", color="black", marker=".", label=names[2])
        shown += [best, low, high]
    return shown


def _tenth(values: np.ndarray) -> float:
    return float(np.quantile(values, 0.1))


def _ninetieth(values: np.ndarray) -> float:
    return float(np.quantile(values, 0.9))
