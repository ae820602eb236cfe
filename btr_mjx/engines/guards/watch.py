"""Evaluation of guards in a step: which worlds of a chunk have a guarded pair that may touch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import lax

from btr_mjx.engines.guards import bounds
from btr_mjx.engines.guards.pairs import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE, GeomPair

type Pose = tuple[Sequence[Sequence[Any]], Sequence[Any], int]
"""Rotation and position of a link in the world, scalars of shape (C,) or (G, C), and the member of the group."""


class GuardParameters(Protocol):
    """Scalars by name, such as `lanes.parameters.Parameters`."""

    def __getitem__(self, key: str, /) -> list[Any]: ...


@dataclass(frozen=True)
class GuardGroup:
    """Guarded pairs whose geoms are of the same two kinds."""

    kinds: tuple[int, int]
    first: np.ndarray
    """Index into the geoms of the plan, of each pair."""
    second: np.ndarray
    explicit: np.ndarray
    """(P, 1) margin of the <pair> element that names the geoms [m], -inf where none does."""


@dataclass(frozen=True)
class GuardPlan:
    """Guarded pairs of a model."""

    geoms: tuple[int, ...]
    """All geoms that take part, by MuJoCo's numbers."""
    groups: tuple[GuardGroup, ...]

    @property
    def pairs(self) -> int:
        """Number of guarded pairs."""
        return sum(len(group.first) for group in self.groups)


def shape_kind(model: mujoco.MjModel, geom: int) -> int:
    """The kind of shape that a geom counts as: itself for a primitive, else its bounding box."""
    kind = int(model.geom_type[geom])
    return kind if kind in (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER) else BOX


def plan_guards(model: mujoco.MjModel, pairs: Sequence[GeomPair]) -> GuardPlan:
    """Sort guarded pairs by the kinds of their geoms."""
    geoms = tuple(sorted({g for pair in pairs for g in (pair.first, pair.second)}))
    kinds = [tuple(shape_kind(model, g) for g in (pair.first, pair.second)) for pair in pairs]
    groups = []
    for both in sorted(set(kinds)):
        alike = [pair for pair, kind in zip(pairs, kinds, strict=True) if kind == both]
        first = np.array([geoms.index(p.first) for p in alike])
        second = np.array([geoms.index(p.second) for p in alike])
        margins = model.pair_margin + model.pair_gap
        explicit = np.array([[margins[p.explicit] if p.explicit >= 0 else -np.inf] for p in alike])
        groups.append(GuardGroup((both[0], both[1]), first, second, explicit))
    return GuardPlan(geoms, tuple(groups))


def _member(x: Any, i: int) -> Any:
    """The row of a member of a group; numbers and rows of single links stay as they are."""
    return x[i] if np.ndim(x) == 2 else x


def _place(numbers: Mapping[str, list[Any]], pose: Pose | None) -> list[Any]:
    """Twelve numbers of a geom in the world: its centre and its three axes, one after the other."""
    local = [numbers["centre"], *(numbers["axes"][k::3] for k in range(3))]
    if pose is None:
        return [x for vector in local for x in vector]
    rotation = [[_member(x, pose[2]) for x in row] for row in pose[0]]
    found = []
    for vector in local:
        found += [sum(r * v for r, v in zip(row, vector, strict=True)) for row in rotation]
    position = [_member(x, pose[2]) for x in pose[1]]
    return [*(c + p for c, p in zip(found[:3], position, strict=True)), *found[3:]]


def crossed(
    plan: GuardPlan, parameters: GuardParameters, poses: Sequence[Pose | None], lanes: int, dtype: Any
) -> jax.Array:
    """Worlds in which the bound of some guarded pair is crossed; no other world has a contact of these pairs.

    Args:
      plan: the guarded pairs.
      parameters: "guards/centre" (3), "guards/axes" (9, a matrix row by row), "guards/size" (3) and "guards/margin" (1)
        of the plan's geoms in their links.
      poses: of the link of each geom of the plan; None for geoms fixed to the world.
      lanes: number C of worlds.
      dtype: of the computation.

    Returns:
      bool (C,); also where the pose of a guarded geom is not finite.
    """
    numbers = []
    for k, pose in enumerate(poses):
        own = {key: [_number(x, k, dtype) for x in parameters[f"guards/{key}"]] for key in _KEYS}
        numbers.append(own | {"place": _place(own, pose)})

    def stacked(key: str, entry: int, index: np.ndarray) -> jax.Array:
        """One number of the geoms of a group's pairs, (P, C)."""
        rows = [jnp.broadcast_to(jnp.asarray(numbers[i][key][entry], dtype), (lanes,)) for i in index]
        # Without the barrier XLA fuses the concatenation into its consumers, as a chain of branches for every element.
        return lax.optimization_barrier(jnp.stack(rows))

    def shapes(kind: int, index: np.ndarray) -> bounds.Shapes:
        vectors = [[stacked("place", 3 * k + i, index) for i in range(3)] for k in range(4)]
        return bounds.Shapes(kind, vectors[0], vectors[1:], [stacked("size", i, index) for i in range(3)])

    tripped = jnp.zeros(lanes, bool)
    for group in plan.groups:
        a, b = shapes(group.kinds[0], group.first), shapes(group.kinds[1], group.second)
        margin = stacked("margin", 0, group.first) + stacked("margin", 0, group.second)
        limit = jnp.maximum(margin, jnp.asarray(group.explicit, dtype)) + bounds.rounding(a, b)
        # A bound that is not a number is not larger than the limit either.
        tripped = tripped | jnp.any(~(bounds.lower_bound(a, b) > limit), axis=0)
    return tripped


_KEYS = ("centre", "axes", "size", "margin")


def _number(x: Any, k: int, dtype: Any) -> Any:
    """The number of the k-th geom: a constant of the computation's precision, or a row (C,)."""
    own = x[k] if np.ndim(x) == 2 else x
    return own if isinstance(own, jax.Array) else np.asarray(own, dtype).reshape(-1)[0]
