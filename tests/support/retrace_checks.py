"""What tests of `retrace` compare functions by."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from btr_mjx.engines.rewriting import retrace

SHAPES = ((), (3,), (2, 3))
BARRIER = "optimization_barrier"


def assert_same(got, expected, *, rtol=0.0):
    """Same tree, shapes, types; same bits if `rtol` is 0, where any NaN stands for any other."""
    assert jax.tree.structure(got) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        assert (np.shape(a), jnp.result_type(a)) == (np.shape(b), jnp.result_type(b))
        if rtol:
            np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol)
        else:
            a, b = np.asarray(a), np.asarray(b)
            np.testing.assert_array_equal(a, b)
            nan = a != a
            np.testing.assert_array_equal(np.signbit(a[~nan]), np.signbit(b[~nan]))


def equations(jaxpr):
    """All equations of a jaxpr, those of nested ones too."""
    for eqn in jaxpr.eqns:
        yield eqn
        for inner in core.jaxprs_in_params(eqn.params):
            yield from equations(inner)


def names(fn, *args):
    return [eqn.primitive.name for eqn in equations(jax.make_jaxpr(fn)(*args))]


def operations(fn, *args):
    """Equations that compute: neither barriers nor calls."""
    calls = {BARRIER, "jit", "pjit", "closed_call", "custom_jvp_call"}
    return sum(name not in calls for name in names(fn, *args))


def removed(fn, *args):
    """Equations that `retrace` merges or drops."""
    return operations(fn, *args) - operations(retrace(fn), *args)


def op_by_op(fn, *args):
    with jax.disable_jit():
        return fn(*args)
