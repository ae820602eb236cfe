"""Contestants of the league: what labs do today, and what this project does, a function each.

Every one gets a `Task` and hands in an `Answer`: the controller that did best in reality, of all that it tried there.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from contest import Answer, Task, best_index, coded, engine_of, evolved

import btr_mjx as btr
from btr_mjx.backtoreality import CoevolveConfig, begin, build_problem, grown, select_transferable
from btr_mjx.backtoreality.algorithm import advance
from btr_mjx.evaluation import fitness_of
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.models import base_model
from btr_mjx.optimise import cma_es
from btr_mjx.robots import Robot

LISTED: Mapping[str, float] = {
    "dry_friction": 0.1,
    "viscous_damping": 0.1,
    "armature": 0.05,
    "actuator_delay": 0.1,
    "actuator_gain": 0.03,
}
"""The fixed list, a number for each joint or motor: effect -> tolerance of domain randomisation, as a share of the
largest value that the library lets it have."""

_MOST_FITTED = 6
"""Recordings of a least-squares fit: of the latest trials."""


def _listed(task: Task) -> Robot:
    """The robot with the fixed list as further dimensions of S."""
    model = base_model(task.robot)
    entries = [
        {
            "effect": own.effect.name,
            "location": own.place.label,
            "numbers": {p.name: {"value": p.high, "low": p.low, "high": p.high, "null": p.null, "unit": p.unit}},
        }
        for own in candidates(model, Scales.of(model), EFFECTS)
        if own.effect.name in LISTED and not own.place.members
        for p in own.parameters
    ]
    problem = build_problem(CoevolveConfig(unknown=task.unknown, truth=()), task.robot)
    return grown(problem, entries).robot


def _handed_in(
    task: Task, robot: Robot | None = None, simulations: np.ndarray | None = None, found: tuple[str, ...] = ()
) -> Answer:
    """The best controller of all that were tried, with the last simulator."""
    controllers, fitness = task.reality.tried()
    return Answer(controllers[best_index(task.robot, fitness)], robot, simulations, found)


def _tried_once(task: Task, robot: Robot, simulations: np.ndarray) -> Answer:
    """Evolve controllers for the mean of simulations (L, n_s), and try the best of them."""
    generations = task.budget.generations * task.budget.rounds
    genomes, scores = evolved(robot, simulations, task.budget, generations, [task.seed, 1])
    maximise = fitness_of(robot).maximise
    chosen, _ = select_transferable(genomes, scores, task.trials, maximise)
    task.reality.measure(coded(robot).decode(chosen), 0)
    return _handed_in(task, robot, simulations)


def believed(task: Task) -> Answer:
    """The believed model as it is."""
    return _tried_once(task, task.robot, task.robot.nominal_simulation[None])


def randomised(task: Task) -> Answer:
    """Domain randomisation: the best mean over robots within tolerances of what is unknown and of the fixed list."""
    robot, rng = _listed(task), np.random.default_rng([task.seed, 2])
    box, simulations = robot.simulation_box, np.tile(robot.nominal_simulation, (task.budget.draws, 1))
    for i, name in enumerate(box.names):
        if name in task.unknown:
            simulations[:, i] = rng.uniform(box.low[i], box.high[i], task.budget.draws)
        elif name.partition(" ")[0] in LISTED:
            reach = LISTED[name.partition(" ")[0]] * box.high[i]
            simulations[:, i] = np.clip(rng.uniform(-reach, reach, task.budget.draws), box.low[i], None)
    return _tried_once(task, robot, simulations)


def least_squares(task: Task) -> Answer:
    """System identification: unknown numbers and the fixed list are fitted to recordings, then controllers evolved."""
    robot, budget, share = _listed(task), task.budget, task.trials // task.budget.rounds
    simulation, genome = robot.nominal_simulation, None
    maximise = fitness_of(robot).maximise
    for i in range(budget.rounds):
        genomes, scores = evolved(robot, simulation[None], budget, budget.generations, [task.seed, 3, i], genome)
        chosen, _ = select_transferable(genomes, scores, share, maximise)
        measured = task.reality.measure(coded(robot).decode(chosen), len(task.reality.tried()[1]))[:, -1]
        genome = chosen[best_index(robot, measured)]
        simulation = _fitted(task, robot, simulation)
    return _handed_in(task, robot, simulation[None])


def _fitted(task: Task, robot: Robot, simulation: np.ndarray) -> np.ndarray:
    """The simulation (n_s,) whose positions are nearest to those of the latest recordings, in SI units."""
    from scipy.optimize import least_squares as solve

    controllers, fitness = task.reality.tried()
    rows = np.flatnonzero(np.isfinite(fitness))[-_MOST_FITTED:]
    recordings = task.reality.record(controllers[rows], rows)
    times = (recordings[0].time - recordings[0].time[0])[5::5]
    measured = np.stack([recording.qpos[5::5] for recording in recordings])
    box = robot.simulation_box
    names = [n for n in box.names if n in task.unknown or n not in task.robot.simulation_box.names]
    at, own = box.indices(names), box.subspace(names)

    def residuals(points: np.ndarray) -> np.ndarray:
        simulations = np.tile(simulation, (len(points), 1))
        simulations[:, at] = np.clip(own.low + points * own.span, own.low, own.high)
        trials = btr.evaluate(
            *(robot, simulations, controllers[rows]),
            engine=engine_of(robot),
            fitness=robot.fitness,
            times=times,
            states=True,
        )
        assert trials.outcome.qpos is not None
        return np.nan_to_num(trials.outcome.qpos - measured, nan=10.0).reshape(len(points), -1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        step = np.where(x < 0.5, 1e-4, -1e-4)
        out = residuals(np.concatenate([x[None], x + np.diag(step)]))
        return (out[1:] - out[0]).T / step

    start = (simulation[at] - own.low) / own.span
    found = solve(lambda x: residuals(x[None])[0], start, jacobian, (0, 1), max_nfev=task.budget.jacobians)
    out = simulation.copy()
    out[at] = np.clip(own.low + found.x * own.span, own.low, own.high)
    return out


def back_to_reality(
    task: Task, grow_from: Literal["recordings", "fitness"] | None = None, ensemble: int | None = None
) -> Answer:
    """Back-to-Reality: ensembles, and CMA-ES on what is unknown, from fitness; growth where data of it are named."""
    config = CoevolveConfig(
        unknown=task.unknown,
        reality="folder",
        exchange=task.reality.folder,
        engine=engine_of(task.robot),
        fitness=task.robot.fitness,
        optimiser="cma",
        iterations=task.budget.rounds,
        trials=(task.trials - 1) // task.budget.rounds,  # the first controller is a trial, too
        controllers=task.budget.controllers,
        controller_generations=task.budget.generations,
        ensemble=ensemble or task.budget.ensemble,
        simulations=task.budget.simulations,
        simulation_generations=task.budget.simulation_generations,
        grow=grow_from is not None,
        grow_from=grow_from or "fitness",
        seed=task.seed,
    )
    problem = replace(build_problem(config, task.robot), reality=task.reality)
    state = begin(problem)
    while state.phase != "done":
        state = advance(problem, state)
    added = tuple(f"{entry['effect']}@{entry['location']}" for entry in state.grown)
    return _handed_in(task, grown(problem, state.grown).robot, state.simulation[None], added)


def no_simulator(task: Task) -> Answer:
    """CMA-ES on the real robot."""
    box, population = task.robot.controller_box, max(4, task.trials // 5)
    maximise = fitness_of(task.robot).maximise
    strategy = cma_es.restored(np.full(box.n, 0.5), np.zeros((0, population, box.n)), np.zeros((0, population)),
                               population=population, sigma=0.25)  # fmt: skip
    for i in range(task.trials // population):
        members = cma_es.ask(strategy, [task.seed, 4, i])
        fitness = task.reality.measure(box.low + members * box.span, i * population)[:, -1]
        cost = -fitness if maximise else fitness
        cma_es.tell(strategy, members, cost - np.nanmin(cost))
    return _handed_in(task)


CONTESTANTS: Mapping[str, Callable[[Task], Answer]] = {
    "believed": believed,
    "randomised": randomised,
    "back_to_reality": back_to_reality,
    "one_simulation": partial(back_to_reality, ensemble=1),
    "least_squares": least_squares,
    "growth": partial(back_to_reality, grow_from="recordings"),
    "growth_by_fitness": partial(back_to_reality, grow_from="fitness"),
    "no_simulator": no_simulator,
}
"""Contestants by name, in the order of the table."""
