"""Simulation search: step 3 of Back-to-Reality, with the distance of simulations from reality.

There are two optimisers: the genetic algorithm of the paper, and CMA-ES, which also adapts to correlations of many
unknown parameters. Members of CMA-ES are stored as genomes, too, on a very fine grid (`CMA_BITS`), so that records,
checkpoints and figures have one format.
"""

from dataclasses import replace

import numpy as np

from btr_mjx.backtoreality.run_state import Problem, State, Trials
from btr_mjx.backtoreality.settings import SearchSettings
from btr_mjx.evaluation import delta_fitness_of, evaluate, fitness_at_marks, multiscale_fitness
from btr_mjx.optimise import GAConfig, GAState, GeneticAlgorithm, cma_es
from btr_mjx.robots import Box


def genetic_algorithm(box: Box, settings: SearchSettings, maximise: bool) -> GeneticAlgorithm:
    """The genetic algorithm of both searches (controllers and simulations)."""
    elites = min(2, settings.population - 1)
    return GeneticAlgorithm(
        box, GAConfig(population=settings.population, p_m=settings.p_m, elites=elites, maximise=maximise)
    )


def ask_simulations(problem: Problem, state: State) -> tuple[np.ndarray, GAState | None]:
    """The next generation: genomes (L, bits), and the state of the genetic algorithm; None for CMA-ES."""
    box, settings = problem.simulation_box, problem.settings.step_3
    known = state.simulation[problem.robot.simulation_box.indices(problem.unknown)]
    if problem.settings.optimiser == "cma":
        told = _in_cube(box, state.genomes) if len(state.scores) else np.zeros((0, settings.population, box.n))
        start = (known - box.low) / box.span
        strategy = cma_es.restored(start, told, state.scores.reshape(told.shape[:2]), population=settings.population)
        asked = cma_es.ask(strategy, [problem.seed, state.iteration, 3, len(told)])
        return box.encode(np.clip(box.low + box.span * asked, box.low, box.high)), None
    algorithm = genetic_algorithm(box, settings, maximise=False)
    search = state.search
    if search is None:
        search = algorithm.init(problem.rng(state.iteration, 3), genome=box.encode(known))
        if state.iteration == 1:
            # First iteration: the population is random, with s_0 as one of its members.
            drawn = box.random_genomes(problem.rng(0, 3), settings.population)
            search = replace(search, parents=np.concatenate([box.encode(known)[None], drawn[1:]]))
    return algorithm.ask(search)


def tell_simulations(
    problem: Problem, search: GAState | None, genomes: np.ndarray, scores: np.ndarray
) -> GAState | None:
    """State of the genetic algorithm after a generation; None for CMA-ES, which is restored from its history."""
    if search is None:
        return None
    algorithm = genetic_algorithm(problem.simulation_box, problem.settings.step_3, maximise=False)
    return algorithm.tell(search, genomes, scores)


def finished(problem: Problem, state: State) -> bool:
    """Whether the present search has done all its generations or has converged."""
    if len(state.scores) >= problem.settings.simulation_generations:
        return True
    return problem.settings.optimiser == "cma" and cma_es.converged(_in_cube(problem.simulation_box, state.genomes[-1]))


def _in_cube(box: Box, genomes: np.ndarray) -> np.ndarray:
    return (box.decode(genomes) - box.low) / box.span


def delta_of_simulations(problem: Problem, simulations: np.ndarray, trials: Trials, iteration: int) -> np.ndarray:
    """Distances (L,) of simulations (L, n_s) from reality over the behaviours of an iteration; NaN where one diverged.

    Delta_fitness (eq. 4), or `distances.multiscale_fitness`, for which trials are simulated up to the last mark. Trials
    up to this iteration count, see `BTRSettings.behaviours`, but those that failed.
    """
    if problem.settings.compared == "fitness":
        return whole_trial_delta(problem, simulations, trials, iteration)
    use = counting_trials(problem, trials, iteration)
    return multiscale_fitness(compared_fitness(problem, simulations, trials.controllers[use]), trials.f_marks[use])


def compared_fitness(problem: Problem, simulations: np.ndarray, controllers: np.ndarray) -> np.ndarray:
    """Fitness (L, M, K) that step 3 compares: of whole trials, K = 1, or at each mark; NaN where a pair diverged."""
    if problem.settings.compared == "fitness":
        return problem.simulate(simulations, controllers)[..., None]
    evaluation = evaluate(
        problem.robot,
        simulations,
        controllers,
        engine=problem.engine,
        fitness=problem.fitness,
        times=problem.settings.marks,
        progress=problem.progress,
    )
    at_marks = fitness_at_marks(evaluation.outcome, problem.fitness)
    return np.where(evaluation.diverged[..., None], np.nan, at_marks)


def whole_trial_delta(problem: Problem, simulations: np.ndarray, trials: Trials, iteration: int) -> np.ndarray:
    """Delta_fitness (eq. 4), also if step 3 minimises another distance; arguments as of `delta_of_simulations`."""
    use = counting_trials(problem, trials, iteration)
    return delta_fitness_of(problem.simulate(simulations, trials.controllers[use]), trials.f_r[use])


def counting_trials(problem: Problem, trials: Trials, iteration: int) -> np.ndarray:
    """Trials that are compared in an iteration, bool (n,)."""
    first = iteration if problem.settings.behaviours == "latest" else 1
    return (trials.iteration >= first) & (trials.iteration <= iteration) & np.isfinite(trials.f_r)
