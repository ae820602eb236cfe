"""Mutation and crossover: their rates, and what children take from whom."""

import numpy as np
import pytest
from evolution_checks import KINDS
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from btr_mjx.optimise import mutate
from btr_mjx.optimise.operators import crossover

# Reproducible examples, and no time limits on a busy machine.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


@pytest.mark.parametrize("p_m", [0.02, 0.2, 0.5])
def test_mutation_rate_is_binomial(p_m):
    genomes = np.random.default_rng(0).random((500, 288)) < 0.5
    flips = mutate(genomes, p_m, np.random.default_rng(1)) ^ genomes
    n = flips.size
    low, high = stats.binom.interval(1 - 1e-6, n, p_m)
    assert low <= flips.sum() <= high
    # Every bit position alike, and flips per genome distributed as the binomial.
    low, high = stats.binom.interval(1 - 1e-6 / 288, 500, p_m)
    assert ((low <= flips.sum(0)) & (flips.sum(0) <= high)).all()
    variance = flips.sum(1).var() / (288 * p_m * (1 - p_m))
    assert 0.7 < variance < 1.35


def test_mutation_extremes_and_independence_of_input():
    genomes = np.random.default_rng(0).random((5, 16)) < 0.5
    before = genomes.copy()
    rng = np.random.default_rng(1)
    np.testing.assert_array_equal(mutate(genomes, 0.0, rng), genomes)
    np.testing.assert_array_equal(mutate(genomes, 1.0, rng), ~genomes)
    np.testing.assert_array_equal(genomes, before)


@given(st.sampled_from(KINDS), st.integers(1, 12), st.floats(0, 1), st.integers(0, 2**32))
def test_children_take_every_bit_from_a_parent(kind, n_bits, p_c, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.random((2, 20, n_bits)) < 0.5
    child = crossover(first, second, p_c, kind, rng)
    assert ((child == first) | (child == second)).all()
    same = crossover(first, first, p_c, kind, rng)
    np.testing.assert_array_equal(same, first)


@pytest.mark.parametrize("kind", KINDS)
def test_crossover_structure(kind):
    zeros, ones = np.zeros((4000, 10), bool), np.ones((4000, 10), bool)
    child = crossover(zeros, ones, 1.0, kind, np.random.default_rng(0))
    changes = (child != np.roll(child, 1, axis=1)).sum(1)  # around the ring
    if kind != "uniform":
        assert (changes == 2).all()
    if kind == "one_point":
        assert not child[:, 0].any()
        assert child[:, -1].all()
    else:
        np.testing.assert_allclose(child.mean(0), 0.5, atol=0.05)
    assert not crossover(zeros, ones, 0.0, kind, np.random.default_rng(0)).any()
    half = crossover(zeros, ones, 0.5, "one_point", np.random.default_rng(0)).any(1)
    assert stats.binom.interval(1 - 1e-6, 4000, 0.5)[0] <= half.sum() <= stats.binom.interval(1 - 1e-6, 4000, 0.5)[1]
