"""What the page of a co-evolution says."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality import growth_sentence, identified_words, prediction_errors, value_note
from btr_mjx.evaluation import metrics
from btr_mjx.gap.results import format_number
from btr_mjx.pages.page import embedded
from btr_mjx.pages.page_content import Section, Table, with_interval
from btr_mjx.plotting import RunData, with_unit

DISTANCE_WORDS: Mapping[str, str] = {
    "fitness": "It is Delta_fitness, the mean of |f_s − f_r|.",
    "multiscale": "It is the multiscale distance: the mean of |f_s − f_r| over several early marks of a trial and its "
    "end, each divided by the spread of f_r at that mark; it has no unit.",
}
"""What step 3 minimises, in words."""

LEARNING_WORDS = (
    "Learning performance: by how much the best controller of the last iteration is better than the first one, c_0, / "
    "largest fitness measured, times the number of controller parameters over the number of trials; larger is better."
)
"""The paper's LP in words."""

FILM_CAPTION = (
    "Before: the controller of iteration 1 with the best predicted fitness, in the simulation of the start and in "
    "reality. After: the controller of the last iteration with the best measured fitness, in the identified "
    "simulation, which was fitted to this trial as well, and in reality. Numbers: fitness. Yellow: parts whose size is "
    "unknown; the line on the ground: path of the base."
)
"""What a film of `btr_mjx.replay` shows."""

CAPTIONS: Mapping[str, tuple[str, str]] = {
    "controller_fitness": (
        "Fitness of controllers over the generations, and of those tried in reality",
        "Fitness in simulation over the generations of step 1, and of the controllers tried: circles as simulated, "
        "diamonds as measured. The line between them is the reality gap of a controller. c_0: the first controller, "
        "tried before anything was learned.",
    ),
    "delta_fitness": (
        "Distance between simulation and reality over the generations",
        "What step 3 minimises, over its generations, before and after each search.",
    ),
    "parameters": (
        "Unknown parameters over the generations",
        "Every simulation that was tried, by unknown parameter; the darker, the better it fits.",
    ),
    "sim_versus_reality": (
        "Fitness in simulation against fitness in reality",
        "Each controller that was tried; on the dashed line the simulation predicted the measured fitness.",
    ),
    "robot": ("The robot", "The robot with the parameters of the start, of the end and, where known, of reality."),
}
"""Figure -> what it shows, and its caption."""


def coevolution_sentence(run: RunData) -> str:
    """The verdict of a co-evolution, two sentences at most.

    The first says how well new controllers were predicted in the first and in the last iteration, and what was
    identified; the second what the best controller does, as predicted and as measured.
    """
    result, unit = run.result, f" {run.unit}".rstrip()
    tried, last = result.get("reality_evaluations", len(run.trials["f_r"])), int(run.trials["iteration"].max())
    before, after = _errors(run)[[0, -1]]
    values = [format_number(before) + unit, format_number(after) + unit]
    text = f"With {_count(tried, 'trial')} in reality, the mean error of the predicted fitness of new controllers "
    if last == 1:
        text += f"is {values[0]} in the only iteration"
    elif values[0] == values[1]:
        text += f"stays at {values[0]} (iterations 1 and {last})"
    elif after < before:
        text += f"falls from {values[0]} (iteration 1) to {values[1]} (iteration {last})"
    else:
        text += f"does not fall: it goes from {values[0]} (iteration 1) to {values[1]} (iteration {last})"
    text += f"; {identified_words(result)}."
    measured, predicted = result.get("f_r_best"), result.get("f_s_best")
    if isinstance(measured, float) and isinstance(predicted, float):
        text += (
            f" The best controller reaches {format_number(measured)}{unit} in reality, "
            f"{format_number(predicted)}{unit} were predicted"
        )
        first = result.get("f_r_first_controller")
        text += f"; the first one reached {format_number(first)}{unit}." if isinstance(first, float) else "."
    return text


def _errors(run: RunData) -> np.ndarray:
    return prediction_errors(*(run.trials[name] for name in ("f_s", "f_r", "iteration")))


