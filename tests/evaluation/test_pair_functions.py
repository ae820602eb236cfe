"""The one-pair function: `evaluate`'s bits through nested vmaps, derivatives against differences and against MJX.

Derivatives are tested on a small robot, a ball with a leg, in double precision over 40 steps: one simulation starts in
the ground, one falls freely.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lanes_models import QUICK
from small_robots import STEPS
from small_robots import hopper as small_robot

import btr_mjx as btr
from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS, FitnessFunction, evaluate
from btr_mjx.models import compile_models
from btr_mjx.robots import Robot


@pytest.fixture(scope="module")
def hopper() -> Robot:
    return small_robot()


@pytest.fixture
def _double() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


SIMULATIONS = np.array([[0.3, 0.09, 800.0], [0.25, 0.095, 600.0], [0.3, 0.45, 900.0]])


def all_pairs(fitness):
    return jax.vmap(jax.vmap(fitness, (None, 0)), (0, None))


@pytest.mark.filterwarnings("error::UserWarning")
def test_nested_vmap_has_the_bits_of_evaluate(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 7), robot.controller_box.sample(rng, 20)  # two chunks and a part
    expected = evaluate(robot, s, c, engine="lanes").fitness
    leaves, fitness = btr.model_leaves(robot, s), btr.pair_fitness(robot)
    assert {name: leaf.shape for name, leaf in leaves.items()} == {
        name: leaf.shape for name, leaf in compile_models(robot, s).leaves.items() if name in leaves
    }
    mapped = jax.jit(all_pairs(fitness))
    got = mapped(leaves, jnp.asarray(c))
    assert got.shape == (7, 20)
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, expected.astype(np.float32))
    # Theorem 1: the same pairs again, elsewhere in the batch.
    order = rng.permutation(7)
    again = mapped({name: leaf[order] for name, leaf in leaves.items()}, jnp.asarray(c))
    np.testing.assert_array_equal(again, got[order])


@pytest.mark.filterwarnings("error::UserWarning")
def test_one_call_and_trajectories(hopper: Robot, rng: np.random.Generator) -> None:
    c, times = hopper.controller_box.sample(rng, 3), [0.01, 0.02, 0.04]
    leaves = btr.model_leaves(hopper, SIMULATIONS)
    trajectory = all_pairs(btr.pair_trajectory(hopper, times=times))(leaves, jnp.asarray(c))
    exact = evaluate(hopper, SIMULATIONS, c, engine="lanes", times=times, states=True)
    for name in ("position", "energy", "qpos", "qvel"):
        np.testing.assert_array_equal(getattr(trajectory, name), getattr(exact.outcome, name), err_msg=name)
    # Fitness functions are NumPy code, and a call without vmap gives the same bits.
    work = btr.pair_fitness(hopper, fitness=FITNESS_FUNCTIONS["energy_per_metre"])
    expected = FITNESS_FUNCTIONS["energy_per_metre"](exact.outcome)[1, 2]
    assert work({name: leaf[1] for name, leaf in leaves.items()}, c[2]) == np.float32(expected)


@pytest.mark.usefixtures("_double")
def test_derivatives_against_differences_and_mjx(hopper: Robot, rng: np.random.Generator) -> None:
    leaves = btr.model_leaves(hopper, SIMULATIONS)
    c = jnp.asarray(hopper.controller_box.sample(rng, len(SIMULATIONS)))
    moved = FitnessFunction("moved", "m", True, lambda o: np.linalg.norm(o.position[..., -1, :] - o.start, axis=-1))
    fitness = btr.pair_fitness(hopper, fitness=moved, steps=STEPS)
    # Directions: the two parameters of the controller, then some fields of the model.
    fields = ("body_mass", "body_inertia", "geom_pos", "body_pos", "body_ipos")
    zeros = jax.tree.map(jnp.zeros_like, leaves)
    directions = [(zeros, jnp.zeros_like(c).at[:, i].set(1.0)) for i in range(2)]
    for name in fields:
        tangent = 0.1 * jnp.asarray(rng.uniform(0.5, 1, leaves[name].shape)) * jnp.maximum(abs(leaves[name]), 0.01)
        directions.append(({**zeros, name: tangent}, jnp.zeros_like(c)))
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *directions)

    def slopes(one):
        """d fitness of every simulation along every direction, (directions, simulations): jvp of a vmap."""
        along = lambda t: jax.jvp(jax.vmap(one), (leaves, c), t)[1]  # noqa: E731
        return jax.jit(jax.vmap(along), compiler_options=QUICK)(stacked)

    value = jax.jit(jax.vmap(fitness), compiler_options=QUICK)
    along = lambda h, t: jax.tree.map(lambda x, d: x + h * d, (leaves, c), t)  # noqa: E731
    h = 1e-6
    differences = jnp.stack([(value(*along(h, t)) - value(*along(-h, t))) / (2 * h) for t in directions])
    got = slopes(fitness)
    assert got.shape == (2 + len(fields), len(SIMULATIONS))
    assert (jnp.abs(got[:, 0]) > 1e-6).all()  # in contact everything matters
    np.testing.assert_allclose(got, differences, rtol=1e-5, atol=1e-7)
    # The other engine, and the other order of transformations.
    mjx = btr.pair_fitness(hopper, "mjx", fitness=moved, steps=STEPS, chunk=2 * len(SIMULATIONS))
    found = jax.jit(jax.vmap(jax.jacfwd(mjx, argnums=1)), compiler_options=QUICK)(leaves, c).T
    np.testing.assert_allclose(found, got[:2], rtol=1e-4, atol=1e-6)
    with pytest.raises(ValueError, match="reverse-mode"):
        jax.grad(lambda c: fitness({k: v[0] for k, v in leaves.items()}, c))(c[0])


def test_refusals(hopper: Robot) -> None:
    with pytest.raises(InputError, match="native"):
        btr.pair_fitness(hopper, "native")
    with pytest.raises(InputError, match="times"):
        btr.pair_fitness(hopper, steps=0)
    fitness = btr.pair_fitness(hopper)
    with pytest.raises(InputError, match=r"model_leaves.*body_mass"):
        fitness({}, jnp.zeros(2))
