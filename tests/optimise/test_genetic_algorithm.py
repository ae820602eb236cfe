"""The genetic algorithm on functions with known optimum, and the laws that it keeps."""

import dataclasses
import io

import numpy as np
import pytest
from evolution_checks import KINDS, limbs, run
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from btr_mjx.optimise import GAConfig, GeneticAlgorithm, ga_state_from_arrays, ga_state_to_arrays
from btr_mjx.optimise.operators import crossover
from btr_mjx.robots import Box

# Reproducible examples, and no time limits on a busy machine.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


def assert_same(a, b):
    a, b = ga_state_to_arrays(a), ga_state_to_arrays(b)
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


# ---- ask / tell ----


def test_first_generation_comes_from_the_genome():
    box = limbs(12)
    seed_genome = box.encode(np.full(12, 0.88))
    ga = GeneticAlgorithm(box, GAConfig(maximise=True, population=200, p_m=0.02))
    genomes, _ = ga.ask(ga.init(0, seed_genome))
    assert genomes.shape == (200, 96)
    np.testing.assert_array_equal(genomes[0], seed_genome)
    flips = (genomes[1:] ^ seed_genome).sum()
    low, high = stats.binom.interval(1 - 1e-6, 199 * 96, 0.02)
    assert low <= flips <= high
    random, _ = ga.ask(ga.init(0))
    low, high = stats.binom.interval(1 - 1e-6, 200 * 96, 0.5)
    assert low <= random.sum() <= high


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("maximise", [True, False])
def test_best_never_worsens_and_elites_survive(kind, maximise):
    box = limbs(3)
    ga = GeneticAlgorithm(box, GAConfig(maximise=maximise, population=12, elites=3, crossover=kind, p_m=0.1))
    state, best = ga.init(1), []
    for _ in range(15):
        genomes, asked = ga.ask(state)
        if state.generation:
            np.testing.assert_array_equal(genomes[-3:], state.parents[:3])
        fitness = np.sin(7 * box.decode(genomes)).sum(1)
        state = ga.tell(asked, genomes, fitness)
        order = np.argsort(-fitness if maximise else fitness, kind="stable")
        np.testing.assert_array_equal(state.parents, genomes[order])
        np.testing.assert_array_equal(state.fitness, fitness[order])
        best.append(state.best_fitness)
        np.testing.assert_allclose(np.sin(7 * box.decode(state.best_genome)).sum(), state.best_fitness)
    steps = np.diff(best)
    assert (steps >= 0).all() if maximise else (steps <= 0).all()
    assert state.generation == 15


def test_tournaments_press_towards_the_best():
    """Without variation the winner of t draws out of M has rank r with probability ((M-r)^t - (M-r-1)^t) / M^t."""
    m, t = 10, 3
    box = Box(["x"], 0, 1, bits=4, code="binary")
    config = GAConfig(maximise=False, population=m, tournament=t, elites=0, p_m=0, p_c=0)
    ga = GeneticAlgorithm(box, config)
    counts = np.zeros(m)
    for seed in range(300):
        _, state = ga.ask(ga.init(seed))
        genomes = box.encode(np.arange(m)[:, None] / 15)
        genomes, _ = ga.ask(ga.tell(state, genomes, np.arange(m)))
        counts += np.bincount(np.rint(box.decode(genomes)[:, 0] * 15).astype(int), minlength=m)
    rank = np.arange(m)
    expected = ((m - rank) ** t - (m - rank - 1) ** t) / m**t
    assert stats.chisquare(counts[:7], counts[:7].sum() * expected[:7] / expected[:7].sum()).pvalue > 1e-4


@given(st.integers(0, 2**32), st.booleans(), st.sampled_from(KINDS), st.integers(0, 6), st.booleans())
def test_resume_is_bit_identical(seed, maximise, kind, stop, asked):
    box = limbs(3)
    ga = GeneticAlgorithm(box, GAConfig(maximise=maximise, population=8, crossover=kind))

    def fitness(genomes):
        x = box.decode(genomes)
        return np.where(x[:, 0] > 1.4, np.nan, np.sin(9 * x).sum(1))

    straight = run(ga, ga.init(seed), fitness, 8)
    state = run(ga, ga.init(seed), fitness, stop)
    if asked:  # stopped between ask and tell
        _, state = ga.ask(state)
    file = io.BytesIO()
    np.savez(file, **ga_state_to_arrays(state))
    file.seek(0)
    with np.load(file, allow_pickle=False) as arrays:
        restored = ga_state_from_arrays(arrays)
    assert_same(restored, state)
    assert_same(run(ga, restored, fitness, 8 - stop), straight)


def test_asking_twice_is_asking_once():
    ga = GeneticAlgorithm(limbs(3), GAConfig(maximise=True))
    state = run(ga, ga.init(0), lambda g: g.sum(1), 3)
    first, after = ga.ask(state)
    again, other = ga.ask(state)
    np.testing.assert_array_equal(first, again)
    assert_same(after, other)
    third, same = ga.ask(after)
    np.testing.assert_array_equal(first, third)
    assert same is after


def test_states_cannot_be_changed_from_outside():
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=True))
    genomes, state = ga.ask(ga.init(0))
    with pytest.raises(ValueError, match="read-only"):
        genomes[0] = True
    mine, fitness = genomes.copy(), np.arange(50.0)
    state = ga.tell(state, mine, fitness)
    mine[:], fitness[:] = False, 0
    assert state.best_fitness == 49
    assert state.parents.any()
    with pytest.raises(dataclasses.FrozenInstanceError):
        state.generation = 0