def coevolution_content(folder: Path, run: RunData, figures: Sequence[Path]) -> dict[str, Any]:
    """Variables of the page, with the PNG files of `draw_run`."""
    result = run.result
    unit = f" {run.unit}".rstrip()
    last, errors = (
        int(run.trials["iteration"].max()),
        _errors(run),
    )
    numbers = [("prediction error, iteration 1", f"{format_number(errors[0])}{unit}")]
    if last > 1:
        numbers.append((f"prediction error, iteration {last}", f"{format_number(errors[-1])}{unit}"))
    for label, key, of in (
        ("fitted: Delta_fitness of the final simulation", "delta_fitness_last", unit),
        ("best fitness in reality, iteration 1", "f_r_best_first_iteration", unit),
        (f"best fitness in reality, iteration {last}", "f_r_best", unit),
        ("learning performance", "lp", ""),
    ):
        if isinstance(result.get(key), float):
            numbers.append((label, f"{format_number(result[key])}{of}"))
    of_distance = CAPTIONS["delta_fitness"]
    captions = {**CAPTIONS, "delta_fitness": (of_distance[0], f"{of_distance[1]} {DISTANCE_WORDS[run.distance]}")}
    shown = {path.stem: path for path in figures}
    made = {
        name: embedded(shown[name], alt, caption, photo=name == "robot")
        for name, (alt, caption) in captions.items()
        if name in shown
    }
    pick = lambda *names: [made[name] for name in names if name in made]  # noqa: E731
    sections = [
        Section("Identified parameters", figures=pick("robot", "parameters"), tables=[_parameters(run)]),
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
        "film_caption": FILM_CAPTION,
        "footer": [
            f"Stopped by {result.get('stop', 'iterations')}, {result.get('failed_trials', 0)} failed trials. Numbers: "
            "result.json, iterations.csv, generations.csv. Arrays: *.npz.",
            LEARNING_WORDS,
        ],
    }


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


TOLD_NOTE = (
    "90 % interval: from how the fitness of the fitted trials changes with each parameter and from how far it is from "
    "the measured one; it holds every simulation of the search that fits as well. Where it would be more than half of "
    "the range, the parameter is not told by these trials and its range is given: other motions, more trials or "
    "repeated measurements are needed."
)
"""What the column of intervals is."""


def _parameters(run: RunData) -> Table:
    columns = ["parameter", "start", "identified", "90 % interval", "range", "note"]
    told = run.result["told"]
    rows: list[list[Any]] = []
    for i, name in enumerate(run.box.names):
        value, unit = float(run.identified[i]), run.box.units[i]
        row = [f"{name} [{unit}]" if unit else name, float(run.start[i]), value, _ends(*told["intervals"][name])]
        if run.truth is not None:
            row += [float(run.truth[i]), float(value - run.truth[i])]
        rows.append([*row, _ends(run.box.low[i], run.box.high[i]), value_note(run.result, name)])
    if run.truth is not None:
        columns[4:4] = ["truth", "error"]
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    sentences = [f"{one[0].upper()}{one[1:]}." for one in told["combinations"]]
    return Table(columns, rows, " ".join(["Range: bounds of the search.", TOLD_NOTE, *sentences]))


def _ends(low: float, high: float) -> str:
    return "\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}".join(format_number(end, 4) for end in (low, high))


def _iterations(run: RunData) -> Table:
    """One row per iteration: the distance before and after, and the gap of the controllers that were tried."""
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
        ["no.", "trials", "mean |f_s − f_r|", "best f_r", "before", "after"],
        rows,
        f"f_s: fitness predicted by the simulation of that time, f_r: measured{f' [{run.unit}]' if run.unit else ''}. "
        "In brackets: 95 % bootstrap interval over the controllers of the iteration. Before, after: the distance that "
        f"step 3 minimised, over the trials it was fitted to. {DISTANCE_WORDS[run.distance]}",
    )


def _trials(run: RunData) -> Table:
    f_s, f_r = run.trials["f_s"].astype(float), run.trials["f_r"].astype(float)
    rows = [
        [k, int(run.trials["iteration"][k]), float(f_s[k]), float(f_r[k]), float(abs(f_s[k] - f_r[k]))]
        for k in range(len(f_r))
    ]
    names = ["trial", "iteration", *(with_unit(name, run.unit) for name in ("f_s", "f_r", "|f_s − f_r|"))]
    return Table(names, rows, "Iteration 0 is the first controller; – marks a failed trial.")
