"""rowwise() on a small kernel: the same function as without chunks, under JAX's transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

from btr_mjx.engines import use_all_cores
from btr_mjx.evaluation.rowwise import rowwise
from btr_mjx.evaluation.traced import TracedArray, in_double

CHUNK = 8


def kernel(table: dict, c: jax.Array) -> dict:
    """A loop of unknown length, two results of different shape."""
    assert c.shape[0] == CHUNK

    def body(carry: tuple) -> tuple:
        k, x = carry
        return k + 1, jnp.sin(x * table["a"]) + (c * table["b"]).sum(-1)

    _, x = jax.lax.while_loop(lambda carry: carry[0] < 5, body, (0, jnp.zeros_like(c[:, 0])))
    return {"scalar": x, "vector": jnp.stack([x, x * c[:, 0]], -1)}


def reference(table: dict, c: jax.Array) -> dict:
    repeated = jax.tree.map(lambda x: jnp.broadcast_to(x, (CHUNK, *x.shape)), (table, c))
    return jax.tree.map(lambda x: x[0], kernel(*repeated))


function = rowwise(kernel, CHUNK)
C = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
TABLE = {"a": np.linspace(0.1, 1, 5, dtype=np.float32), "b": np.arange(15, dtype=np.float32).reshape(5, 3) / 9}
ONE = jax.tree.map(lambda x: x[2], TABLE), C[3]


@pytest.fixture(autouse=True, scope="module")
def _devices() -> None:
    use_all_cores()


def same(f, *arguments) -> None:
    """`f` of the function and of its reference agree in values and structure."""
    got, expected = f(function)(*arguments), f(reference)(*arguments)
    assert jax.tree.structure(got) == jax.tree.structure(expected)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=2e-5, atol=1e-6), got, expected)


def all_pairs(f):
    return jax.vmap(jax.vmap(f, (None, 0)), (0, None))


def test_vmap_to_any_depth() -> None:
    same(lambda f: f, *ONE)
    same(all_pairs, TABLE, C)
    same(lambda f: jax.jit(all_pairs(f)), TABLE, C)
    same(lambda f: jax.vmap(f), TABLE, C[:5])
    # One field of the table is mapped and the other is not; controllers are mapped along their last axis.
    same(lambda f: jax.vmap(f, ({"a": 0, "b": None}, 1)), {"a": TABLE["a"], "b": TABLE["b"][0]}, C[:5].T)
    same(lambda f: jax.vmap(all_pairs(f), (None, 0)), TABLE, np.stack([C, 2 * C]))


def test_bits_do_not_depend_on_the_batch() -> None:
    batch = all_pairs(function)(TABLE, C)
    alone = function(*ONE)
    jax.tree.map(lambda x, y: np.testing.assert_array_equal(x[2, 3], y), batch, alone)


def test_forward_mode() -> None:
    table, c = ONE
    same(lambda f: lambda c: jax.jvp(lambda c: f(table, c), (c,), (jnp.ones_like(c),)), c)
    same(lambda f: lambda c: jax.jvp(lambda c: all_pairs(f)(TABLE, c), (c,), (c,)), C)
    same(lambda f: lambda t: jax.jvp(lambda t: all_pairs(f)({**TABLE, "a": t}, C), (t,), (t,)), TABLE["a"])
    same(lambda f: all_pairs(jax.jacfwd(f, (0, 1))), TABLE, C)
    same(lambda f: jax.jit(jax.jacfwd(jax.jacfwd(f, 1), 1)), table, c)


def test_reverse_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="reverse-mode"):
        jax.grad(lambda c: all_pairs(function)(TABLE, c)["scalar"].sum())(C)


def test_inside_a_shard_map_of_the_callers() -> None:
    mesh = jax.make_mesh((1,), ("c",), axis_types=(AxisType.Auto,))
    specs = PartitionSpec(), PartitionSpec("c")
    mapped = jax.jit(jax.shard_map(all_pairs(function), mesh=mesh, in_specs=specs, out_specs=PartitionSpec(None, "c")))
    jax.tree.map(np.testing.assert_array_equal, mapped(TABLE, C), all_pairs(function)(TABLE, C))


def test_numpy_code_is_traced() -> None:
    def code(x, xs):
        a, b = x[..., 0], x[..., 1:]
        norm = np.linalg.norm(b, axis=-1, keepdims=True)
        mixed = np.where(norm > 1, [1.0, 2.0], b) @ np.ones((2, 2)) + np.concatenate([b, b], -1)[..., :2]
        first, *_ = x
        return np.stack([a, mixed.sum(-1), np.maximum(1, a)], -1) + xs.mean(), first

    x = np.random.default_rng(1).normal(size=(4, 3))

    @jax.jit
    def traced(value):
        wide = TracedArray(value)
        return [jnp.asarray(y) for y in code(wide, wide)]

    for got, expected in zip(traced(jnp.asarray(x, jnp.float32)), code(x, x), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-6)
    with pytest.raises(TypeError, match=r"np\.where"):
        jax.jit(lambda v: bool(TracedArray(v)[0, 0] > 0))(x)


@pytest.mark.filterwarnings("error")
def test_double_precision_within_single() -> None:
    @in_double
    def third(x):
        wide = x.astype(np.float64)
        return ((wide / 3 - np.float64(1) / 3) * 1e9).astype(np.float32), jnp.maximum(wide, 0.5) / 3

    one, slope = jnp.float32(1 + 2**-23), jnp.float32(1.0)
    assert abs(float(jax.jit(third)(one)[0]) - 2**-23 / 3 * 1e9) < 1e-3  # single precision would be off by 10
    (_, wide), (_, slope_wide) = jax.jit(lambda x: jax.jvp(third, (x,), (slope,)))(one)
    assert wide.dtype == slope_wide.dtype == np.float64
    assert float(slope_wide) == 1 / 3
