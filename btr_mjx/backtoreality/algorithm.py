"""The Back-to-Reality algorithm: co-evolve a robot's controller and its simulation.

Iteration i:
  1. Controller search: a population of M controllers, made from c_(i-1) by bit flips or in iteration 1 at random, is
     evolved for a few generations in the best simulation s_(i-1), or for the mean of those that are still possible.
  2. Selection, transfer, test: the m best are tried in reality; the one that is best in reality becomes c_i.
  3. Simulation search: a population of L simulations around s_(i-1) is evolved to minimise Delta_fitness; see
     `simulation_search`.

`advance(problem, state)` does the next piece of work (one generation, or the trials of one iteration in reality) and
returns the state after it. The caller can save the state between pieces; a resumed run gives the same result, to the
bit.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from btr_mjx.backtoreality import simulation_search
from btr_mjx.backtoreality.controller_search import search_controllers
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import calibration_delta, missing_effects
from btr_mjx.backtoreality.run_state import Phase, Problem, State, Trials
from btr_mjx.backtoreality.search_record import Report, after_generation, archive_of, best_index, generation_row
from btr_mjx.backtoreality.simulation_search import (
    delta_of_simulations,
    whole_trial_delta,
)
from btr_mjx.backtoreality.told_words import told_record, told_sentence
from btr_mjx.backtoreality.trial_information import told_by_trials
from btr_mjx.errors import InputError
from btr_mjx.gap.simulate import Counter
from btr_mjx.models import base_model


def begin(problem: Problem, genome: np.ndarray | None = None) -> State:
    """The state before the first piece of work.

    Args:
      problem: the problem.
      genome: (bits,) of c_0; None for a random controller.

    Returns:
      The state in phase "baseline".

    Raises:
      InputError: bad start simulation, genome or marks, or unknown names.
    """
    start = problem.robot.simulation_box.validate(problem.start, "start simulation")
    problem.simulation_box.encode(start[problem.robot.simulation_box.indices(problem.unknown)])
    box = problem.controller_box
    first = box.random_genomes(problem.rng(0, 0)) if genome is None else box.validate_genomes(genome)
    _check_marks(problem)
    marks = np.zeros((0, len(problem.times) - 1))
    trials = Trials(np.zeros((0, box.n)), np.zeros(0), marks, np.zeros(0), np.zeros(0, int))
    others = problem.embed(problem.simulation_box.sample(problem.rng(0, 1), problem.settings.ensemble - 1))
    return State("baseline", 1, start, np.concatenate([start[None], others]), first, trials)


def advance(problem: Problem, state: State, report: Report | None = None, counter: Counter | None = None) -> State:
    """The state after the next piece of work, in phase "done" once a stop criterion is met.

    `report` receives a row per generation and per iteration, see `Report`; `counter` adds up the simulated steps of a
    search for a missing effect.
    """
    report = report or (lambda kind, row: None)
    problem = grown(problem, state.grown)
    if state.phase == "baseline":
        return try_first_controller(problem, state)
    if state.phase == "controllers":
        return search_controllers(problem, state, report)
    if state.phase == "transfer":
        return test_in_reality(problem, state)
    if state.phase == "simulations":
        return search_simulations(problem, state, report)
    if state.phase == "growth":
        return seek_missing_effect(problem, state, report, counter or Counter())
    return state


def run_in_memory(problem: Problem, report: Report | None = None) -> State:
    """Run the whole algorithm without saving anything; the last state. See `advance`."""
    state = begin(problem)
    while state.phase != "done":
        state = advance(problem, state, report)
    return state


def try_first_controller(problem: Problem, state: State) -> State:
    """Try c_0 in reality, which gives f_0, the fitness before learning."""
    controllers = problem.controller_box.decode(state.genome)[None]
    f_s = problem.simulate(state.simulation[None], controllers)[0]
    measured = problem.reality.measure(controllers, len(state.trials), problem.times)
    return replace(state, phase="controllers", trials=state.trials.add(controllers, measured, f_s, 0))


def test_in_reality(problem: Problem, state: State) -> State:
    """Step 2: try the chosen controllers in reality; the state after it begins the simulation search.

    Raises:
      InputError: no controller is transferable, or none of the trials gave a finite fitness.
    """
    genomes, f_s = state.genomes[0], state.scores[0]
    if not len(genomes):
        raise InputError(
            f"iteration {state.iteration}: every controller diverged in the simulation, none can be tried in reality; "
            "start from another simulation or lower the motor gains"
        )
    controllers = problem.controller_box.decode(genomes)
    measured = problem.reality.measure(controllers, len(state.trials), problem.times)
    f_r = measured[:, -1]
    if not np.isfinite(f_r).any():
        raise InputError(f"iteration {state.iteration}: all {len(f_r)} trials in reality failed (fitness is NaN)")
    trials = state.trials.add(controllers, measured, f_s, state.iteration)
    winner = genomes[best_index(f_r, problem.fitness.maximise)]
    before = delta_of_simulations(problem, state.simulation[None], trials, state.iteration)[0]
    return replace(
        state,
        phase="simulations",
        genome=winner,
        trials=trials,
        search=None,
        genomes=state.genomes[:0],
        scores=state.scores[:0],
        delta_before=float(before),
    )


def search_simulations(problem: Problem, state: State, report: Report) -> State:
    """Step 3, one generation: search for the simulation with the smallest distance from reality."""
    genomes, search = simulation_search.ask_simulations(problem, state)
    simulations = problem.embed(problem.simulation_box.decode(genomes))
    scores = delta_of_simulations(problem, simulations, state.trials, state.iteration)
    search = simulation_search.tell_simulations(problem, search, genomes, scores)
    state = after_generation(state, search, genomes, scores)
    report("generation", generation_row(state, "simulations", scores, False))
    if not simulation_search.finished(problem, state):
        return state
    report("archive", archive_of(state, "simulations"))
    return _finish_iteration(problem, state, report)


def _check_marks(problem: Problem) -> None:
    """Raise InputError unless marks are ascending and within the trial."""
    times = problem.times
    if times[0] <= 0 or any(later <= earlier for earlier, later in pairwise(times)):
        raise InputError(
            f"marks: got {list(times[:-1])}, expected ascending times within the trial of {times[-1]} s; "
            "lengthen the trial or give earlier marks"
        )


def _finish_iteration(problem: Problem, state: State, report: Report) -> State:
    settings, box = problem.settings, problem.simulation_box
    finite = np.where(np.isnan(state.scores), np.inf, state.scores)
    generation, member = np.unravel_index(np.argmin(finite), finite.shape)
    after = float(finite[generation, member])
    simulation = problem.embed(box.decode(state.genomes[generation, member]))
    # s_(i-1) need not lie on the grid of genomes, and all simulations may have diverged.
    if after >= state.delta_before:
        simulation, after = state.simulation, state.delta_before
    told = told_by_trials(problem, simulation, state.trials, state.iteration)
    tried = (box.decode(state.genomes).reshape(-1, box.n) - box.low) / box.span
    told = told.beside(tried, state.scores.reshape(-1), after)
    record = told_record(told, box)
    others = told.possible(problem.rng(state.iteration, 4), settings.ensemble - 1)
    latest = state.trials.iteration == state.iteration
    chosen = best_index(np.where(latest, state.trials.f_r, np.nan), problem.fitness.maximise)
    report(
        "iteration",
        {
            "iteration": state.iteration,
            "delta_before": state.delta_before,
            "delta_after": after,
            "f_s_best": float(state.trials.f_s[chosen]),
            "f_r_best": float(state.trials.f_r[chosen]),
            "f_s_mean": float(state.trials.f_s[latest].mean()),
            "f_r_mean": float(np.nanmean(state.trials.f_r[latest])),
            "evaluations": len(state.trials),
            "simulation": simulation,
            "told": told_sentence(record, box),
        },
    )
    stop = ""
    if settings.target_delta is not None and after <= settings.target_delta:
        stop = "target_delta"
    elif state.iteration >= settings.iterations:
        stop = "iterations"
    elif settings.max_evaluations is not None and len(state.trials) + settings.trials > settings.max_evaluations:
        stop = "max_evaluations"
    state = replace(
        state,
        simulation=simulation,
        ensemble=np.concatenate([simulation[None], problem.embed(box.low + box.span * others)]),
        search=None,
        genomes=state.genomes[:0],
        scores=state.scores[:0],
        stop=stop,
        told=record,
    )
    if len(state.grown) < settings.most_effects and not state.sought_here:
        return replace(state, phase="growth", delta_before=after)
    return _next_iteration(state)


def _next_iteration(state: State) -> State:
    phase: Phase = "done" if state.stop else "controllers"
    return replace(state, phase=phase, iteration=state.iteration + (not state.stop), delta_before=np.nan)


def seek_missing_effect(problem: Problem, state: State, report: Report, counter: Counter) -> State:
    """Growth: look for a missing effect where the best simulation leaves more than calibration explains.

    What is found becomes a dimension of S, and step 3 of the same iteration goes on in the larger S.
    """
    steps = round(problem.robot.duration / base_model(problem.robot).opt.timestep)
    problem = replace(problem, progress=lambda pairs: counter.add(pairs * steps))
    report("seeking", {"phase": "errors of calibration"})
    left = float(whole_trial_delta(problem, state.simulation[None], state.trials, state.iteration)[0])
    row: dict[str, Any] = {"iteration": state.iteration, "delta_before": left, "added": []}
    row["calibration"] = calibration_delta(problem, state)
    if not left > row["calibration"]:
        return _next_iteration(replace(state, sought=(*state.sought, row | {"verdict": "within calibration"})))
    found, entries = missing_effects(problem, state, lambda phase: report("seeking", {"phase": phase}), counter)
    row |= found | {"added": [f"{entry['effect']}@{entry['location']}" for entry in entries]}
    report("growth", row)
    if not entries:
        return _next_iteration(replace(state, sought=(*state.sought, row)))
    larger = grown(problem, entries)
    values = [number["value"] for entry in entries for number in entry["numbers"].values()]
    simulation = np.concatenate([state.simulation, values])
    before = delta_of_simulations(larger, simulation[None], state.trials, state.iteration)[0]
    return replace(
        state,
        phase="simulations",
        simulation=simulation,
        delta_before=float(before),
        stop="",
        grown=(*state.grown, *entries),
        sought=(*state.sought, row),
    )
