"""Random programs for tests of transformations of jaxprs.

A program is a function of the same seed at every call, so tracing it twice gives the same jaxpr.
"""

# ruff: noqa: E731 -- one-line functions under test read best as lambdas

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from retrace_checks import SHAPES


def broadcast(x, shape):
    if x.shape == shape:
        return x
    if x.shape == (2, 3):  # to anything smaller
        x = lax.slice(x, (1, 0), (2, 3)).reshape(3)
    return jnp.broadcast_to(x if shape else x.ravel()[0], shape)


FLOAT_SMOOTH = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - 0.5 * b,
    "mul": lambda a, b: a * jnp.sin(b),
    "div": lambda a, b: a / (2 + b * b),
    "sqrt": lambda a, b: jnp.sqrt(1 + a * a) - b,
    "sin": lambda a, b: jnp.sin(a + b),
    "convert": lambda a, b: a + b.astype(jnp.float16).astype(a.dtype) if a.dtype == jnp.float16 else a * 1.0 - b,
}
FLOAT_ROUGH = FLOAT_SMOOTH | {
    "max": jnp.maximum,
    "min": lambda a, b: lax.min(a, -b),
    "where": lambda a, b: jnp.where(a < b, a, b * 0),
    "compare": lambda a, b: (a >= b).astype(a.dtype) - 0.0,
    "half": lambda a, b: (a.astype(jnp.float16) * 2 + 1).astype(a.dtype) + b,
    "log": lambda a, b: jnp.log(a) * b,  # NaNs and infinities
    "rsqrt": lambda a, b: lax.rsqrt(a * b),
}
INTEGER = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - 3 * b,
    "mul": lambda a, b: a * b,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "xor": lambda a, b: a ^ b,
    "where": lambda a, b: jnp.where(a < b, a, 7),
    "compare": lambda a, b: (a == b).astype(a.dtype) + b,
    "pow": lambda a, b: lax.integer_pow(a, 3) + lax.integer_pow(b, 2),
}


def straight_line(rng, pool, operations, steps):
    """Applies `steps` random operations, about a third of them done before, perhaps with operands swapped."""
    pool, past = list(pool), []
    for _ in range(steps):
        if past and rng.random() < 0.35:
            name, i, j = past[rng.integers(len(past))]
            i, j = (i, j) if rng.random() < 0.5 else (j, i)
        else:
            name, i, j = rng.choice(list(operations)), *rng.integers(max(0, len(pool) - 8), len(pool), 2)
        past.append((name, i, j))
        shape = max(pool[i].shape, pool[j].shape, key=len)
        pool.append(operations[name](broadcast(pool[i], shape), broadcast(pool[j], shape)))
    return pool


def float_program(number, operations, steps=18):
    """A function of two arrays with a nested jit that is called three times and an expression that occurs twice."""

    def inner(x, y):
        return straight_line(np.random.default_rng(number), [x, y], operations, 5)[-2:]

    nested = jax.jit(inner)
    constant = np.random.default_rng(number).normal(size=3).astype(np.float32)

    def program(x, y):
        rng = np.random.default_rng(number + 1)
        a, b = nested(x, x * 2)
        pool = straight_line(
            rng, [x, y, jnp.asarray(constant), a, b, *nested(y, a), *nested(x, x * 2)], operations, steps
        )
        return {"last": pool[-1], "some": pool[::5], "twice": (pool[-1], jnp.sin(x) * y, y * jnp.sin(x)), "argument": y}

    return program


def integer_program(rng_seed, depth):
    """A function of two int32 arrays with random control flow nested to `depth`; integers are exact under jit too."""

    def program(x, y):
        rng = np.random.default_rng(rng_seed)
        pool = straight_line(rng, [x, y], INTEGER, 6)
        if depth == 0:
            return pool[-1] + pool[-2], pool[-3]
        inner = integer_program(rng_seed + 1, depth - 1)
        a, b = broadcast(pool[-1], (2, 3)), broadcast(pool[-2], (2, 3))
        fit = lambda pair: tuple(broadcast(v, (2, 3)) for v in pair)
        kind = rng.integers(4)
        if kind == 0:
            a, b = lax.fori_loop(0, 3, lambda i, c: fit(inner(c[0] + i, c[1] * a)), (a, b))
        elif kind == 1:
            _, a, b = lax.while_loop(
                lambda c: (c[0] < 4) & (c[0] < 4 + (c[1] ^ c[1]).max()),
                lambda c: (c[0] + 1, *fit(inner(*c[1:]))),
                (0, a, b),
            )
        elif kind == 2:
            a, b = lax.cond(pool[-1].sum() > 0, lambda: fit(inner(a, b)), lambda: (b * a + b * a, a))
        else:
            a, b = lax.scan(lambda c, z: (fit(inner(c, z * a))[0], (z * a + a * z).sum()), a, jnp.arange(3) + b.max())
        pool = straight_line(rng, [*pool, a, b], INTEGER, 6)
        return pool[-1] + pool[-2], pool[-3] * pool[-1]

    return program


def float_inputs(number):
    rng = np.random.default_rng(number)
    return [rng.normal(size=SHAPES[rng.integers(1, 3)]).astype(np.float32) for _ in range(2)]
