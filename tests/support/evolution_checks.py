"""Limb lengths to evolve, and a plain loop that evolves them."""

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
