"""`retrace` rule by rule: what is merged, what stays, where barriers go, inside which transformations."""

# ruff: noqa: E731 -- one-line functions under test read best as lambdas

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from retrace_checks import BARRIER, assert_same, names, op_by_op, operations, removed

from btr_mjx.engines.rewriting import retrace

# Common subexpressions


def test_equal_equations_are_merged_and_dead_ones_dropped():
    def fn(x, y):
        a = jnp.sin(x) * y
        b = y * jnp.sin(x)  # both equations are there already
        jnp.cos(x)  # dead
        return a + b

    assert removed(fn, 1.0, 2.0) == 3
    lanes = jax.ShapeDtypeStruct((4,), np.float32)
    assert removed(fn, lanes, lanes) == 3
    assert sorted(names(retrace(fn), 1.0, 2.0)) == ["add", "mul", "sin"]


@pytest.mark.parametrize(
    ("first", "second", "merged"),
    [
        (lambda x: x + 1.0, lambda x: 1.0 + x, 1),
        (lambda x: x - 1.0, lambda x: 1.0 - x, 0),
        (lambda x: x * 0.0, lambda x: x * -0.0, 0),
        (lambda x: x * math.nan, lambda x: x * math.nan, 1),
        (lambda x: lax.max(x, x * 0), lambda x: lax.max(x * 0, x), 1),  # x * 0 only: max(+0, -0) has an order
        (lambda x: lax.integer_pow(x, 2), lambda x: lax.integer_pow(x, 3), 0),
        (lambda x: lax.integer_pow(x, 3), lambda x: lax.integer_pow(x, 3), 1),
        (lambda x: x.astype(jnp.float16), lambda x: x.astype(jnp.bfloat16), 0),
        (lambda x: lax.convert_element_type(x, float), lambda x: lax.convert_element_type(x, np.int32), 0),
        (lambda x: jnp.broadcast_to(x, (2, 3)), lambda x: jnp.broadcast_to(x, (2, 3)), 1),
        (lambda x: jnp.broadcast_to(x, (2, 3)), lambda x: jnp.broadcast_to(x, (3, 3)), 0),
        (lambda x: lax.reduce_precision(x, 8, 7), lambda x: lax.reduce_precision(x, 8, 7), 1),
        (lambda x: lax.optimization_barrier(x), lambda x: lax.optimization_barrier(x), 0),
        (lambda x: jnp.full(3, 1), lambda x: jnp.full(3, True), 0),
        (lambda x: jnp.full(3, 1), lambda x: jnp.full(3, 1.0), 0),
        (lambda x: lax.top_k(x, 2), lambda x: lax.top_k(x, 2), 1),
        (lambda x: jax.random.bits(jax.random.key(3)), lambda x: jax.random.bits(jax.random.key(3)), 0),
    ],
)
def test_what_counts_as_equal(first, second, merged):
    x = jnp.array([0.5, -0.0, 2.0])
    fn = lambda x: (first(x), second(x))
    assert removed(fn, x) == merged
    assert_same(retrace(fn)(x), op_by_op(fn, x))


def test_integers_commute_where_floats_do_not():
    fn = lambda x, y: (lax.max(x, y), lax.max(y, x))
    assert removed(fn, 1, 2) == 1
    assert removed(fn, 1.0, 2.0) == 0


def test_weak_types_survive():
    fn = lambda x: (x * 2 + 1, lax.convert_element_type(x, jnp.float32) * 2)
    assert [a.aval for a in retrace(fn)(3.0)] == [a.aval for a in fn(jnp.asarray(3.0))]
    assert retrace(fn)(3.0)[0].weak_type
    assert not retrace(fn)(3.0)[1].weak_type


def test_a_call_inlined_twice_with_different_arguments():
    @jax.jit
    def square_plus(x, k):
        y = x * x
        return y + k, y

    def fn(x, y):
        return square_plus(x, y), square_plus(y, x), square_plus(*square_plus(x, y))

    assert_same(retrace(fn)(2.0, 5.0), ((9.0, 4.0), (27.0, 25.0), (85.0, 81.0)))
    assert not {"jit", "pjit"} & set(names(retrace(fn), 2.0, 5.0))
    assert operations(retrace(fn), 2.0, 5.0) == 6


def test_nested_calls_share_constants():
    table = np.arange(3.0, dtype=np.float32)
    nested = jax.jit(lambda x: x * table)
    fn = lambda x: nested(x) + nested(x) + x * table
    x = np.ones(3, np.float32)
    assert_same(retrace(fn)(x), op_by_op(fn, x))
    assert_same(jax.jit(retrace(fn))(x), 3 * table)
    assert removed(fn, x) >= 1