def test_a_generator_as_seed_advances_and_is_not_shared():
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=True))
    rng = np.random.default_rng(0)
    first, second = ga.ask(ga.init(rng))[0], ga.ask(ga.init(rng))[0]
    assert (first != second).any()
    np.testing.assert_array_equal(first, ga.ask(ga.init(np.random.default_rng(0)))[0])


def test_repaired_genomes_replace_those_asked():
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=True, population=4))
    genomes, state = ga.ask(ga.init(0))
    repaired = genomes.copy()
    repaired[2] = True
    state = ga.tell(state, repaired, [0, 0, 1, 0])
    assert state.best_genome.all()


# ---- failures ----


@given(st.lists(st.sampled_from([np.nan, np.inf, -np.inf, 1.0, 2.0]), min_size=8, max_size=8), st.booleans())
def test_failures_are_never_best_parent_or_elite(fitness, maximise):
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=maximise, population=8, p_m=0, p_c=0))
    genomes, state = ga.ask(ga.init(0))
    state = ga.tell(state, genomes, fitness)
    finite = np.isfinite(fitness)
    if not finite.any():
        assert state.best_genome is None
        assert np.isnan(state.best_fitness)
        return
    best = (np.max if maximise else np.min)(np.array(fitness)[finite])
    assert state.best_fitness == best
    allowed = {g.tobytes() for g in genomes[finite]}
    assert state.best_genome.tobytes() in allowed
    children, _ = ga.ask(state)
    assert {g.tobytes() for g in children} <= allowed


def test_a_generation_of_failures_keeps_the_parents():
    ga = GeneticAlgorithm(limbs(3), GAConfig(maximise=False))
    failed = np.full(50, np.nan)
    genomes, asked = ga.ask(ga.init(0))
    first = ga.tell(asked, genomes, failed)
    assert first.generation == 1
    np.testing.assert_array_equal(first.parents, genomes)
    again, asked = ga.ask(first)
    assert (again != genomes).any()
    state = ga.tell(asked, again, again.sum(1))
    before = ga_state_to_arrays(state)
    children, asked = ga.ask(state)
    state = ga.tell(asked, children, failed)
    for name in ("parents", "fitness", "best_genome", "best_fitness"):
        np.testing.assert_array_equal(ga_state_to_arrays(state)[name], before[name])
    assert (ga.ask(state)[0] != children).any()


# ---- bad input ----


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"p_m": 1.5}, r"p_m: got 1\.5, expected a probability within \[0, 1\]"),
        ({"p_m": float("nan")}, "p_m: got nan"),
        ({"p_c": -0.1}, r"p_c: got -0\.1"),
        ({"population": 1}, "population: got 1, expected a whole number, 2 or more"),
        ({"population": 20.0}, r"population: got 20\.0"),
        ({"elites": 50}, "elites: got 50, expected fewer than the population of 50"),
        ({"elites": -1}, "elites: got -1"),
        ({"tournament": 0}, "tournament: got 0"),
        ({"crossover": "three_point"}, "crossover: got 'three_point', expected one of 'uniform'"),
        ({"maximise": "yes"}, "maximise: got 'yes'"),
    ],
)
def test_config_errors(settings, message):
    with pytest.raises(ValueError, match=message):
        GAConfig(**{"maximise": True} | settings)


def test_direction_is_required():
    with pytest.raises(TypeError, match="maximise"):
        GAConfig()


def test_protocol_errors():
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=True, population=4))
    fresh = ga.init(0)
    with pytest.raises(ValueError, match=r"tell: got a state with no genomes asked, .* call ask"):
        ga.tell(fresh, fresh.parents, np.zeros(4))
    genomes, state = ga.ask(fresh)
    with pytest.raises(ValueError, match=r"fitness of shape \(4, 1\), expected \(4,\)"):
        ga.tell(state, genomes, np.zeros((4, 1)))
    with pytest.raises(ValueError, match=r"fitness of shape \(3,\)"):
        ga.tell(state, genomes, np.zeros(3))
    with pytest.raises(ValueError, match="expected real numbers"):
        ga.tell(state, genomes, ["a"] * 4)
    with pytest.raises(ValueError, match=r"genomes of shape \(3, 16\), expected \(4, 16\)"):
        ga.tell(state, genomes[:3], np.zeros(3))
    with pytest.raises(ValueError, match="belongs to another configuration or box"):
        GeneticAlgorithm(limbs(3), GAConfig(maximise=True, population=4)).ask(fresh)
    with pytest.raises(ValueError, match=r"genome: got shape \(2, 16\), expected \(16,\)"):
        ga.init(0, np.zeros((2, 16), bool))
    with pytest.raises(ValueError, match="equal shapes"):
        crossover(genomes, genomes[:2], 0.5, "uniform", np.random.default_rng(0))
    with pytest.raises(ValueError, match="expected one of"):
        crossover(genomes, genomes, 0.5, "none", np.random.default_rng(0))


def test_altered_states_are_refused():
    ga = GeneticAlgorithm(limbs(2), GAConfig(maximise=True, population=4))
    arrays = ga_state_to_arrays(ga.init(0))
    with pytest.raises(ValueError, match="got no stream"):
        ga_state_from_arrays({k: v for k, v in arrays.items() if k != "stream"})
    with pytest.raises(ValueError, match=r"got fitness of type float64 and shape \(3,\), expected float64 and \(4,\)"):
        ga_state_from_arrays(arrays | {"fitness": np.zeros(3)})
    with pytest.raises(ValueError, match="got parents of type uint8"):
        ga_state_from_arrays(arrays | {"parents": np.zeros((4, 16), np.uint8)})
