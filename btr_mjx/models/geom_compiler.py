"""Vectorised computation of geoms and of the inertias that bodies infer from them, for many simulations."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.models import compiler_rules as rules
from btr_mjx.models.sources import ElementSources, TaggedModel, sources

FRAME_FIELDS = ("geom_pos", "geom_quat", "geom_size")
"""Fields of geoms that MuJoCo's compiler may compute."""

INERTIA_FIELDS = ("body_mass", "body_ipos", "body_iquat", "body_inertia")
"""Fields of bodies that MuJoCo's compiler may infer from geoms."""


class NotVectorisable(Exception):
    """The models of this robot have to be compiled one by one; the message names the reason."""


@dataclass(frozen=True)
class _Group:
    """G geoms of one type whose frames are computed in the same way.

    Attributes:
      ids: (G,).
      kind: mjtGeom.
      ends: the (6, G) end points, or None for geoms with a position and an orientation.
      position: (3, G), not used with ends.
      orientation: (4, G), not used with ends.
      size: (3, G).
      mass: (G,), NaN constants where the mass follows from the density.
      density: (G,).
    """

    ids: np.ndarray
    kind: int
    ends: ElementSources | None
    position: ElementSources
    orientation: ElementSources
    size: ElementSources
    mass: ElementSources
    density: ElementSources


@dataclass(frozen=True)
class _Body:
    """A body whose inertia is inferred from geoms; parts are (group, index in the group) of those with mass."""

    id: int
    parts: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class GeomCompiler:
    """Geoms and bodies whose fields MuJoCo's compiler computes."""

    groups: tuple[_Group, ...]
    bodies: tuple[_Body, ...]

    def write(self, slots: np.ndarray, fields: dict[str, np.ndarray]) -> np.ndarray:
        """Write the fields that MuJoCo's compiler would compute.

        Args:
          slots: (slots, L) numbers of the template.
          fields: arrays (L, *field shape) of `FRAME_FIELDS` and `INERTIA_FIELDS`, written in place.

        Returns:
          Bool (L,): rows that the compiler rejects, or for which it uses another rule.
        """
        count = slots.shape[1]
        failed = np.zeros(count, bool)
        solids = []
        for group in self.groups:
            frame = _frame(group, slots)
            masses, moments = _mass(group, slots, frame[2])
            if group.ends is not None:
                failed |= ~(frame[2][: rules.SIZES[group.kind]].min(axis=0) > rules.EPS).all(axis=0)
            for name, value in zip(FRAME_FIELDS, frame, strict=True):
                fields[name][:, group.ids] = value.transpose(2, 1, 0)
            solids.append((*frame[:2], masses, moments))
        for body in self.bodies:
            parts = [[x[..., place, :] for x in solids[group]] for group, place in body.parts]
            for part in parts:
                failed |= ~(part[2] > rules.EPS)
            if len(parts) == 1:
                position, orientation, mass, moments = parts[0]
            else:
                stacked = [np.stack(x, axis=-2) for x in zip(*parts, strict=True)]
                mass, position, orientation, moments = rules.merge_inertias(
                    stacked[2], stacked[0], stacked[1], stacked[3]
                )
                failed |= ~(moments[2] >= rules.EPS)
            for name, value in zip(INERTIA_FIELDS, (mass, position, orientation, moments), strict=True):
                fields[name][:, body.id] = value.T
        return failed


