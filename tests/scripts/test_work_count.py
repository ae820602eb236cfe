"""The count of work of `benchmarks/work_count.py` against counts by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import work_count
from jax import lax


def doubled(x: jax.Array, limit: jax.Array) -> jax.Array:
    """Doubled and one added in each lane until the number that was doubled exceeds the lane's limit."""

    def body(carry: tuple) -> tuple:
        moving, x = carry
        return x < limit, jnp.where(moving, 2 * x + 1, x)

    return lax.while_loop(lambda carry: jnp.any(carry[0]), body, (jnp.ones(len(x), bool), x))[1]


def test_operations_of_a_loop_are_those_counted_by_hand() -> None:
    """A run compares, multiplies, adds and selects in every lane, and asks all lanes whether they go on."""
    x, limit = jnp.ones(16), jnp.asarray(np.repeat([2.0, 30.0], 8), jnp.float32)
    hlo = jax.jit(doubled).lower(x, limit).compile().as_text()
    jaxpr = jax.make_jaxpr(doubled)(x, limit)
    (found,), runs = work_count.counted(jaxpr.jaxpr, jaxpr.consts, [x, limit])
    np.testing.assert_array_equal(found, doubled(x, limit))
    # Lanes with the limit 2 stop when they look at 3, the others when they have looked at 1, 3, 7, 15 and 31.
    assert [float(n) for n in runs] == [5, (2 + 5) / 2]
    assert work_count.work_of(hlo, [5])[0] == 5 * (4 + 1) * 16
    assert work_count.work_of(hlo, [1])[0] == (4 + 1) * 16


def test_bytes_are_those_of_arguments_and_results() -> None:
    numbers = jnp.ones((4, 64))
    hlo = jax.jit(lambda x, y: x * y + 1).lower(numbers, numbers).compile().as_text()
    assert work_count.work_of(hlo, []) == (2 * 256, 3 * 256 * 4)
