"""Growth: a simulator that lacks a physical effect gets it, and the space of simulations one dimension more.

After step 3, what the best simulation leaves of Delta_fitness is compared with what small errors of calibration would
leave. Where it is more, recordings of the trials are searched for the effect that is missing; where reality gives none,
`fitness_growth` does with fitness. A named effect becomes part of the robot (`grown`), its numbers become dimensions of
S as wide as their intervals, and step 3 goes on in the larger S.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.backtoreality.fitness_growth import seek_by_fitness
from btr_mjx.backtoreality.run_state import Problem, State
from btr_mjx.evaluation import evaluate
from btr_mjx.gap.data import Dataset, Recording, Split
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import identify
from btr_mjx.gap.results import Diagnosis, FoundEffect, hypothesis_in_words, resolve_effect, write_world
from btr_mjx.gap.simulate import Counter, World, differing_fields
from btr_mjx.models import PathParameter, general_model, read_field, write_field
from btr_mjx.robots import Robot

_DRAWS = 8
"""Simulated robots that differ by calibration alone; the median Delta_fitness among them is not worth a search."""

_WIDER = 3.0
"""Width of a new dimension, in half-widths of the interval of its number."""

_MOST_RECORDINGS = 12
"""Recordings of a search: of the latest trials."""

_MOST_PROPOSALS = 4
"""Effects that recordings propose to a search by fitness."""


@dataclass(frozen=True)
class Calibration:
    """Small errors of calibration as an edit of a model; it takes no parameter of S."""

    draw: int
    parameters: tuple[str, ...] = ()

    def __call__(self, model: Any, values: Sequence[float]) -> None:
        """Add errors of one standard deviation to whatever calibration leaves."""
        rng, world = np.random.default_rng([97, self.draw]), World.of(model)
        for candidate in candidates(model, Scales.of(model), EFFECTS):
            first = candidate.parameters[0]
            if first.tolerance > 0 and not candidate.place.members:
                size = first.null + first.tolerance * rng.normal()
                numbers = candidate.null
                numbers[0] = np.clip(size, first.low, first.high)
                candidate.apply(world, numbers)
        write_world(model, world)


@dataclass(frozen=True)
class _Unknown(PathParameter):
    """An unknown parameter of S for a diagnosis: whatever it changes in the model of a simulation.

    Attributes:
      robot: the robot.
      simulation: the simulation whose model is diagnosed.
    """

    robot: Robot = field(kw_only=True)
    simulation: tuple[float, ...] = field(kw_only=True)

    def value(self, model: mujoco.MjModel) -> float:
        """Its value in the simulation."""
        return self.simulation[self.robot.simulation_box.index(self.name)]

    def write(self, model: mujoco.MjModel, value: float) -> None:
        """Add what changes between the simulation and one with another value."""
        for name, change in _changes(self.robot, self.simulation, self.name, value).items():
            write_field(model, name, read_field(model, name) + change)


@lru_cache(maxsize=64)
def _changes(robot: Robot, simulation: tuple[float, ...], name: str, value: float) -> Mapping[str, np.ndarray]:
    """What changes in the fields of a model when a simulation gets another value of a parameter."""
    there = np.array(simulation)
    there[robot.simulation_box.index(name)] = value
    before, after = _model_at(robot, simulation), World.of(general_model(robot, there))
    return {name: own - read_field(before, name) for name, own in differing_fields(after, before).items()}


@lru_cache(maxsize=4)
def _model_at(robot: Robot, simulation: tuple[float, ...]) -> mujoco.MjModel:
    """The model of a simulation (shared: do not edit it)."""
    return World.of(general_model(robot, np.array(simulation))).model


def unknown_parameters(problem: Problem, simulation: np.ndarray) -> tuple[PathParameter, ...]:
    """The unknown parameters of S as parameters of a diagnosis of a simulation (n_s,)."""
    box, values = problem.robot.simulation_box, tuple(simulation.tolist())
    return tuple(
        _Unknown(box.names[i], (), float(box.low[i]), float(box.high[i]), robot=problem.robot, simulation=values)
        for i in box.indices(problem.unknown)
    )


def calibration_delta(problem: Problem, state: State) -> float:
    """Delta_fitness that errors of calibration alone leave over the present trials; the median of a few draws."""
    rows = np.isfinite(state.trials.f_r)
    controllers = state.trials.controllers[rows]
    edits = [(), *((Calibration(draw),) for draw in range(_DRAWS))]
    own, *others = (
        evaluate(
            replace(problem.robot, edits=(*problem.robot.edits, *added)),
            state.simulation,
            controllers,
            fitness=problem.fitness,
            engine="native",
            progress=problem.progress,
        ).fitness[0]
        for added in edits
    )
    return float(np.median([np.nanmean(np.abs(other - own)) for other in others]))


def seek(
    problem: Problem,
    state: State,
    recordings: Sequence[Recording],
    most: int,
    note: Callable[[str], None] | None = None,
    counter: Counter | None = None,
) -> Diagnosis:
    """Diagnose what the best simulation lacks, from recordings of trials.

    Args:
      problem: the problem.
      state: with the best simulation.
      recordings: in the order of the trials; the last third is held out.
      most: effects that may be added: more are not sought.
      note: called with a word on what is being done.
      counter: adds up the simulated steps, see `identify`.

    Returns:
      The diagnosis.
    """
    model = general_model(problem.robot, state.simulation)
    used = recordings[-_MOST_RECORDINGS:]
    held_out = max(1, len(used) // 3)
    sides: list[Split] = ["test" if i >= len(used) - held_out else "fit" for i in range(len(used))]
    split = [replace(r, model=model, split=side, interpolation="cubic") for r, side in zip(used, sides, strict=True)]
    # What is searched in S may move along with an effect.
    believed = unknown_parameters(problem, state.simulation)
    data = Dataset(Path(), model, Path("robot.xml"), "", believed, tuple(split))
    return identify(data, max_effects=most, seed=problem.seed, progress=note, counter=counter)


def entries_of_diagnosis(diagnosis: Diagnosis, problem: Problem, state: State, most: int) -> list[dict[str, Any]]:
    """Effects of a diagnosis as entries of `State.grown`, `most` of them at most."""
    entries: list[dict[str, Any]] = []
    model, misfit = general_model(problem.robot, state.simulation), diagnosis.misfit
    for effect in diagnosis.effects[:most]:
        sizes = {name: estimate.value for name, estimate in effect.parameters.items()}
        own, place, _ = resolve_effect(model, FoundEffect(effect.effect, effect.location, sizes), EFFECTS)
        lowest = {p.name: p.low for p in own.parameters(model, Scales.of(model), place)}
        numbers = {}
        for name, estimate in effect.parameters.items():
            reach = _WIDER * (estimate.reach or 0.0)
            reach = reach if reach > 0 else max(abs(estimate.value - estimate.null), 1e-9)
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
                "gap_before": misfit.before if misfit else None,
                "gap_after": misfit.after if misfit else None,
            }
        )
    return entries


def proposals(diagnosis: Diagnosis) -> list[FoundEffect]:
    """Effects that follow recordings better than the model, though none of them well enough to be named."""
    if diagnosis.verdict == "none":
        return []
    rows = [row for row in diagnosis.ranking if row.score > 0 and not row.beside][:_MOST_PROPOSALS]
    return [FoundEffect(row.effect, row.location, row.parameters) for row in rows]


def missing_effects(
    problem: Problem, state: State, note: Callable[[str], None], counter: Counter
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Search recordings of the trials, or their fitness, for what the best simulation lacks.

    Args:
      problem: as it has grown so far.
      state: with the trials.
      note: called with a word on what is being done.
      counter: adds up the simulated steps, see `seek`.

    Returns:
      What the search says, for `State.sought`, and what is to be added, for `State.grown`.
    """
    most = problem.settings.most_effects - len(state.grown)
    record = getattr(problem.reality, "record", None) if problem.settings.grow_from == "recordings" else None
    rows = np.flatnonzero(np.isfinite(state.trials.f_r))
    # A diagnosis starts from a model, in which effects of a simulator would be missing again.
    recordings = record(state.trials.controllers[rows], rows) if record and problem.robot.simulator is None else []
    found, proposed = dict[str, Any](), list[FoundEffect]()
    if len(recordings) >= 2:
        diagnosis = seek(problem, state, recordings, most, note, counter)
        found = {"from": "recordings", "verdict": diagnosis.verdict, "unexplained": list(diagnosis.unexplained)}
        found["ranking"] = [f"{row.effect}@{row.location}" for row in diagnosis.ranking[:5]]
        entries = entries_of_diagnosis(diagnosis, problem, state, most)
        proposed = proposals(diagnosis)
        if entries or not proposed:
            return found, entries
    note("fitness with each effect")
    search = seek_by_fitness(problem, state, proposed)
    ranking = [f"{entry['effect']}@{entry['location']}" for entry in search.ranking]
    added = list(search.ranking[:1]) if search.verdict == "effect" else []
    return found | {"from": "fitness", "verdict": search.verdict, "ranking": ranking}, added


def growth_sentence(row: Mapping[str, Any]) -> str:
    """What a search for a missing effect came to, of an entry of `State.sought`."""
    where = f"iteration {row['iteration']}: Delta_fitness {row['delta_before']:.4g}"
    if row["verdict"] == "within calibration":
        return f"{where} is no more than errors of calibration leave ({row['calibration']:.4g}): nothing is sought"
    if row["added"]:
        return f"{where}; missing: {', '.join(map(hypothesis_in_words, row['added']))}, now part of the simulator"
    data = "recordings" if row["from"] == "recordings" else "fitness alone"
    return f"{where}; the search for a missing effect by {data} says {row['verdict']}"
