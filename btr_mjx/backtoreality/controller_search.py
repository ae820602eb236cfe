"""Controller search in one simulation: step 1 of Back-to-Reality, and the selection of step 2."""

import numpy as np

from btr_mjx.backtoreality.run_state import Progress
from btr_mjx.backtoreality.settings import SearchSettings
from btr_mjx.backtoreality.simulation_search import genetic_algorithm
from btr_mjx.evaluation import DISTANCE, Engine, FitnessLike, evaluate, fitness_function
from btr_mjx.robots import Robot


def evolve_controllers(
    robot: Robot,
    simulation: np.ndarray,
    settings: SearchSettings,
    *,
    seed: int,
    genome: np.ndarray | None = None,
    fitness: FitnessLike = DISTANCE,
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
    fitness = fitness_function(fitness, robot.target)
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
