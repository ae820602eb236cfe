"""Lower bounds on the distance of convex geoms, elementwise for P pairs in C worlds.

For any unit vector d, two convex sets A and B with support functions h are at least

    gap(d) = d . (centre_B - centre_A) - h_A(d) - h_B(-d)

apart. The bound is the maximum over a few candidate directions: whatever they are, it never exceeds the distance. For
spheres and capsules one candidate is the direction of their distance, so that the bound is exact; for boxes the
candidates include the axes of the separating-axis test. Meshes and other shapes count as their bounding boxes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

import jax
import jax.numpy as jnp

from btr_mjx.engines.guards.pairs import CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE
from btr_mjx.engines.scalars import cross, dot, scale, vadd, vsub

type Three = Sequence[jax.Array]

SKIN = 1e-5
"""Part of the geoms' size by which bounds are widened, so that rounding in float32 does not clear a touching pair."""


@dataclass(frozen=True)
class Shapes:
    """P geoms of one kind, one of each pair; every array broadcasts to (P, C)."""

    kind: int
    """mujoco.mjtGeom."""
    centre: Three
    """World position [m]; of the bounding box for shapes that count as one."""
    axes: Sequence[Three]
    """The three axes of the geom in the world."""
    size: Three
    """geom_size for primitive shapes, half edges of the bounding box for others [m]."""


def _along(point: Three, length: jax.Array, axis: Three) -> list[jax.Array]:
    return vadd(point, scale(length, axis))


def _reach(s: Shapes, d: Three) -> jax.Array:
    """Support function about the centre: how far the shape reaches along d, which is at most of unit length."""
    if s.kind == SPHERE:
        return s.size[0]
    if s.kind == CAPSULE:
        return s.size[0] + s.size[1] * jnp.abs(dot(d, s.axes[2]))
    across = [dot(d, axis) for axis in s.axes]
    if s.kind == CYLINDER:
        return s.size[1] * jnp.abs(across[2]) + s.size[0] * jnp.sqrt(across[0] ** 2 + across[1] ** 2)
    if s.kind == ELLIPSOID:
        scaled = [r * x for r, x in zip(s.size, across, strict=True)]
        return jnp.sqrt(dot(scaled, scaled))
    return dot(s.size, [jnp.abs(x) for x in across])


def _half_length(s: Shapes) -> jax.Array | None:
    """Half length of the segment inside the geom along its third axis; None for a point."""
    return s.size[1] if s.kind in (CAPSULE, CYLINDER) else None


def _nearest_of_segments(a: Shapes, b: Shapes) -> list[jax.Array]:
    """Vector from the segment (or centre) of A to that of B, where they are nearest to each other."""
    between = vsub(b.centre, a.centre)
    first, second = _half_length(a), _half_length(b)
    if first is None and second is None:
        return between
    if second is None:
        assert first is not None
        return _along(between, -jnp.clip(dot(between, a.axes[2]), -first, first), a.axes[2])
    if first is None:
        return _along(between, jnp.clip(-dot(between, b.axes[2]), -second, second), b.axes[2])
    u, v = a.axes[2], b.axes[2]
    cosine, p, q = dot(u, v), dot(u, between), dot(v, between)
    square = 1 - cosine * cosine
    s = jnp.clip((p - cosine * q) / jnp.where(square > 1e-6, square, 1), -first, first)
    t = jnp.clip(cosine * s - q, -second, second)
    s = jnp.clip(p + cosine * t, -first, first)
    return _along(_along(between, t, v), -s, u)


def _is_boxed(s: Shapes) -> bool:
    return s.kind not in (SPHERE, CAPSULE, CYLINDER, ELLIPSOID, PLANE)


def _core_points(s: Shapes) -> list[Sequence[jax.Array]]:
    """Centre, and ends of the segment."""
    half = _half_length(s)
    ends = [] if half is None else [_along(s.centre, half, s.axes[2]), _along(s.centre, -half, s.axes[2])]
    return [s.centre, *ends]


def _from_box(box: Shapes, point: Three) -> list[jax.Array]:
    """Vector from the nearest point of a box to a point."""
    between = result = vsub(point, box.centre)
    for axis, half in zip(box.axes, box.size, strict=True):
        result = _along(result, -jnp.clip(dot(between, axis), -half, half), axis)
    return list(result)


def _edges(s: Shapes) -> list[Three]:
    """Directions that edges of the shape have."""
    return list(s.axes) if _is_boxed(s) else [] if _half_length(s) is None else [s.axes[2]]


def _candidates(a: Shapes, b: Shapes) -> Iterator[tuple[Three, bool]]:
    """Directions, of any length, and whether both signs of them are candidates."""
    yield _nearest_of_segments(a, b), False
    if a.kind in (SPHERE, CAPSULE) and b.kind in (SPHERE, CAPSULE):
        return
    yield vsub(b.centre, a.centre), False
    for shape in (a, b):
        if _is_boxed(shape) or shape.kind in (CYLINDER, ELLIPSOID):
            for axis in shape.axes if _is_boxed(shape) or shape.kind == ELLIPSOID else shape.axes[2:]:
                yield axis, True
    for e, f in product(_edges(a), _edges(b)):
        yield cross(e, f), True
    if _is_boxed(a):
        for point in _core_points(b):
            yield _from_box(a, point), False
    if _is_boxed(b):
        for point in _core_points(a):
            yield [-x for x in _from_box(b, point)], False


def _gap(a: Shapes, b: Shapes, d: Three, both: bool) -> jax.Array:
    """gap(d), of the better sign if `both`; shapes here are symmetric about their centres."""
    shift = dot(d, vsub(b.centre, a.centre))
    return (jnp.abs(shift) if both else shift) - _reach(a, d) - _reach(b, d)


def lower_bound(a: Shapes, b: Shapes) -> jax.Array:
    """A lower bound on the distance of each pair [m], (P, C); of either sign where the geoms overlap.

    The first geoms may be planes, of which only the third axis counts, the normal.
    """
    if a.kind == PLANE:
        normal = a.axes[2]
        return dot(normal, vsub(b.centre, a.centre)) - _reach(b, normal)
    gaps = []
    for direction, both in _candidates(a, b):
        # A vanishing direction stays shorter than a unit vector, which only lowers the bound.
        inverse = jax.lax.rsqrt(jnp.maximum(dot(direction, direction), 1e-12))
        gaps.append(_gap(a, b, [x * inverse for x in direction], both))
    return reduce(jnp.maximum, gaps)


def rounding(a: Shapes, b: Shapes) -> jax.Array:
    """What the bounds are widened by [m]: for the size of the geoms, and the precision of their positions."""
    sizes = [*b.size, *(() if a.kind == PLANE else a.size)]
    places = [*a.centre, *b.centre]
    # Sums of many terms are fast on the CPU, reductions of stacked arrays are not.
    extent, far = (reduce(jnp.add, [jnp.abs(x) for x in numbers]) for numbers in (sizes, places))
    return SKIN * extent + 16 * float(jnp.finfo(far.dtype).eps) * far
