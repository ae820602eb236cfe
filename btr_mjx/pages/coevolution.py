"""What the page of a co-evolution says."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality import growth_sentence
from btr_mjx.evaluation import metrics
from btr_mjx.gap.results import format_number
from btr_mjx.pages.content import Section, Table, with_interval
from btr_mjx.pages.page import embedded
from btr_mjx.plotting import RunData, with_unit

CAPTIONS: Mapping[str, tuple[str, str]] = {
    "controller_fitness": (
        "Fitness of controllers over the generations, and of those tried in reality",
        "Fitness in simulation over the generations of step 1, and of the controllers tried: circles as simulated, "
        "diamonds as measured. The line between them is the reality gap of a controller.",
    ),
    "delta_fitness": (
        "Distance between simulation and reality over the generations",
        "What step 3 minimises, over its generations, before and after each search.",
    ),
    "limb_lengths": (
        "Unknown parameters over the generations",
        "Every simulation that was tried, by unknown parameter.",
    ),
    "sim_versus_reality": (
        "Fitness in simulation against fitness in reality",
        "Each controller that was tried; on the dashed line the simulation predicted the measured fitness.",
    ),
    "robot": ("The robot", "The robot with the parameters of the start, of the end and, where known, of reality."),
}
"""Figure -> what it shows, and its caption."""


def coevolution_sentence(run: RunData) -> str:
    """The verdict of a co-evolution, two sentences at most."""
    result, unit = run.result, f" {run.unit}".rstrip()
    tried = result.get("reality_evaluations", len(run.trials["f_r"]))
    first, last = (result.get(f"parameter_error_{when}") for when in ("first", "last"))
    lengths = set(run.box.units)
    own = f" {next(iter(lengths))}".rstrip() if len(lengths) == 1 else ""
    what = f"the mean error of {_count(run.box.n, 'unknown parameter')}"
    if first is None or last is None:
        first, last = (float(result.get(f"delta_fitness_{when}", np.nan)) for when in ("first", "last"))
        what, own = "Delta_fitness, the mean difference between simulated and measured fitness,", unit
    change = f"from {format_number(first)}{own} to {format_number(last)}{own}"
    moved = f"falls {change}" if last < first else f"does not fall: it goes {change}"
    text = f"With {_count(tried, 'trial')} in reality, {what} {moved}."
    before, best = result.get("f_r_first_controller"), result.get("f_r_best")
    if isinstance(before, float) and isinstance(best, float):
        text += (
            f" The best controller reaches {format_number(best)}{unit} in reality; the first one reached "
            f"{format_number(before)}{unit}."
        )
    return text


def coevolution_content(folder: Path, run: RunData, figures: Sequence[Path]) -> dict[str, Any]:
    """Variables of the page.

    Args:
      folder: the run folder.
      run: its data.
      figures: PNG files of `draw_run`.
    """
    result = run.result
    unit = f" {run.unit}".rstrip()
    numbers = []
    for label, key, of in (
        ("Delta_fitness, first", "delta_fitness_first", unit),
        ("Delta_fitness, last", "delta_fitness_last", unit),
        ("best fitness in reality, first iteration", "f_r_best_first_iteration", unit),
        ("last iteration", "f_r_best", unit),
        ("learning performance", "lp", ""),
    ):
        if isinstance(result.get(key), float):
            numbers.append((label, f"{format_number(result[key])}{of}"))
    shown = {path.stem: path for path in figures}
    made = {
        name: embedded(shown[name], alt, caption, photo=name == "robot")
        for name, (alt, caption) in CAPTIONS.items()
        if name in shown
    }
    pick = lambda *names: [made[name] for name in names if name in made]  # noqa: E731
    sections = [
        Section("Identified parameters", figures=pick("robot", "limb_lengths"), tables=[_parameters(run)]),
        Section("Controllers in simulation and in reality", figures=pick("controller_fitness", "sim_versus_reality")),
        Section("Iterations", figures=pick("delta_fitness"), tables=[_iterations(run)]),
        Section("All trials in reality", tables=[_trials(run)], folded=True),
    ]
    if result.get("growth"):
        sections.insert(1, Section("Missing effects", [growth_sentence(row) for row in result["growth"]]))
    return {
        "heading": "Co-evolution",
        "name": folder.resolve().name,
        "sentence": coevolution_sentence(run),
        "numbers": numbers,
        "sections": sections,
        "footer": [
            f"Stopped by {result.get('stop', 'iterations')}, {result.get('failed_trials', 0)} failed trials. Numbers: "
            "result.json, iterations.parquet, generations.parquet. Arrays: *.npz."
        ],
    }


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _parameters(run: RunData) -> Table:
    columns = ["parameter", "start", "identified", "lowest", "highest", "unit"]
    rows: list[list[Any]] = []
    for i, name in enumerate(run.box.names):
        row = [name, float(run.start[i]), float(run.identified[i])]
        if run.truth is not None:
            row += [float(run.truth[i]), float(run.identified[i] - run.truth[i])]
        rows.append([*row, float(run.box.low[i]), float(run.box.high[i]), run.box.units[i]])
    if run.truth is not None:
        columns[3:3] = ["truth", "error"]
    return Table(columns, rows, "A co-evolution gives values without intervals. Lowest, highest: bounds of the search.")


def _iterations(run: RunData) -> Table:
    """One row per iteration: the distance before and after, and the gap of the controllers that were tried."""
    distance = "Delta_fitness" if run.distance == "fitness" else "multiscale distance"
    rows: list[list[Any]] = []
    for row in run.iterations.iter_rows(named=True):
        own = run.trials["iteration"] == row["iteration"]
        gap = np.abs(run.trials["f_s"] - run.trials["f_r"])[own]
        gap = gap[np.isfinite(gap)]
        best = run.trials["f_r"][own & np.isfinite(run.trials["f_r"])]
        cell = None
        if len(gap):
            interval = metrics.bootstrap_interval(gap, n_resamples=999)
            cell = with_interval(float(interval.estimate), float(interval.low), float(interval.high))
        top = (np.max if run.maximise else np.min)(best) if len(best) else np.nan
        rows.append(
            [row["iteration"], int(own.sum()), cell, float(top), float(row["delta_before"]), float(row["delta_after"])]
        )
    return Table(
        [
            *("iteration", "trials", with_unit("mean |f_s − f_r|", run.unit), with_unit("best f_r", run.unit)),
            *(f"{distance} before", f"{distance} after"),
        ],
        rows,
        "In brackets: 95 % bootstrap interval over the controllers of the iteration. f_s: fitness predicted by the "
        "simulation of that time, f_r: measured.",
    )


def _trials(run: RunData) -> Table:
    f_s, f_r = run.trials["f_s"].astype(float), run.trials["f_r"].astype(float)
    rows = [
        [k, int(run.trials["iteration"][k]), float(f_s[k]), float(f_r[k]), float(abs(f_s[k] - f_r[k]))]
        for k in range(len(f_r))
    ]
    names = ["trial", "iteration", *(with_unit(name, run.unit) for name in ("f_s", "f_r", "|f_s − f_r|"))]
    return Table(names, rows, "Iteration 0 is the first controller; – marks a failed trial.")
