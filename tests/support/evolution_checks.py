"""Limb lengths to evolve, and a plain loop that evolves them."""

from btr_mjx.optimise import GAConfig, GeneticAlgorithm
from btr_mjx.robots import Box

KINDS = ["uniform", "one_point", "two_point"]
LOW, HIGH = 0.4, 1.6


def limbs(n, bits=8, code="gray"):
    return Box([f"x{i}" for i in range(n)], LOW, HIGH, bits=bits, code=code)


def run(ga, state, fitness, generations):
    """Plain ask / tell loop over a function of genomes."""
    for _ in range(generations):
        genomes, state = ga.ask(state)
        state = ga.tell(state, genomes, fitness(genomes))
    return state


def least(fn, box, seed, generations, start=None):
    """The best vector of a run that minimises a function of vectors."""
    ga = GeneticAlgorithm(box, GAConfig(maximise=False))
    state = ga.init(seed, None if start is None else box.encode(start))
    return box.decode(run(ga, state, lambda genomes: fn(box.decode(genomes)), generations).best_genome)
