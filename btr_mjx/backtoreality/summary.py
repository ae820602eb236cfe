"""Results of a finished co-evolution: the content of result.json, and the table that the command prints."""

from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import growth_sentence
from btr_mjx.backtoreality.run_state import Problem, State
from btr_mjx.backtoreality.search_record import best_index
from btr_mjx.backtoreality.simulation_search import whole_trial_delta
from btr_mjx.evaluation import learning_performance
from btr_mjx.gap.results import format_number

_DISTANCES = {"fitness": "Delta_fitness", "multiscale": "the multiscale distance"}

NOT_TOLD = "not told by these trials"
"""What stands beside a number that has its range in place of an interval."""

_AT_BOUND = 0.005
"""Part of its range within which a value counts as being at the bound."""


def summarise(problem: Problem, state: State) -> dict[str, Any]:
    """Results of a finished run, as in result.json.

    Returns:
      prediction_error_first and _last: mean |f_s - f_r| over the controllers that were new in the first and the last
      iteration, f_s as predicted before they were tried. delta_fitness_first and _last: Delta_fitness of s_0 over the
      behaviours of iteration 1, and of the last simulation over those it was fitted to. parameter_error_first and
      _last: mean absolute error of the unknown parameters whose true values are known (truth), None where none is. The
      fitness function's name, unit and direction; bounds and units of the unknown parameters (space).
      reality_evaluations, lp (learning performance) and its terms, the simulation, what the trials tell of it (told,
      see `told_words.told_record`), the best controller, the stop criterion that was met, and the noise of a single
      measurement where trials were measured more than once.
    """
    original, problem = problem, grown(problem, state.grown)
    trials, last = state.trials, state.iteration
    latest = trials.iteration == last
    first = trials.iteration == 1
    maximise = problem.fitness.maximise
    errors = prediction_errors(trials.f_s, trials.f_r, trials.iteration)
    f_0 = float(trials.f_r[0])
    best = int(best_index(np.where(latest, trials.f_r, np.nan), maximise))
    f_end, f_max = float(trials.f_r[best]), float(np.nanmax(np.abs(trials.f_r)))
    delta = lambda s, iteration: float(  # noqa: E731
        whole_trial_delta(problem, s[None], trials, iteration)[0]
    )
    indices, box = problem.robot.simulation_box.indices(problem.unknown), problem.simulation_box
    true, noise = (getattr(problem.reality, name, None) for name in ("true_values", "noise"))
    known = original.robot.simulation_box.indices(original.unknown)
    truth = np.full(len(known), np.nan) if true is None else true[known]
    told = np.isfinite(truth)

    def error(simulation: np.ndarray) -> float | None:
        return float(np.abs(simulation[known] - truth)[told].mean()) if told.any() else None

    values = lambda s: dict(zip(problem.unknown, np.asarray(s)[indices].tolist(), strict=True))  # noqa: E731
    return {
        "prediction_error_first": float(errors[0]),
        "prediction_error_last": float(errors[-1]),
        "delta_fitness_first": delta(problem.start, 1),
        "delta_fitness_last": delta(state.simulation, last),
        "parameter_error_first": error(problem.start),
        "parameter_error_last": error(state.simulation),
        "reality_evaluations": len(trials),
        "lp": learning_performance(
            f_0 if np.isfinite(f_0) else 0.0 if maximise else f_max,
            f_end,
            f_max,
            problem.controller_box.n,
            len(trials),
            maximise,
        ),
        "distance": problem.settings.compared,
        "fitness": problem.fitness.name,
        "fitness_unit": problem.fitness.unit,
        "maximise": maximise,
        "space": {
            name: {"low": low, "high": high, "unit": unit}
            for name, low, high, unit in zip(box.names, box.low.tolist(), box.high.tolist(), box.units, strict=True)
        },
        "f_r_first_controller": f_0,
        "f_r_best_first_iteration": float(trials.f_r[best_index(np.where(first, trials.f_r, np.nan), maximise)]),
        "f_r_best": f_end,
        "f_s_best": float(trials.f_s[best]),
        "failed_trials": int((~np.isfinite(trials.f_r)).sum()),
        "measurement_noise": noise if true is None and noise is not None and np.isfinite(noise) else None,
        "iterations": last,
        "stop": state.stop,
        "start": values(problem.start),
        "simulation": values(state.simulation),
        "truth": {original.unknown[i]: float(truth[i]) for i in np.flatnonzero(told)} or None,
        "told": dict(state.told),
        "growth": list(state.sought),
        "effects": list(state.grown),
        "best_controller": trials.controllers[best].tolist(),
    }


def prediction_errors(f_s: np.ndarray, f_r: np.ndarray, iteration: np.ndarray) -> np.ndarray:
    """(iterations,) mean |f_s - f_r| of each one's trials, whose f_s was predicted before; NaN where all failed."""
    gap = np.abs(f_s - f_r)
    own = [gap[(iteration == k) & np.isfinite(gap)] for k in range(1, int(iteration.max()) + 1)]
    return np.array([values.mean() if len(values) else np.nan for values in own])


def bound_words(value: float, low: float, high: float) -> str:
    """Which bound of its range a value is at; "" for none."""
    near = _AT_BOUND * (high - low)
    return "at its lower bound" if value <= low + near else "at its upper bound" if value >= high - near else ""


def value_note(result: dict[str, Any], name: str) -> str:
    """What is to be said of an identified value beside its interval; "" for nothing."""
    space = result["space"][name]
    words = [] if name in result["told"]["told"] else [NOT_TOLD]
    bound = bound_words(result["simulation"][name], space["low"], space["high"])
    return ", ".join([*words, *([bound] if bound else [])])


def summary_table(result: dict[str, Any], out: Path) -> str:
    """The table that the command prints at its end."""
    unit = f" [{result['fitness_unit']}]" if result["fitness_unit"] else ""
    last = result["iterations"]
    lines = [f"{'':46}{'iteration 1':>14}{f'iteration {last}':>14}"]
    for label, keys in (
        ("prediction error on new controllers", ("prediction_error_first", "prediction_error_last")),
        ("best fitness in reality", ("f_r_best_first_iteration", "f_r_best")),
    ):
        lines.append(f"{label + unit:46}" + "".join(f"{format_number(result[key], 4):>14}" for key in keys))
    fitted = f"{format_number(result['delta_fitness_last'], 4)}{unit}"
    lines.append(f"fitted: Delta_fitness of the final simulation, over the trials it was fitted to: {fitted}")
    lines.append("")
    known = f"{'truth':>11}" if result["truth"] else ""
    lines.append(f"{'parameter':34}{'start':>11}{'identified':>11}  {'90 % interval':>21}{known}")
    for name, value in result["simulation"].items():
        space, truth = result["space"][name], (result["truth"] or {}).get(name)
        label = f"{name} [{space['unit']}]" if space["unit"] else name
        low, high = result["told"]["intervals"][name]
        line = f"{label:34}{result['start'][name]:11.4g}{value:11.4g}  {low:10.4g} {high:10.4g}"
        line += f"{'' if truth is None else format(truth, '.4g'):>11}  {value_note(result, name)}"
        lines.append(line.rstrip())
    lines += result["told"]["combinations"]
    lines += ["", *map(growth_sentence, result["growth"])] if result["growth"] else []
    lines.append("")
    lines.append(f"step 3 minimised {_DISTANCES[result['distance']]} (--distance)")
    lines.append(
        f"{result['reality_evaluations']} evaluations in reality ({result['failed_trials']} failed), "
        f"learning performance {format_number(result['lp'])}, stopped by {result['stop']}; all files in {out}"
    )
    return "\n".join(lines)