def _frame(group: _Group, slots: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (3, G, L), orientations (4, G, L) and sizes (3, G, L)."""
    shape = (len(group.ids), slots.shape[1])
    size = group.size.values(slots).reshape(3, *shape)
    if group.ends is None:
        position, orientation = group.position.values(slots), group.orientation.values(slots)
        return position.reshape(3, *shape), orientation.reshape(4, *shape), size
    position, orientation, half = rules.frame_between(group.ends.values(slots).reshape(6, *shape))
    if group.kind in (rules.GEOM_ELLIPSOID, rules.GEOM_BOX):
        return position, orientation, np.stack([size[0], size[0], half])
    return position, orientation, np.stack([size[0], half, size[2]])


def _mass(group: _Group, slots: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses (G, L) and moments (3, G, L)."""
    volume = rules.volume(group.kind, size)
    given = group.mass.values(slots)
    inferred = group.density.values(slots) * volume
    # The compiler ignores the mass of a geom without volume: such rows are left to it.
    masses = np.where(np.isnan(given), inferred, np.where(volume > rules.EPS, given, np.nan))
    return masses, rules.geom_inertia(group.kind, masses, size)


def build_geom_compiler(tagged: Sequence[TaggedModel], cells: dict[str, ElementSources]) -> GeomCompiler:
    """Find the geoms and bodies that need compiler rules, and the sources of their numbers.

    Args:
      tagged: the tagged models.
      cells: sources of `FRAME_FIELDS` and `INERTIA_FIELDS`.

    Raises:
      NotVectorisable: a feature without a rule in `compiler_rules`.
    """
    model, specs = tagged[0].model, tagged[0].spec.geoms
    computed_geoms = _objects(cells, FRAME_FIELDS, model.ngeom)
    computed_bodies = _objects(cells, INERTIA_FIELDS, model.nbody)
    if not len(computed_geoms) and not len(computed_bodies):
        return GeomCompiler((), ())
    _check_compiler(tagged[0].spec)
    if [g.id for g in specs] != list(range(model.ngeom)):
        raise NotVectorisable("geoms that the compiler removes or reorders")
    bodies = {b.id: b for b in tagged[0].spec.bodies}
    for b in computed_bodies:
        if bodies[b].explicitinertial:
            raise NotVectorisable(f"body {bodies[b].name!r}: the axes of its inertia follow from the parameters")
    lowest, highest = tagged[0].spec.compiler.inertiagrouprange
    massive = {
        g.id: True
        for g in specs
        if model.geom_bodyid[g.id] in computed_bodies and lowest <= g.group <= highest and _has_mass(tagged, g.id)
    }
    needed = sorted({*computed_geoms.tolist(), *massive})
    keys: dict[tuple[int, bool], list[int]] = {}
    for g in needed:
        geom = specs[g]
        if int(geom.type) not in rules.SIZES or geom.meshname:
            raise NotVectorisable(f"geom {geom.name or g!r}: no rule for its type")
        if geom.typeinertia != mujoco.mjtGeomInertia.mjINERTIA_VOLUME:
            raise NotVectorisable(f"geom {geom.name or g!r}: the inertia of a shell")
        keys.setdefault((int(geom.type), not np.isnan(geom.fromto[0])), []).append(g)
    groups = tuple(_group(tagged, kind, ends, np.array(ids)) for (kind, ends), ids in keys.items())
    place = {int(g): (i, n) for i, group in enumerate(groups) for n, g in enumerate(group.ids)}
    inferred = []
    for b in computed_bodies:
        first = model.body_geomadr[b]
        parts = tuple(place[g] for g in range(first, first + model.body_geomnum[b]) if g in massive)
        if not parts:
            raise NotVectorisable(f"body {bodies[b].name!r}: its inertia comes from no geom")
        inferred.append(_Body(int(b), parts))
    return GeomCompiler(groups, tuple(inferred))


def _objects(cells: dict[str, ElementSources], names: Sequence[str], count: int) -> np.ndarray:
    """Ids of the objects with an element that the compiler computes."""
    return np.flatnonzero(sum(cells[name].computed.reshape(count, -1).any(axis=1) for name in names))


def _has_mass(tagged: Sequence[TaggedModel], geom: int) -> bool:
    spec = tagged[0].spec.geoms[geom]
    attribute = "density" if np.isnan(spec.mass) else "mass"
    cells = sources(tagged, lambda t: np.array([getattr(t.spec.geoms[geom], attribute)]))
    return bool(cells.responding[0]) or cells.constant[0] > 0


def _group(tagged: Sequence[TaggedModel], kind: int, ends: bool, ids: np.ndarray) -> _Group:
    def spec(name: str) -> ElementSources:
        found = sources(tagged, lambda t: np.stack([getattr(t.spec.geoms[i], name) for i in ids], axis=-1))
        if found.computed.any():
            raise NotVectorisable(f"geoms' {name} is not a plain number of the template")
        return found

    def compiled(name: str) -> ElementSources:
        found = sources(tagged, lambda t: getattr(t.model, name)[ids].T)
        if found.computed.any() and not ends:
            raise NotVectorisable(f"{name} is computed by a rule that is not known here")
        return found

    return _Group(
        ids,
        kind,
        spec("fromto") if ends else None,
        compiled("geom_pos"),
        compiled("geom_quat"),
        spec("size") if ends else compiled("geom_size"),
        spec("mass"),
        spec("density"),
    )


def _check_compiler(spec: mujoco.MjSpec) -> None:
    options = spec.compiler
    for name in ("boundmass", "boundinertia", "balanceinertia", "discardvisual", "fusestatic"):
        if getattr(options, name):
            raise NotVectorisable(f"compiler option {name}")
    if options.settotalmass > 0:
        raise NotVectorisable("compiler option settotalmass")
    if options.inertiafromgeom != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO:
        raise NotVectorisable("compiler option inertiafromgeom")
