"""`retrace` against the random programs it rewrites: same bits op by op, same derivatives, nothing left to do."""

# ruff: noqa: E731 -- one-line functions under test read best as lambdas

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from random_programs import FLOAT_ROUGH, FLOAT_SMOOTH, float_inputs, float_program, integer_program
from retrace_checks import BARRIER, assert_same, names, op_by_op, operations, removed

from btr_mjx.engines.rewriting import retrace

programs = settings(max_examples=6, deadline=None, derandomize=True)


@seed(0)
@programs
@given(st.integers(0, 10**6))
def test_op_by_op_the_bits_are_the_same(number):
    program, inputs = float_program(number, FLOAT_ROUGH), float_inputs(number)
    assert_same(retrace(program, threshold=3)(*inputs), op_by_op(program, *inputs))
    assert removed(program, *inputs) >= 7  # the third call of the nested function at least


@seed(1)
@programs
@given(st.integers(0, 10**6))
def test_smooth_programs_under_jit(number):
    program, inputs = float_program(number, FLOAT_SMOOTH, 10), float_inputs(number)
    assert_same(jax.jit(retrace(program, threshold=2))(*inputs), op_by_op(program, *inputs), rtol=2e-4)
    assert BARRIER in names(retrace(program, threshold=2), *inputs)


@seed(2)
@settings(programs, max_examples=4)
@given(st.integers(0, 10**6), st.integers(1, 2))
def test_nested_control_flow_under_jit_is_exact(number, depth):
    program = integer_program(number, depth)
    rng = np.random.default_rng(number)
    inputs = [rng.integers(-9, 9, size=s).astype(np.int32) for s in ((3,), (2, 3))]
    expected = jax.jit(program)(*inputs)
    with jax.enable_checks(True):
        assert_same(jax.jit(retrace(program, threshold=2))(*inputs), expected)
    batch = [np.stack([x, x + 1, x * 3]) for x in inputs]
    got = jax.jit(jax.vmap(retrace(program, threshold=2)))(*batch)
    assert_same(jax.tree.map(lambda x: x[0], got), expected)
    assert_same(got, jax.jit(jax.vmap(program))(*batch))


@seed(3)
@settings(programs, max_examples=3)
@given(st.integers(0, 10**6))
def test_derivatives_of_random_programs(number):
    program, inputs = float_program(number, FLOAT_SMOOTH, 8), float_inputs(number)
    tangents = [np.cos(x) for x in inputs]
    new = retrace(program, threshold=2)
    assert_same(jax.jvp(new, inputs, tangents), op_by_op(jax.jvp, program, inputs, tangents))
    total = lambda fn: lambda *a: sum(jnp.sum(v) for v in jax.tree.leaves(fn(*a)))
    assert_same(jax.jit(jax.grad(total(new)))(*inputs), jax.jit(jax.grad(total(program)))(*inputs), rtol=1e-3)
    lanes = [np.stack([x, -x]) for x in inputs]
    assert_same(jax.vmap(new)(*lanes), op_by_op(jax.vmap(program), *lanes))


@seed(4)
@programs
@given(st.integers(0, 10**6))
def test_twice_is_once(number):
    for program, inputs in [
        (float_program(number, FLOAT_ROUGH), float_inputs(number)),
        (integer_program(number, 2), [np.arange(3, dtype=np.int32), np.ones((2, 3), np.int32)]),
    ]:
        once = retrace(program, threshold=2)
        assert BARRIER in names(once, *inputs)
        assert operations(once, *inputs) < operations(program, *inputs)
        assert names(retrace(once, threshold=2), *inputs) == names(once, *inputs)
