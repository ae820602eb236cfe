"""Growth: a simulator that lacks a physical effect gets it, and the space of simulations one dimension more.

After step 3, what the best simulation leaves of Delta_fitness is compared with what small errors of calibration would
leave. Where it is more, recordings of the trials are searched for the effect that is missing. A named effect becomes
an edit of the model, its numbers become dimensions of S as wide as their intervals, and step 3 goes on in the larger S.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality.state import Problem, State
from btr_mjx.evaluation import evaluate
from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import identify
from btr_mjx.gap.results import Diagnosis, EffectEdit, FoundEffect, is_model_edit, resolve_effect
from btr_mjx.models import PathParameter, general_model
from btr_mjx.robots import Box, Robot

_DRAWS = 8
"""Simulated robots that differ by calibration alone; the largest Delta_fitness among them is not worth a search."""

_WIDER = 3.0
"""Width of a new dimension, in half-widths of the interval of its number."""

_MOST_RECORDINGS = 12
"""Recordings of a search: of the latest trials."""


@dataclass(frozen=True)
class _Calibration:
    """Small errors of calibration as an edit of a model; it takes no parameter of S."""

    draw: int
    parameters: tuple[str, ...] = ()

    def __call__(self, model: Any, values: Sequence[float]) -> None:
        """Add errors of one standard deviation to whatever calibration leaves."""
        rng = np.random.default_rng([97, self.draw])
        for candidate in candidates(model, Scales.of(model), EFFECTS):
            first = candidate.parameters[0]
            if first.tolerance > 0 and not candidate.place.members:
                size = first.null + first.tolerance * rng.normal()
                numbers = candidate.null
                numbers[0] = np.clip(size, first.low, first.high)
                EffectEdit(candidate.effect, candidate.place, ())(model, numbers.tolist())


def grown(problem: Problem, entries: Sequence[Mapping[str, Any]]) -> Problem:
    """The problem with the effects that were added to it.

    Args:
      problem: as it began.
      entries: of `State.grown`.

    Returns:
      The problem; its unknown parameters are those at the beginning, then the numbers of the effects.
    """
    if not entries:
        return problem
    robot = _grown_robot(problem.robot, json.dumps(list(entries)))
    added = robot.simulation_box.names[problem.robot.simulation_box.n :]
    start = np.concatenate([problem.start, robot.nominal[problem.robot.simulation_box.n :]])
    return replace(problem, robot=robot, unknown=(*problem.unknown, *added), start=start)


@lru_cache(maxsize=16)
def _grown_robot(robot: Robot, entries: str) -> Robot:
    model = general_model(robot, robot.nominal_simulation)
    box, nominal, edits = robot.simulation_box, list(robot.nominal), list(robot.edits)
    names, low, high, units = list(box.names), box.low.tolist(), box.high.tolist(), list(box.units)
    for entry in json.loads(entries):
        found = FoundEffect(entry["effect"], entry["location"], {n: d["value"] for n, d in entry["numbers"].items()})
        effect, place, _ = resolve_effect(model, found, EFFECTS)
        own = tuple(f"{entry['effect']} {entry['location']} {name}" for name in entry["numbers"])
        edits.append(EffectEdit(effect, place, own))
        names += own
        for number in entry["numbers"].values():
            low.append(number["low"])
            high.append(number["high"])
            nominal.append(number["null"])
            units.append(number["unit"])
    bits = [*box.bits, *[max(box.bits)] * (len(names) - box.n)]
    whole = Box(names, low, high, bits=bits, code=box.code, units=units)
    return replace(robot, simulation_box=whole, nominal=tuple(nominal), edits=tuple(edits))


def calibration_delta(problem: Problem, state: State) -> float:
    """Delta_fitness that errors of calibration alone leave over the present trials; the largest of a few draws."""
    rows = np.isfinite(state.trials.f_r)
    controllers = state.trials.controllers[rows]
    own = evaluate(problem.robot, state.simulation, controllers, fitness=problem.fitness, engine="native").fitness[0]
    left = []
    for draw in range(_DRAWS):
        robot = replace(problem.robot, edits=(*problem.robot.edits, _Calibration(draw)))
        other = evaluate(robot, state.simulation, controllers, fitness=problem.fitness, engine="native").fitness[0]
        left.append(float(np.nanmean(np.abs(other - own))))
    return max(left)


def seek(problem: Problem, state: State, recordings: Sequence[Recording], seed: int) -> Diagnosis:
    """Diagnose what the best simulation lacks, from recordings of the trials.

    Args:
      problem: the problem, grown so far.
      state: after step 3.
      recordings: of trials, in the order of the trials; the last third is held out.
      seed: of the resampling behind intervals.
    """
    model = general_model(problem.robot, state.simulation)
    used = recordings[-_MOST_RECORDINGS:]
    held_out = max(1, len(used) // 3)
    split = [replace(r, model=model, split="test" if i >= len(used) - held_out else "fit") for i, r in enumerate(used)]
    values = dict(zip(problem.robot.simulation_box.names, state.simulation.tolist(), strict=True))
    # What is searched in S may move along with an effect.
    believed = tuple(
        edit
        for edit in problem.robot.edits
        if isinstance(edit, PathParameter) and edit.name in problem.unknown and not edit.relative
        if edit.low <= values[edit.name] <= edit.high
    )
    data = Dataset(Path(), model, Path("robot.xml"), "", believed, tuple(split), "cubic")
    return identify(data, seed=seed)


def entries_of_diagnosis(diagnosis: Diagnosis, problem: Problem, state: State, most: int) -> list[dict[str, Any]]:
    """Effects of a diagnosis as entries of `State.grown`: those that a model can have, `most` of them at most."""
    entries: list[dict[str, Any]] = []
    model = general_model(problem.robot, state.simulation)
    for effect in diagnosis.effects:
        sizes = {name: estimate.value for name, estimate in effect.parameters.items()}
        own, place, values = resolve_effect(model, FoundEffect(effect.effect, effect.location, sizes), EFFECTS)
        if len(entries) == most or not is_model_edit(own, model, place, values.tolist()):
            continue
        lowest = {p.name: p.low for p in own.parameters(model, Scales.of(model), place)}
        numbers = {}
        for name, estimate in effect.parameters.items():
            reach = _WIDER * max(estimate.high - estimate.value, estimate.value - estimate.low)
            reach = reach if np.isfinite(reach) and reach > 0 else max(abs(estimate.value - estimate.null), 1e-9)
            # The null stays possible: whether the effect is there is for step 3 to say. Friction is not negative.
            low = min(max(estimate.value - reach, lowest[name]), estimate.null)
            high = max(estimate.value + reach, estimate.null)
            numbers[name] = {
                "value": estimate.value,
                "low": low,
                "high": high,
                "null": estimate.null,
                "unit": estimate.unit,
            }
        entries.append(
            {
                "effect": effect.effect,
                "location": effect.location,
                "numbers": numbers,
                "iteration": state.iteration,
                "gap_before": diagnosis.gap.before,
                "gap_after": diagnosis.gap.after,
            }
        )
    return entries


def growth_sentence(row: Mapping[str, Any]) -> str:
    """What a search for a missing effect came to, of an entry of `State.sought`."""
    where = f"iteration {row['iteration']}: Delta_fitness {row['delta_before']:.4g}"
    if row["verdict"] == "within calibration":
        return f"{where} is no more than errors of calibration leave ({row['calibration']:.4g}): nothing is sought"
    if row["verdict"] == "no recordings":
        return f"{where} is more than errors of calibration leave, but there are no recordings to search"
    if row["added"]:
        return f"{where}; missing: {', '.join(row['added'])}, now part of the simulator"
    named = ", ".join(row.get("named", []))
    why = f"; {named} cannot be part of a model" if named else ""
    return f"{where}; the search for a missing effect says {row['verdict']}{why}"
