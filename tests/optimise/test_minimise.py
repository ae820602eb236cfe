"""Whether a genetic algorithm finds what there is to find."""

import numpy as np
import pytest
from evolution_checks import HIGH, LOW, least, limbs, run

from btr_mjx.optimise import GAConfig, GeneticAlgorithm

# ---- known optima ----


def test_onemax():
    ga = GeneticAlgorithm(limbs(8), GAConfig(maximise=True, p_m=1 / 64))
    state = run(ga, ga.init(0), lambda g: g.sum(1), 60)
    assert state.best_fitness == 64
    assert state.best_genome.all()


def test_minimising_mirrors_maximising_on_a_deceptive_function():
    """Trap blocks lead away from their optimum: the path depends on every comparison, alike in both directions."""

    def trap(genomes):
        blocks = genomes.reshape(len(genomes), -1, 4).sum(-1)
        return np.where(blocks == 4, 4, 3 - blocks).sum(-1).astype(float)

    states = []
    for maximise, sign in ((True, 1.0), (False, -1.0)):
        ga = GeneticAlgorithm(limbs(4), GAConfig(maximise=maximise))
        states.append(run(ga, ga.init(3), lambda g, sign=sign: sign * trap(g), 30))
    up, down = states
    assert up.best_fitness == -down.best_fitness
    np.testing.assert_array_equal(up.best_genome, down.best_genome)
    np.testing.assert_array_equal(up.parents, down.parents)
    np.testing.assert_array_equal(up.fitness, -down.fitness)
    assert 8 * 3 <= up.best_fitness <= 8 * 4


def sphere(target, rng):
    return lambda x: ((x - target) ** 2).mean(1)


def absolute(target, rng):
    return lambda x: np.abs(x - target).mean(1)


def noisy(target, rng):
    noise = np.random.default_rng(rng.integers(2**32))
    return lambda x: np.abs(x - target).mean(1) + 0.02 * noise.standard_normal(len(x))


def behaviours(target, rng):
    """Like Delta_fitness: mean |f_k(x) - f_k(target)| over 15 smooth curves in which all parameters interact."""
    w = rng.standard_normal((15, len(target), 6)) * 1.5
    phase, height = rng.uniform(0, 6.28, (15, 6)), rng.standard_normal((15, 6))

    def f(x):
        return (height * np.sin(np.einsum("mn,knj->mkj", x, w) + phase)).sum(-1)

    return lambda x: np.abs(f(x) - f(target[None])).mean(1)


def rastrigin(target, rng):
    return lambda x: (25 * (x - target) ** 2 + 1 - np.cos(10 * np.pi * (x - target))).mean(1)


@pytest.mark.parametrize(
    ("make", "n", "bits", "generations", "bar"),
    [
        (sphere, 2, 16, 40, 0.005),
        (sphere, 4, 8, 40, 0.005),
        (absolute, 4, 16, 40, 0.005),
        (noisy, 4, 8, 60, 0.02),
        (behaviours, 4, 8, 40, 0.02),
        (sphere, 12, 8, 60, 0.02),
        (absolute, 12, 12, 60, 0.02),
    ],
)
def test_finds_the_optimum_from_a_start_a_sixth_of_the_range_away(make, n, bits, generations, bar):
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        target = rng.uniform(0.5, 1.5, n)
        start = np.clip(target + 0.2 * rng.choice([-1, 1], n), LOW, HIGH)
        found = least(make(target, rng), limbs(n, bits), seed, generations, start)
        errors.append(np.abs(found - target).mean())
    assert np.median(errors) <= bar
    assert max(errors) <= 2 * bar


def test_rastrigin_from_random_starts():
    errors = []
    for seed in range(5):
        target = np.random.default_rng(seed).uniform(0.5, 1.5, 4)
        errors.append(np.abs(least(rastrigin(target, None), limbs(4), seed, 60) - target).mean())
    assert np.median(errors) <= 0.01


def test_gray_beats_binary():
    errors = {"gray": [], "binary": []}
    for code, found in errors.items():
        for seed in range(6):
            rng = np.random.default_rng(seed)
            target = rng.uniform(0.5, 1.5, 4)
            best = least(absolute(target, rng), limbs(4, code=code), seed, 30)
            found.append(np.abs(best - target).mean())
    assert np.mean(errors["gray"]) < 0.5 * np.mean(errors["binary"])
