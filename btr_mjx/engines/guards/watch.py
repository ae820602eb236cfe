"""Evaluation of guards in a step: which worlds of a chunk have a guarded pair that may touch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

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


def _rows(values: Sequence[Any], count: int) -> list[Any]:
    """Parameters of the plan's geoms as arrays (geoms, 1 or C); constants stay NumPy arrays."""
    found = []
    for x in values:
        xp = jnp if isinstance(x, jax.Array) else np
        rows = xp.reshape(x, (1, -1)) if np.ndim(x) < 2 else x
        found.append(xp.broadcast_to(rows, (count, rows.shape[-1])))
    return found


def _poses(poses: Sequence[Pose | None], lanes: int, dtype: Any) -> list[jax.Array]:
    """The twelve numbers of each geom's link (rotation row by row, position), stacked to (geoms, C)."""
    at_rest = ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0], 0)

    def member(x: Any, i: int) -> jax.Array:
        own = x[i] if np.ndim(x) == 2 else x
        return jnp.broadcast_to(jnp.asarray(own, dtype), (lanes,))

    found = []
    for entry in range(12):
        column = []
        for rotation, position, i in (pose or at_rest for pose in poses):
            column.append(member(rotation[entry // 3][entry % 3] if entry < 9 else position[entry - 9], i))
        found.append(jnp.stack(column))
    return found


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
    count = len(plan.geoms)
    local = {key: _rows(parameters[f"guards/{key}"], count) for key in ("centre", "axes", "size", "margin")}
    r = _poses(poses, lanes, dtype)

    def turned(vector: Sequence[Any]) -> list[jax.Array]:
        v = [jnp.asarray(x, dtype) for x in vector]
        return [r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2] for i in range(3)]

    centre = [x + y for x, y in zip(r[9:], turned(local["centre"]), strict=True)]
    axes = [turned(local["axes"][k::3]) for k in range(3)]

    def taken(x: Any, index: np.ndarray) -> jax.Array:
        if len(set(np.diff(index).tolist()) - {1}) == 0:
            return jnp.asarray(x[index[0] : index[-1] + 1], dtype)
        return jnp.asarray(x[index], dtype)

    def shapes(kind: int, index: np.ndarray) -> bounds.Shapes:
        take = lambda xs: [taken(x, index) for x in xs]  # noqa: E731
        return bounds.Shapes(kind, take(centre), [take(axis) for axis in axes], take(local["size"]))

    tripped = jnp.zeros(lanes, bool)
    for group in plan.groups:
        a, b = shapes(group.kinds[0], group.first), shapes(group.kinds[1], group.second)
        margin = taken(local["margin"][0], group.first) + taken(local["margin"][0], group.second)
        limit = jnp.maximum(margin, jnp.asarray(group.explicit, dtype)) + bounds.rounding(a, b)
        # A bound that is not a number is not larger than the limit either.
        tripped = tripped | jnp.any(~(bounds.lower_bound(a, b) > limit), axis=0)
    return tripped
