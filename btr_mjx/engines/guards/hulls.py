"""Bounds on the distance of the convex hulls of two meshes, for pairs whose bounding boxes come near from the start.

A direction between the hulls is improved step by step, and the gap along each is a lower bound, as in `bounds`. Each
takes all vertices, so that only few pairs are worth it.

Source: Gilbert 1966, An iterative procedure for computing the minimum of a quadratic form on a convex set.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import lax

from btr_mjx.engines.guards import bounds
from btr_mjx.engines.guards.pairs import BOX, MESH, GeomPair, bounding_box
from btr_mjx.engines.guards.placed_geoms import PlacedGeoms, largest_row
from btr_mjx.engines.scalars import dot, scale, vadd, vsub

_STEPS = 40
"""Directions that are tried; six robots of MuJoCo's Menagerie need 1, 1, 5, 5, 20 and 40."""

_NEAR = 0.25
"""Distance in qpos0 or a keyframe, in half diagonals of a mesh's bounding box, within which its hull is taken.

Others are guarded by their boxes, which takes less time.
Of 8 robots of MuJoCo's Menagerie whose meshes never touch but whose boxes do from the start, guards along native
rollouts of half a second clear 6, with 0 in place of 0.25 only 4.
"""


@dataclass(frozen=True)
class HullPair:
    """Two meshes, by their positions in a list of geoms."""

    first: int
    second: int
    vertices: tuple[np.ndarray, np.ndarray]
    """(V, 3) of each hull, in the axes of the geom about the centre of its bounding box [m]."""


def near_meshes(
    model: mujoco.MjModel, pairs: Sequence[GeomPair], geoms: Sequence[int]
) -> tuple[list[HullPair], list[GeomPair]]:
    """Pairs of meshes whose bounding boxes come near each other in qpos0 or a keyframe; and the other pairs."""
    hulled = [
        model.geom_type[geom] == MESH and model.mesh_polynum[model.geom_dataid[geom]] > 0 for geom in range(model.ngeom)
    ]
    meshes = [pair for pair in pairs if pair.explicit < 0 and hulled[pair.first] and hulled[pair.second]]
    if not meshes:
        return [], list(pairs)
    one, other = (_boxes(model, [getattr(pair, side) for pair in meshes]) for side in ("first", "second"))
    size = jnp.minimum(*(jnp.sqrt(dot(box.size, box.size)) for box in (one, other)))
    near = np.asarray((bounds.lower_bound(one, other) < _NEAR * size).any(axis=1))
    found = [pair for pair, own in zip(meshes, near, strict=True) if own]
    hulls = [
        HullPair(geoms.index(p.first), geoms.index(p.second), (_vertices(model, p.first), _vertices(model, p.second)))
        for p in found
    ]
    return hulls, [pair for pair in pairs if pair not in found]


def _boxes(model: mujoco.MjModel, geoms: Sequence[int]) -> bounds.Shapes:
    """Bounding boxes of P geoms in the S states qpos0 and all keyframes, (P, S)."""
    box = np.array([bounding_box(model, geom) for geom in geoms])
    places, turns = (x[:, geoms].swapaxes(0, 1) for x in _reference_poses(model))
    centre, turned = jnp.asarray(places + (turns @ box[:, None, :3, None])[..., 0]), jnp.asarray(turns)
    vectors = [[turned[..., i, k] for i in range(3)] for k in range(3)]
    half = [jnp.asarray(box[:, 3 + i, None]) for i in range(3)]
    return bounds.Shapes(BOX, [centre[..., i] for i in range(3)], vectors, half)


def _reference_poses(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Positions (S, ngeom, 3) and rotations (S, ngeom, 3, 3) of all geoms in qpos0 and each keyframe."""
    data, places, turns = mujoco.MjData(model), [], []
    for key in range(-1, model.nkey):
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_kinematics(model, data)
        places.append(np.array(data.geom_xpos))
        turns.append(np.array(data.geom_xmat).reshape(-1, 3, 3))
    return np.stack(places), np.stack(turns)


def _vertices(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """The vertices of a mesh's hull, filled up with the first to a power of two, about its bounding box's centre."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_polyadr[mesh])
    faces = range(first, first + int(model.mesh_polynum[mesh]))
    corners = [model.mesh_polyvert[model.mesh_polyvertadr[f] :][: model.mesh_polyvertnum[f]] for f in faces]
    index = np.unique(np.concatenate(corners))
    size = 1 << (len(index) - 1).bit_length()
    index = np.concatenate([index, np.full(size - len(index), index[0])])
    return (
        np.asarray(model.mesh_vert[int(model.mesh_vertadr[mesh]) + index], np.float64) - bounding_box(model, geom)[:3]
    )


def near_hulls(pair: HullPair, geoms: PlacedGeoms, marked: jax.Array, dtype: Any) -> jax.Array:
    """Worlds, bool (C,), in which the hulls may touch; nothing is computed for those that are marked already."""
    one, other = (geoms.shapes(BOX, [index]) for index in (pair.first, pair.second))
    margin = geoms.stacked("margin", [pair.first]) + geoms.stacked("margin", [pair.second])
    limit = (margin + bounds.rounding(one, other))[0]
    between = [x[0] for x in vsub(other.centre, one.centre)]

    def farthest(vertices: np.ndarray, shape: bounds.Shapes, d: Sequence[jax.Array]) -> list[jax.Array]:
        """The vertex that is farthest along d, from the shape's centre."""
        axes = [[x[0] for x in axis] for axis in shape.axes]
        table = [jnp.asarray(vertices[:, k], dtype) for k in range(3)]
        local = [dot(d, axis) for axis in axes]
        index = largest_row(dot([x[:, None] for x in table], local))
        place = [scale(x[index], axis) for x, axis in zip(table, axes, strict=True)]
        return vadd(vadd(place[0], place[1]), place[2])

    def improve(carry: tuple) -> tuple:
        count, v, gap = carry
        back = [-x for x in v]
        w = vsub(vadd(between, farthest(pair.vertices[1], other, back)), farthest(pair.vertices[0], one, v))
        # A vanishing direction stays shorter than a unit vector, which only lowers the bound.
        gap = jnp.maximum(gap, dot(v, w) * lax.rsqrt(jnp.maximum(dot(v, v), 1e-12)))
        e = vsub(w, v)
        length = jnp.clip(-dot(v, e) / jnp.maximum(dot(e, e), 1e-12), 0, 1)
        return count + 1, vadd(v, scale(length, e)), gap

    def doubtful(carry: tuple) -> jax.Array:
        return jnp.any(~(carry[2] > limit) & ~marked) & (carry[0] < _STEPS)

    start = (jnp.int32(0), between, jnp.full(limit.shape, -jnp.inf, limit.dtype))
    return marked | ~(lax.while_loop(doubtful, improve, start)[2] > limit)
