"""Results of a finished co-evolution: the content of result.json, and the table that the command prints."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality.algorithm import best_index
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import growth_sentence
from btr_mjx.backtoreality.simulation_search import whole_trial_delta
from btr_mjx.backtoreality.state import Problem, State
from btr_mjx.evaluation import learning_performance


def summarise(problem: Problem, state: State) -> dict[str, Any]:
    """Results of a finished run, as in result.json.

    Returns:
      delta_fitness_first and _last: Delta_fitness of s_0 over the behaviours of iteration 1, and of the last simulation
      over those it was fitted to. parameter_error_first and _last: mean absolute error of the unknown parameters, None
      for a reality that is not simulated. The fitness function's name, unit and direction; bounds and units of the
      unknown parameters (space). reality_evaluations, lp (learning performance) and its terms, the simulation,
      the best controller, the stop criterion that was met, and the noise of a single measurement where trials were
      measured more than once.
    """
    original, problem = problem, grown(problem, state.grown)
    trials, last = state.trials, state.iteration
    latest = trials.iteration == last
    first = trials.iteration == 1
    maximise = problem.fitness.maximise
    f_0 = float(trials.f_r[0])
    best = int(best_index(np.where(latest, trials.f_r, np.nan), maximise))
    f_end, f_max = float(trials.f_r[best]), float(np.nanmax(np.abs(trials.f_r)))
    delta = lambda s, iteration: float(  # noqa: E731
        whole_trial_delta(problem, s[None], trials, iteration)[0]
    )
    indices, box = problem.robot.simulation_box.indices(problem.unknown), problem.simulation_box
    truth = getattr(problem.reality, "truth", None)

    known = original.robot.simulation_box.indices(original.unknown)

    def error(simulation: np.ndarray) -> float | None:
        return None if truth is None else float(np.abs(simulation[known] - np.array(truth)[known]).mean())

    values = lambda s: dict(zip(problem.unknown, np.asarray(s)[indices].tolist(), strict=True))  # noqa: E731
    return {
        "delta_fitness_first": delta(problem.start, 1),
        "delta_fitness_last": delta(state.simulation, last),
        "parameter_error_first": error(problem.start),
        "parameter_error_last": error(state.simulation),
        "reality_evaluations": len(trials),
        "lp": learning_performance(
            f_0 if np.isfinite(f_0) else 0.0, f_end, f_max, problem.controller_box.n, len(trials)
        ),
        "distance": problem.settings.distance,
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
        "measurement_noise": _finite(getattr(problem.reality, "noise", math.nan)) if truth is None else None,
        "iterations": last,
        "stop": state.stop,
        "start": values(problem.start),
        "simulation": values(state.simulation),
        "truth": None if truth is None else dict(zip(original.unknown, np.array(truth)[known].tolist(), strict=True)),
        "growth": list(state.sought),
        "effects": list(state.grown),
        "best_controller": trials.controllers[best].tolist(),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def summary_table(result: dict[str, Any], out: Path) -> str:
    """The table that the command prints at its end."""
    lines = [f"{'':34}{'first':>12}{'last':>12}"]
    for label, name in (("Delta_fitness", "delta_fitness"), ("mean error of unknown parameters", "parameter_error")):
        first, last = result[f"{name}_first"], result[f"{name}_last"]
        if first is not None:
            lines.append(f"{label:34}{first:12.4f}{last:12.4f}")
    lines.append(f"{'best fitness in reality':34}{result['f_r_best_first_iteration']:12.4f}{result['f_r_best']:12.4f}")
    lines.append("")
    lines.append(f"{'parameter':34}{'start':>12}{'identified':>12}{'truth':>12}")
    for name, value in result["simulation"].items():
        truth = "" if name not in (result["truth"] or {}) else f"{result['truth'][name]:12.4f}"
        lines.append(f"{name:34}{result['start'][name]:12.4f}{value:12.4f}{truth}")
    lines += ["", *map(growth_sentence, result["growth"])] if result["growth"] else []
    lines.append("")
    lines.append(
        f"{result['reality_evaluations']} evaluations in reality ({result['failed_trials']} failed), "
        f"learning performance {result['lp']:.3f}, stopped by {result['stop']}; all files in {out}"
    )
    return "\n".join(lines)