def test_calls_that_ask_for_something_stay_but_are_rewritten_inside():
    here = jax.sharding.SingleDeviceSharding(jax.devices()[0])
    placed = jax.jit(lambda x: jnp.sin(x) + jnp.sin(x), out_shardings=here)
    fn = lambda x: placed(x) + 1
    assert names(retrace(fn), 1.0) == ["jit", "sin", "add", "add"]
    assert jax.make_jaxpr(retrace(fn))(1.0).eqns[0].params["out_shardings"] == (here,)
    assert_same(retrace(fn)(1.0), 2 * jnp.sin(1.0) + 1, rtol=1e-6)


# Barriers


def barriers(fn, *args, **options):
    return names(retrace(fn, **options), *args).count(BARRIER)


def test_barriers_where_recomputation_is_dear():
    x = np.ones(4, np.float32)
    shared = lambda op: lambda x: [op(x) * (k + 2.0) for k in range(2)]
    assert barriers(shared(jnp.sin), x) == 1
    assert barriers(shared(lambda x: x + 1), x) == 0
    assert barriers(lambda x: jnp.sin(x) * x, x) == 0  # one reader
    assert barriers(shared(lambda x: x), x) == 0  # in memory already
    assert barriers(shared(lambda x: lax.sin(x).reshape(2, 2)[0]), x) == 1
    jaxpr = jax.make_jaxpr(retrace(shared(jnp.sin)))(x)
    sin, barrier, *readers = jaxpr.eqns
    assert [sin.primitive.name, barrier.primitive.name] == ["sin", BARRIER]
    assert barrier.invars == sin.outvars
    assert all(eqn.invars[0] is barrier.outvars[0] for eqn in readers)


def test_cost_accumulates_until_a_barrier():
    def chain(n):
        def fn(x):
            for k in range(n):
                x = x + float(k)
            return x * 2, x * 3

        return fn

    assert [barriers(chain(n), 1.0) for n in (0, 8, 9, 50)] == [0, 0, 1, 1]
    twice = lambda x: chain(3)(sum(chain(9)(x)))  # after the barrier the count starts again
    assert barriers(twice, 1.0) == 1
    assert barriers(twice, 1.0, threshold=30) == 0
    assert barriers(lambda x: chain(9)(sum(chain(9)(x))), 1.0) == 2


def test_readers_count():
    fan = lambda n: lambda x: [(x + 1) * (k + 2.0) for k in range(n)]
    assert [barriers(fan(n), 1.0) for n in (1, 9, 10)] == [0, 0, 1]
    assert barriers(lambda x: (jnp.sin(x), jnp.sin(x) * 2), 1.0) == 1  # a result is a reader
    assert barriers(lambda x: (jnp.sin(x), jnp.sin(x)), 1.0) == 0  # the same result twice is not
    assert barriers(lambda x: jnp.sin(x) * jnp.sin(x), 1.0) == 0  # nor is the same operand


def test_threshold():
    fn = lambda x: (jnp.sin(x) + 1, jnp.sin(x) + 2)
    assert barriers(fn, 1.0, threshold=30) == 0
    assert barriers(fn, 1.0, threshold=29) == 1
    assert barriers(fn, 1.0, threshold=math.inf) == 0
    assert barriers(lambda x: (x + 1, (x + 1) * 2), 1.0, threshold=0) == 1


def test_no_barrier_on_keys_or_nothing():
    keys = lambda k: (jax.random.bits(jax.random.split(k)[0]), jax.random.key_data(jax.random.split(k)[0]))
    assert_same(retrace(keys, threshold=0)(jax.random.key(1)), keys(jax.random.key(1)))
    empty = lambda x: (jnp.sin(x) + 1, jnp.sin(x) * 2, x.sum())
    assert barriers(empty, np.zeros((0, 3), np.float32), threshold=0) == 0
    assert_same(retrace(empty)(np.zeros((0, 3), np.float32)), empty(np.zeros((0, 3), np.float32)))


def test_hand_written_barriers_stay_and_are_memory():
    def fn(x):
        y = lax.optimization_barrier(jnp.sin(x))
        return y * 2.0, y * 3.0

    assert names(retrace(fn), 1.0) == ["sin", BARRIER, "mul", "mul"]


