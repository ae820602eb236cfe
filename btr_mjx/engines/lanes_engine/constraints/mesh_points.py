"""Points of a mesh that can touch a plane: the vertex nearest to the plane, and others of a face of its convex hull.

The face is the one around that vertex that is turned most towards the plane; of a face with more than four corners,
four are taken. All vertices are compared side by side, as rows of arrays (V, C) or (V, G, C), where MuJoCo climbs from
vertex to vertex. Where several are equally near, either engine takes one of them, as rounding decides.

Source: mjc_PlaneConvex as of MuJoCo 3.17, google-deepmind/mujoco, and polygonQuad of its engine_collision_gjk.c.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from btr_mjx.engines.guards.placed_geoms import largest_row
from btr_mjx.engines.scalars import Vector, array, dot

CORNERS = 4
"""Points of a mesh that touch a plane, at most."""


@dataclass(frozen=True)
class Hulls:
    """Convex hulls of the meshes of G geoms, in the axes of the geoms about their centres [m].

    V and F are powers of two; what there is less of is filled up with the first vertex, or the first face.
    """

    vertices: np.ndarray
    """(V, G, 3)"""
    normals: np.ndarray
    """(V, G, F, 3) of the faces around each vertex, outwards."""
    corners: np.ndarray
    """(V, G, F, 3, 3) of each face that can touch with the vertex; the centre where there are fewer."""


def hulls(model: mujoco.MjModel, geoms: Sequence[int]) -> Hulls:
    """The convex hulls of some mesh geoms."""
    found = [_faces_around(model, int(model.geom_dataid[geom])) for geom in geoms]
    rows, width = (
        1 << (max(sizes) - 1).bit_length()
        for sizes in ([len(own) for own in found], [len(faces) for own in found for _, faces in own])
    )
    vertices, normals = np.zeros((rows, len(geoms), 3)), np.zeros((rows, len(geoms), width, 3))
    corners = np.zeros((rows, len(geoms), width, CORNERS - 1, 3))
    for g, own in enumerate(found):
        for v in range(rows):
            vertices[v, g], faces = own[v if v < len(own) else 0]
            for f in range(width):
                normals[v, g, f], others = faces[f if f < len(faces) else 0]
                corners[v, g, f, : len(others)] = others
    return Hulls(vertices, normals, corners)


def _faces_around(model: mujoco.MjModel, mesh: int) -> list[tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]]:
    """Every vertex of the hull of a mesh, with the normals and the other corners of the faces around it."""
    start, first, count = (int(field[mesh]) for field in (model.mesh_vertadr, model.mesh_polyadr, model.mesh_polynum))
    around: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for face in range(first, first + count):
        begin = int(model.mesh_polyvertadr[face])
        names = model.mesh_polyvert[begin : begin + int(model.mesh_polyvertnum[face])].tolist()
        places = np.asarray(model.mesh_vert[[start + name for name in names]], np.float64)
        for k, name in enumerate(names):
            others = _quadrangle(np.roll(places, -k, axis=0))[1:]
            around.setdefault(name, []).append((model.mesh_polynormal[face], others))
    return [(np.asarray(model.mesh_vert[start + v], np.float64), around[v]) for v in sorted(around)]


def _quadrangle(polygon: np.ndarray) -> np.ndarray:
    """Four corners of a convex polygon (n, 3) that enclose a large area, the first among them (polygonQuad)."""
    n = len(polygon)
    if n <= CORNERS:
        return polygon

    def area(a: int, b: int, c: int, d: int) -> float:
        return float(np.linalg.norm(np.cross(polygon[c % n] - polygon[a % n], polygon[d % n] - polygon[b % n])))

    b, c, d = 1, 2, 3
    while area(0, b, c, d + 1) > area(0, b, c, d):
        d += 1
        while area(0, b, c + 1, d) > area(0, b, c, d):
            c += 1
        while area(0, b + 1, c, d) > area(0, b, c, d):
            b += 1
    return polygon[[0, b % n, c % n, d % n]]


def points(hull: Hulls, down: Vector, dtype: Any) -> list[tuple[list[jax.Array], jax.Array | None]]:
    """The points of each geom, in its axes about its centre [m], and in which worlds they can touch; None for all.

    `down` points from the geom into the plane, in the geom's axes.
    """
    members, width = hull.normals.shape[1:3]
    number = np.arange(members)[:, None] if members > 1 else np.zeros(1, int)
    shape = np.broadcast_shapes(number.shape, *(np.shape(x) for x in down))
    down = [array(x, shape, dtype) for x in down]

    def read(table: np.ndarray, index: jax.Array, *rest: int) -> jax.Array:
        return jnp.asarray(table.reshape(-1, *rest), dtype)[index]

    rows = [jnp.asarray(hull.vertices[..., k].reshape(-1, *number.shape), dtype) for k in range(3)]
    place = largest_row(dot(rows, down)) * members + number
    nearest = [read(hull.vertices[..., k], place) for k in range(3)]
    around = [jnp.moveaxis(read(hull.normals[..., k], place, width), -1, 0) for k in range(3)]
    face = place * width + largest_row(dot(around, down))
    found: list[tuple[list[jax.Array], jax.Array | None]] = [(nearest, None)]
    for n in range(CORNERS - 1):
        corner = [read(hull.corners[..., n, k], face) for k in range(3)]
        found.append((corner, dot(corner, down) > 0))  # none above the centre
    return found
