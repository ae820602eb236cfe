"""Geoms in the world, stacked for many pairs of them: what guards and contacts between bodies start from."""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from btr_mjx.engines.guards.bounds import Shapes

type Pose = tuple[Sequence[Sequence[Any]], Sequence[Any], int]
"""Rotation and position of a link in the world, scalars of shape (C,) or (G, C), and the member of the group."""

_MANY = 150
"""Pairs above which their numbers are read by index."""

_KEYS = ("centre", "axes", "size", "margin")


class GeomParameters(Protocol):
    """Scalars by name, such as `lanes_engine.parameters.Parameters`."""

    def __getitem__(self, key: str, /) -> list[Any]: ...


class PlacedGeoms:
    """Numbers of geoms in C worlds."""

    def __init__(self, parameters: GeomParameters, poses: Sequence[Pose | None], lanes: int, dtype: Any):
        """Place the geoms of links in poses, or of the world (None), in C = `lanes` worlds.

        Of all geoms in their links the parameters hold "geoms/centre" (3), "geoms/axes" (9, a matrix row by row),
        "geoms/size" (3) and "geoms/margin" (1).
        """
        self.lanes, self._dtype = lanes, dtype
        self._stacks: dict[tuple[str, int], jax.Array] = {}
        self._numbers: list[dict[str, list[Any]]] = []
        for k, pose in enumerate(poses):
            own = {key: [_number(x, k, dtype) for x in parameters[f"geoms/{key}"]] for key in _KEYS}
            self._numbers.append(own | {"place": _place(own, pose)})

    def stacked(self, key: str, index: Sequence[int], entry: int = 0) -> jax.Array:
        """One number of some geoms, (P, C)."""
        rows = [self._numbers[i][key][entry] for i in index]
        if len(rows) <= _MANY:
            return stack_rows(rows, self.lanes, self._dtype)
        # Reading by index is slower than a stack of its own, which takes too long to compile for many pairs.
        every = (key, entry)
        if every not in self._stacks:
            own = [numbers[key][entry] for numbers in self._numbers]
            self._stacks[every] = stack_rows(own, self.lanes, self._dtype)
        return self._stacks[every][np.array(index)]

    def shapes(self, kind: int, index: Sequence[int]) -> Shapes:
        """Some geoms, all of one kind."""
        vectors = [[self.stacked("place", index, 3 * k + i) for i in range(3)] for k in range(4)]
        return Shapes(kind, vectors[0], vectors[1:], [self.stacked("size", index, i) for i in range(3)])


def stack_rows(rows: Sequence[Any], lanes: int, dtype: Any) -> jax.Array:
    """Numbers or arrays (C,) as one array (P, C)."""
    full = [jnp.broadcast_to(jnp.asarray(row, dtype), (lanes,)) for row in rows]
    # Without the barrier XLA fuses the concatenation into its consumers, as a chain of branches for every element.
    return lax.optimization_barrier(jnp.stack(full))


def fold_rows(combine: Callable[[jax.Array, jax.Array], jax.Array], x: jax.Array) -> jax.Array:
    """All rows of an array (P, C) combined, (C,): by halves, which is elementwise, while XLA's reductions are not."""
    rest = []
    while len(x) > 1:
        half = len(x) // 2
        rest += [x[2 * half :]] if len(x) % 2 else []
        x = combine(x[:half], x[half : 2 * half])
        x = lax.optimization_barrier(x) if half > 8 else x
    return reduce(combine, [*rest, x])[0]


def largest_row(values: jax.Array) -> jax.Array:
    """Row of the largest of each column, the first of several: by halves, elementwise, of a power of two rows."""
    index = lax.broadcasted_iota(jnp.int32, values.shape, 0)
    while len(values) > 1:
        half = len(values) // 2
        better = values[half:] > values[:half]
        values, index = (jnp.where(better, x[half:], x[:half]) for x in (values, index))
        if half > 8:  # otherwise XLA computes all of it for every element
            values, index = lax.optimization_barrier((values, index))
    return index[0]


def member(x: Any, i: int) -> Any:
    """The row of a member of a group; numbers and rows of single links stay as they are."""
    return x[i] if np.ndim(x) == 2 else x


def _place(numbers: Mapping[str, list[Any]], pose: Pose | None) -> list[Any]:
    """Twelve numbers of a geom in the world: its centre and its three axes, one after the other."""
    local = [numbers["centre"], *(numbers["axes"][k::3] for k in range(3))]
    if pose is None:
        return [x for vector in local for x in vector]
    rotation = [[member(x, pose[2]) for x in row] for row in pose[0]]
    found = []
    for vector in local:
        found += [sum(r * v for r, v in zip(row, vector, strict=True)) for row in rotation]
    position = [member(x, pose[2]) for x in pose[1]]
    return [*(c + p for c, p in zip(found[:3], position, strict=True)), *found[3:]]


def _number(x: Any, k: int, dtype: Any) -> Any:
    """The number of the k-th geom: a constant of the computation's precision, or a row (C,)."""
    own = x[k] if np.ndim(x) == 2 else x
    return own if isinstance(own, jax.Array) else np.asarray(own, dtype).reshape(-1)[0]