def test_bodies_of_loops_are_rewritten():
    dear = lambda x: (jnp.sin(x) + 1) * (jnp.sin(x) + 2)
    x = np.linspace(0, 1, 5, dtype=np.float32)
    for fn, expected in [
        (lambda x: lax.fori_loop(0, 3, lambda _, c: dear(c), x), 1),
        (lambda x: lax.while_loop(lambda c: dear(c).sum() < 9, lambda c: c + 1, x), 1),
        (lambda x: lax.scan(lambda c, z: (dear(c), dear(z)), x, x[:, None]), 2),
        (lambda x: lax.cond(x[0] > 0, dear, lambda x: x, x), 1),
        (lambda x: lax.switch(x.argmax(), [dear, jnp.cos, lambda x: dear(dear(x))], x), 3),
        (lambda x: lax.map(lambda y: lax.fori_loop(0, 2, lambda _, c: dear(c), y), x), 1),
    ]:
        assert barriers(fn, x) == expected
        assert names(retrace(fn), x).count("sin") <= expected
        assert_same(retrace(fn)(x), fn(x), rtol=1e-6)
        assert_same(jax.jit(retrace(fn))(x), fn(x), rtol=1e-6)


# Where it may be used, and on what


def test_inside_other_transformations():
    def fn(x, y):
        return jnp.sin(x) * y + jnp.sin(x), jnp.where(x > 0, jnp.sin(x), y)

    new = retrace(fn, threshold=0)
    x, y = np.linspace(-1, 1, 6, dtype=np.float32).reshape(2, 3), np.float32(0.5)
    loop = lambda f: lambda x, y: lax.fori_loop(0, 3, lambda _, c: f(*c), (x, jnp.broadcast_to(y, x.shape)))
    scan = lambda f: lambda x, y: lax.scan(lambda c, z: f(c, z), y * jnp.ones(3), x)
    whilst = lambda f: (
        lambda x, y: lax.while_loop(
            lambda c: f(*c)[0].sum() + c[0].sum() < 99, lambda c: (c[0] + 1, c[1]), (x + 9, 9.0 + y)
        )
    )
    for wrap in (jax.jit, loop, scan, whilst, lambda f: jax.jit(loop(f)), lambda f: jax.vmap(f, (0, None))):
        assert_same(wrap(new)(x, y), wrap(fn)(x, y), rtol=1e-6)
    assert_same(jax.jvp(loop(new), (x, y), (x, y)), jax.jvp(loop(fn), (x, y), (x, y)), rtol=1e-5)
    assert_same(jax.jacrev(new)(x, y), jax.jacrev(fn)(x, y), rtol=1e-6)
    assert_same(jax.hessian(new)(x, y), jax.hessian(fn)(x, y), rtol=1e-6)
    assert_same(jax.linearize(new, x, y)[1](x, y), jax.linearize(fn, x, y)[1](x, y), rtol=1e-6)
    assert_same(jax.checkpoint(new)(x, y), new(x, y))


@pytest.mark.parametrize("check_vma", [False, True])
def test_inside_shard_map(check_vma):
    mesh = jax.make_mesh((1,), ("d",), axis_types=(jax.sharding.AxisType.Auto,))
    spec = jax.sharding.PartitionSpec("d")

    def fn(x):
        y = jnp.sin(x) + lax.psum(x, "d") * lax.axis_index("d")
        y = lax.fori_loop(0, 3, lambda i, c: c * jnp.sin(x) + jnp.sin(x) * i + 1, y)
        return y + jnp.sin(x)

    wrap = functools.partial(jax.shard_map, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=check_vma)
    x = np.linspace(0, 1, 4, dtype=np.float32)
    assert_same(jax.jit(wrap(retrace(fn)))(x), jax.jit(wrap(fn))(x), rtol=1e-6)
    assert_same(jax.jit(retrace(wrap(fn)))(x), jax.jit(wrap(fn))(x), rtol=1e-6)
    assert BARRIER in names(wrap(retrace(fn)), x)


def test_arguments_and_results_of_every_kind():
    table = np.array([[1.5, 2.5]])  # float64 where JAX computes in float32

    def fn(tree, scale, *, shift=0, flag=False):
        a, b = tree["a"], tree["b"][0]
        return (
            {"in": a, "literal": 2.0, "none": None, "twice": (b + shift, b + shift), "sum": a * scale + table},
            flag,
            scale,
        )

    args = ({"a": np.arange(2.0), "b": (np.int16(4), None)}, 3)
    assert_same(retrace(fn)(*args, shift=2, flag=True), jax.jit(fn)(*args, shift=2, flag=True))
    assert_same(jax.jit(retrace(fn))(*args), jax.jit(fn)(*args))
    assert retrace(lambda: ())() == ()
    assert_same(retrace(lambda x: [x, x, 1])(np.float32(3)), jax.jit(lambda x: [x, x, 1])(np.float32(3)))


