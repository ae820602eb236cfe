"""Small linear algebra on batched scalars, with constant folding of zeros and ones.

A *scalar* of a batched computation is either a Python float (constant, equal in all worlds), a numpy array of shape
(G, 1) (constant, one number per member of a group of G similar links), or a JAX array of shape (C,) or (G, C): the
batch of C worlds is always the last axis. Products with a constant zero or one are simplified while tracing, so that
the sparsity of axis-aligned geometry is used automatically.

Vectors are lists of three scalars, matrices lists of three rows, symmetric matrices lists of six scalars in the order
xx, yy, zz, xy, xz, yz; larger ones also have their diagonal first, then the rows to the right of it.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

type Scalar = Any
"""float | np.ndarray of shape (G, 1) | jax.Array of shape (C,) or (G, C)."""
type Vector = Sequence[Scalar]
type Matrix = Sequence[Sequence[Scalar]]
type Symmetric = Sequence[Scalar]

ZERO: list[float] = [0.0, 0.0, 0.0]
UNIT: list[list[float]] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of each entry of a symmetric 3x3 matrix."""


def constant(values: Any) -> Scalar:
    """A constant scalar: a float if all members of the group agree, else an array of shape (G, 1)."""
    values = np.asarray(values, np.float64)
    first = values.reshape(-1)[0]
    return float(first) if np.all(values == first) else values.reshape(-1, 1)


def is_zero(a: Scalar) -> bool:
    """Whether `a` is the constant zero."""
    return isinstance(a, float) and a == 0.0


def _traced(a: Scalar) -> bool:
    return isinstance(a, jax.Array)


def _like(a: Scalar, b: Scalar) -> Scalar:
    """Cast a constant array to the dtype of its partner, so that float64 constants do not widen the computation."""
    return a.astype(b.dtype) if isinstance(a, np.ndarray) and _traced(b) else a


def add(a: Scalar, b: Scalar) -> Scalar:
    """Sum of two scalars."""
    if is_zero(a):
        return b
    if is_zero(b):
        return a
    if not (_traced(a) or _traced(b)):
        return constant(np.add(a, b))
    return _like(a, b) + _like(b, a)


def sub(a: Scalar, b: Scalar) -> Scalar:
    """Difference of two scalars."""
    if is_zero(b):
        return a
    if is_zero(a):
        return neg(b)
    if not (_traced(a) or _traced(b)):
        return constant(np.subtract(a, b))
    return _like(a, b) - _like(b, a)


def neg(a: Scalar) -> Scalar:
    """Negative of a scalar; the constant zero stays +0."""
    return a if is_zero(a) else -a


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Product of two scalars."""
    if is_zero(a) or is_zero(b):
        return 0.0
    if not (_traced(a) or _traced(b)):
        return constant(np.multiply(a, b))
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float) and abs(one) == 1.0:
            return other if one > 0 else -other
    return _like(a, b) * _like(b, a)


def total(items: Iterable[Scalar]) -> Scalar:
    """Sum of any number of scalars, from the first to the last."""
    result: Scalar = 0.0
    for item in items:
        result = add(result, item)
    return result


def group_sum(a: Scalar, size: int) -> Scalar:
    """Sum over the `size` members of a group, for their common parent; without a group axis all are equal."""
    if size == 1 or is_zero(a):
        return a
    if not _traced(a):
        return float(np.broadcast_to(a, (size, 1)).sum())
    if a.ndim == 1:
        return float(size) * a
    parts = [a[i] for i in range(size)]
    while len(parts) > 1:  # pairwise, for a short dependency chain
        parts = [parts[i] + parts[i + 1] if i + 1 < len(parts) else parts[i] for i in range(0, len(parts), 2)]
    return parts[0]


def array(a: Scalar, shape: tuple[int, ...], dtype: Any) -> jax.Array:
    """The scalar as a JAX array of the full shape, (C,) or (G, C)."""
    return jnp.broadcast_to(jnp.asarray(a, dtype), shape)


def dot(a: Vector, b: Vector) -> Scalar:
    """Inner product."""
    return total(mul(x, y) for x, y in zip(a, b, strict=True))


def vadd(a: Vector, b: Vector) -> list[Scalar]:
    """Elementwise sum of two equally long lists."""
    return [add(x, y) for x, y in zip(a, b, strict=True)]


def vsub(a: Vector, b: Vector) -> list[Scalar]:
    """Elementwise difference of two equally long lists."""
    return [sub(x, y) for x, y in zip(a, b, strict=True)]


def scale(s: Scalar, a: Vector) -> list[Scalar]:
    """Scalar times each element."""
    return [mul(s, x) for x in a]


def cross(a: Vector, b: Vector) -> list[Scalar]:
    """Cross product."""
    return [
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    ]


def tangents(normal: Vector) -> list[list[Scalar]]:
    """Two unit vectors that are normal to each unit vector `normal` and to each other (mju_makeFrame)."""
    level = jnp.abs(normal[1]) < 0.5
    guess = [0.0, jnp.where(level, 1.0, 0.0), jnp.where(level, 0.0, 1.0)]
    tangent = vsub(guess, scale(dot(guess, normal), normal))
    tangent = scale(jax.lax.rsqrt(dot(tangent, tangent)), tangent)
    return [tangent, cross(normal, tangent)]


def matvec(m: Matrix, v: Vector) -> list[Scalar]:
    """Matrix times vector."""
    return [dot(row, v) for row in m]


def transpose(m: Matrix) -> list[list[Scalar]]:
    """Matrix transpose."""
    return [list(column) for column in zip(*m, strict=True)]


def matmul(a: Matrix, b: Matrix) -> list[list[Scalar]]:
    """Matrix product."""
    columns = transpose(b)
    return [[dot(row, column) for column in columns] for row in a]


def full(s: Symmetric) -> list[list[Scalar]]:
    """The rows of a symmetric matrix."""
    n = int((2 * len(s)) ** 0.5)
    rest = iter(s[n:])
    rows: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    for i in range(n):
        rows[i][i] = s[i]
        for j in range(i + 1, n):
            rows[i][j] = rows[j][i] = next(rest)
    return rows


def padded(v: Vector, size: int) -> list[Scalar]:
    """The elements and as many zeros as are missing, if any."""
    return [*v, *[0.0] * (size - len(v))]


def sandwich(m: Matrix, s: Symmetric) -> list[Scalar]:
    """M S M^T for a symmetric S, as a symmetric matrix."""
    half = [matvec(full(s), row) for row in m]
    return [dot(m[i], half[j]) for i, j in SIX]


def axis_rotation(axis: Vector, sine: Scalar, cosine: Scalar) -> list[list[Scalar]]:
    """Rotation matrix about a unit axis (Rodrigues), arranged so that constant components of the axis are folded."""
    result = [[0.0 for _ in range(3)] for _ in range(3)]
    skew = [[0.0, neg(axis[2]), axis[1]], [axis[2], 0.0, neg(axis[0])], [neg(axis[1]), axis[0], 0.0]]
    for i in range(3):
        for j in range(3):
            outer = mul(axis[i], axis[j])
            rest = sub(1.0 if i == j else 0.0, outer)
            result[i][j] = total([outer, mul(rest, cosine), mul(skew[i][j], sine)])
    return result
