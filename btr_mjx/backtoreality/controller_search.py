"""Controller search: step 1 of Back-to-Reality, and the selection of step 2."""

from dataclasses import replace

import numpy as np

from btr_mjx.backtoreality.run_state import Problem, Progress, State
from btr_mjx.backtoreality.search_record import Report, after_generation, archive_of, generation_row
from btr_mjx.backtoreality.settings import SearchSettings
from btr_mjx.backtoreality.simulation_search import genetic_algorithm
from btr_mjx.backtoreality.told_words import told_by_plan
from btr_mjx.backtoreality.trial_information import informative, told_by_trials
from btr_mjx.evaluation import Engine, FitnessLike, evaluate, fitness_of
from btr_mjx.optimise import GAState, GeneticAlgorithm
from btr_mjx.robots import Robot


def search_controllers(problem: Problem, state: State, report: Report) -> State:
    """Step 1, one generation: evolve controllers for the mean of the ensemble, that is in s_(i-1) where it is one."""
    settings, box = problem.settings.step_1, problem.controller_box
    algorithm = genetic_algorithm(box, settings, maximise=problem.fitness.maximise)
    genomes, search = algorithm.ask(state.search or _first_population(problem, state, algorithm))
    scores = problem.simulate(state.ensemble, box.decode(genomes)).mean(axis=0)
    state = after_generation(state, algorithm.tell(search, genomes, scores), genomes, scores)
    report("generation", generation_row(state, "controllers", scores, problem.fitness.maximise))
    if len(state.scores) < settings.generations:
        return state
    report("archive", archive_of(state, "controllers"))
    genomes, scores = _chosen(problem, state)
    if state.iteration == 1 and len(genomes):
        report("planned", {"told": told_by_plan(problem, state.simulation, box.decode(genomes))})
    return replace(state, phase="transfer", search=None, genomes=genomes[None], scores=scores[None])


def _first_population(problem: Problem, state: State, algorithm: GeneticAlgorithm) -> GAState:
    """The state with which step 1 begins, see `BTRSettings.first_population`."""
    rng = problem.rng(state.iteration, 1)
    if state.iteration > 1 or problem.settings.first_population == "mutants":
        return algorithm.init(rng, genome=state.genome)
    drawn = algorithm.init(rng)
    return replace(drawn, parents=np.concatenate([state.genome[None], drawn.parents[1:]]))


def _chosen(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Genomes (m, bits) of the controllers that are tried, and their fitness in simulation."""
    settings, maximise = problem.settings, problem.fitness.maximise
    if settings.choose == "informative":
        last = select_transferable(state.genomes[-1:], state.scores[-1:], settings.controllers, maximise)
        if len(last[0]) > settings.trials:
            told = told_by_trials(problem, state.simulation, state.trials, state.iteration)
            order = informative(problem, told, problem.controller_box.decode(last[0]))[: settings.trials]
            return last[0][order], last[1][order]
    return select_transferable(state.genomes, state.scores, settings.trials, maximise)


def evolve_controllers(
    robot: Robot,
    simulation: np.ndarray,
    settings: SearchSettings,
    *,
    seed: int,
    genome: np.ndarray | None = None,
    fitness: FitnessLike | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Step 1 without the rest of the algorithm: evolve controllers in one simulation.

    Args:
      robot: the robot.
      simulation: (n_s,).
      settings: of the search.
      seed: of all random numbers.
      genome: (bits,) initial genome; None for a random one.
      fitness: see `evaluate`.
      engine: see `evaluate`.
      progress: called with the number of pairs simulated since the last call.

    Returns:
      (g, M, bits) all generations in order and (g, M) their fitness; see `select_transferable`.
    """
    fitness = fitness_of(robot, fitness)
    box = robot.controller_box.with_bits(settings.bits)
    algorithm = genetic_algorithm(box, settings, fitness.maximise)
    rng = np.random.default_rng([seed, 0, 1])
    search = algorithm.init(rng, genome=genome)
    genomes, scores = [], []
    for _ in range(settings.generations):
        asked, search = algorithm.ask(search)
        evaluation = evaluate(robot, simulation, box.decode(asked), engine=engine, fitness=fitness, progress=progress)
        search = algorithm.tell(search, asked, evaluation.fitness[0])
        genomes.append(asked)
        scores.append(evaluation.fitness[0])
    return np.array(genomes), np.array(scores)


def select_transferable(
    genomes: np.ndarray, scores: np.ndarray, trials: int, maximise: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Step 2, selection: the best transferable controllers of the last generation.

    A controller is transferable if its fitness in simulation is finite (decoded parameters are always within bounds).
    Equal genomes count once. If the last generation has too few, the best ones of the generation before are added, and
    so on.

    Returns:
      (m', bits) genomes and (m',) scores of genomes (g, M, bits) and scores (g, M), at most `trials`, best first within
      each generation.
    """
    chosen: dict[bytes, tuple[np.ndarray, float]] = {}
    for generation, values in zip(genomes[::-1], scores[::-1], strict=True):
        order = np.argsort(-values if maximise else values, kind="stable")
        for genome, value in zip(generation[order], values[order], strict=True):
            if len(chosen) < trials and np.isfinite(value):
                chosen.setdefault(genome.tobytes(), (genome, float(value)))
    if not chosen:
        return genomes[0, :0], scores[0, :0]
    picked, values = zip(*chosen.values(), strict=True)
    return np.array(picked), np.array(values)
