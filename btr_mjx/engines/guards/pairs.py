"""Which pairs of geoms MuJoCo can collide: its static filters (mj_collision), applied to a model."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

PLANE, HFIELD = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)
SPHERE, CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
ELLIPSOID, CYLINDER = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
BOX, MESH = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH)


@dataclass(frozen=True)
class GeomPair:
    """Two geoms that MuJoCo can collide; a plane comes first."""

    first: int
    second: int
    explicit: int
    """Number of the <pair> element that names them, -1 if none does."""


def geom_pairs(model: mujoco.MjModel) -> Iterator[GeomPair]:
    """All pairs of geoms that MuJoCo can collide.

    Pairs that can never meet are left out: both geoms fixed to the world or to one rigid body, filtered by contype and
    conaffinity, by parent and child, or by an <exclude>, and two geoms of which neither has a volume.
    """
    flags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    if model.opt.disableflags & int(flags):
        return
    named = {
        (min(g1, g2), max(g1, g2)): p
        for p, (g1, g2) in enumerate(zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True))
    }
    excluded = {int(s) for s in np.asarray(model.exclude_signature)}
    flat, weld = [kind in (PLANE, HFIELD) for kind in model.geom_type], model.body_weldid[model.geom_bodyid].tolist()
    for g1 in range(model.ngeom):
        for g2 in range(g1 + 1, model.ngeom):
            explicit = named.get((g1, g2), -1)
            if (
                weld[g1] == weld[g2]
                or (flat[g1] and flat[g2])
                or (explicit < 0 and not _passes_filters(model, g1, g2, excluded))
            ):
                continue
            yield GeomPair(g2, g1, explicit) if model.geom_type[g2] == PLANE else GeomPair(g1, g2, explicit)


def _passes_filters(m: mujoco.MjModel, g1: int, g2: int, excluded: set[int]) -> bool:
    """MuJoCo's filters: contype and conaffinity, welded bodies, parent and child, excluded body pairs."""
    affine = (m.geom_contype[g1] & m.geom_conaffinity[g2]) or (m.geom_contype[g2] & m.geom_conaffinity[g1])
    b1, b2 = int(m.geom_bodyid[g1]), int(m.geom_bodyid[g2])
    w1, w2 = int(m.body_weldid[b1]), int(m.body_weldid[b2])
    if not affine:
        return False
    if (min(b1, b2) << 16) + max(b1, b2) in excluded:
        return False
    up1, up2 = (int(m.body_weldid[m.body_parentid[w]]) for w in (w1, w2))
    unfiltered = m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return bool(unfiltered) or w1 == 0 or w2 == 0 or (w1 != up2 and w2 != up1)


@dataclass(frozen=True)
class PairGroup:
    """Pairs of geoms that are computed together."""

    kinds: tuple[int, int]
    """mujoco.mjtGeom that the first and the second geom of every pair count as; a plane comes first."""
    condim: int
    """Of their contact; 0 where it does not matter."""
    first: tuple[int, ...]
    """Index into a list of geoms, of each pair."""
    second: tuple[int, ...]
    explicit: np.ndarray
    """(P, 1) margin of the <pair> element that names the geoms [m], -inf where none does."""


def shape_kind(model: mujoco.MjModel, geom: int) -> int:
    """The kind of shape that a geom counts as: itself for a primitive, else its bounding box."""
    kind = int(model.geom_type[geom])
    return kind if kind in (PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER) else BOX


def bounding_box(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Centre and half edges (6,) of the box that a geom counts as, in its own frame [m].

    `geom_aabb` of a height field reaches up to the greatest height that its elevations could have.
    """
    box = np.array(model.geom_aabb[geom])
    if model.geom_type[geom] == HFIELD:
        field = model.hfield(int(model.geom_dataid[geom]))
        top, bottom = field.size[2] * field.data.max(), -field.size[3]
        box[2::3] = (top + bottom) / 2, (top - bottom) / 2
    return box


def explicit_pairs(model: mujoco.MjModel, g1: int, g2: int) -> list[int]:
    """Numbers of the <pair> elements that name two geoms."""
    one, other = model.pair_geom1, model.pair_geom2
    return np.flatnonzero(((one == g1) & (other == g2)) | ((one == g2) & (other == g1))).tolist()


def contact_condim(model: mujoco.MjModel, pair: GeomPair) -> int:
    """The condim of a contact of two geoms (mj_contactParam)."""
    if pair.explicit >= 0:
        return int(model.pair_dim[pair.explicit])
    dims, ranks = (
        [int(field[g]) for g in (pair.first, pair.second)] for field in (model.geom_condim, model.geom_priority)
    )
    return max(dims) if ranks[0] == ranks[1] else dims[0 if ranks[0] > ranks[1] else 1]


def group_by_kinds(model: mujoco.MjModel, pairs: Sequence[GeomPair], geoms: Sequence[int]) -> list[PairGroup]:
    """Sort pairs into groups of the same two kinds of geoms, which refer to positions in the list of all geoms."""
    groups: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    place = {geom: k for k, geom in enumerate(geoms)}
    for pair in pairs:
        (one, a), (other, b) = sorted((shape_kind(model, g), place[g]) for g in (pair.first, pair.second))
        groups.setdefault((one, other), []).append((a, b, pair.explicit))
    margins = model.pair_margin + model.pair_gap
    found = []
    for kinds, alike in sorted(groups.items()):
        first, second, explicit = zip(*alike, strict=True)
        own = np.array([[margins[p] if p >= 0 else -np.inf] for p in explicit])
        found.append(PairGroup(kinds, 0, first, second, own))
    return found


def group_by_condim(model: mujoco.MjModel, pairs: Sequence[GeomPair], geoms: Sequence[int]) -> list[PairGroup]:
    """Sort pairs of spheres and capsules into groups of the same condim.

    A sphere counts as a capsule without length. The groups refer to positions in the list of all their geoms.
    """
    groups: dict[int, list[tuple[int, int]]] = {}
    place = {geom: k for k, geom in enumerate(geoms)}
    for pair in pairs:
        groups.setdefault(contact_condim(model, pair), []).append((place[pair.first], place[pair.second]))
    found = []
    for condim, alike in sorted(groups.items()):
        first, second = zip(*alike, strict=True)
        found.append(PairGroup((CAPSULE, CAPSULE), condim, first, second, np.full((len(alike), 1), -np.inf)))
    return found