def test_closures_over_tracers_are_differentiated_and_never_stale():
    def outer(x, custom):
        inner = retrace(lambda y: y * jnp.sin(x) + (jax.nn.relu(x) if custom else 0.0))
        return inner(x) + inner(2.0)

    plain = lambda x, custom: (x + 2) * jnp.sin(x) + (2 * jax.nn.relu(x) if custom else 0.0)
    for custom in (False, True):
        for transform in (jax.grad, lambda f, **k: jax.vmap(jax.grad(f), (0, None)), jax.jacfwd):
            x = np.linspace(0.1, 1, 3, dtype=np.float32) if "lambda" in transform.__name__ else np.float32(0.3)
            assert_same(transform(outer)(x, custom), transform(plain)(x, custom), rtol=1e-5)


def test_custom_derivatives_survive():
    @jax.custom_jvp
    def f(x):
        return jnp.sin(x) * jnp.sin(x)

    f.defjvp(lambda p, t: (f(*p), 100 * t[0]))

    @jax.custom_vjp
    def g(x):
        return x * 2

    g.defvjp(lambda x: (g(x), None), lambda _, c: (7 * c,))
    assert removed(lambda x: f(x) + f(x), 1.0) == 4
    loop = lambda x: lax.fori_loop(0, 2, lambda _, c: f(c) + 1, x)
    for fn in (f, g, lambda x: f(x) * g(x) + g(f(x)), jax.nn.relu, jax.jit(f), lambda x: jax.vmap(f)(x[None])[0]):
        x = jnp.float32(0.0)
        assert_same(jax.grad(retrace(fn))(x), jax.grad(fn)(x))
        assert_same(jax.jit(jax.grad(retrace(retrace(fn))))(x), jax.grad(fn)(x))
        assert_same(retrace(fn)(x), fn(x))
    assert_same(jax.jvp(retrace(loop), (1.0,), (1.0,)), jax.jvp(loop, (1.0,), (1.0,)), rtol=1e-6)
    assert jax.jacfwd(retrace(loop))(1.0) == 10_000


def test_effects_keep_number_and_order():
    seen = []
    note = lambda tag: lambda v: seen.append((tag, float(v)))

    def fn(x):
        jax.debug.callback(note("a"), jnp.sin(x), ordered=True)
        jax.debug.callback(note("b"), jnp.sin(x), ordered=True)
        jax.debug.callback(note("b"), jnp.sin(x), ordered=True)
        y = lax.fori_loop(0, 2, lambda i, c: (jax.debug.callback(note("loop"), c, ordered=True), c + 1)[1], x)
        return jnp.sin(x) + y

    expected = [("a", 0.0), ("b", 0.0), ("b", 0.0), ("loop", 0.0), ("loop", 1.0)]
    for run in (retrace(fn), jax.jit(retrace(fn)), jax.jit(retrace(retrace(fn)))):
        seen.clear()
        assert_same(run(0.0), jnp.asarray(2.0))
        jax.effects_barrier()
        assert seen == expected
    assert removed(fn, 0.0) == 3


def test_references_are_read_when_they_were():
    def fn(x):
        ref = jax.new_ref(jnp.sin(x))
        before = ref[...] * 2
        ref[...] = ref[...] + 1
        return before, ref[...] * 2, lax.fori_loop(0, 2, lambda i, c: c + ref[...], x)

    assert_same(jax.jit(retrace(fn))(np.ones(2, np.float32)), jax.jit(fn)(np.ones(2, np.float32)), rtol=1e-6)


def test_long_programs_take_linear_time():
    """Counting along all paths would take 2**1000 steps; the work of XLA without barriers grows like that too."""

    def chain(n):
        def fn(x):
            for _ in range(n):
                x = lax.add(lax.mul(x, 0.5), lax.mul(lax.add(x, 1.0), 0.25))
            return x

        return fn

    assert operations(retrace(chain(1100), threshold=math.inf), 1.0) == 4400
    assert 0 < barriers(chain(1100), 1.0) < 1100
    np.testing.assert_allclose(jax.jit(retrace(chain(100)))(np.ones(4, np.float32)), np.full(4, 1.0), rtol=1e-5)
