"""The mended model: the believed MJCF with the effects that were found.

    mended = mend(xml, [FoundEffect("viscous_damping", "joint:knee", {"damping": 0.8})])
    Path("mended.xml").write_text(mended.xml)
    Path("mended.json").write_text(json.dumps(mended.as_json()))

Effects that depend on the state or on the command (load-dependent friction, backlash, ...) have no term in MJCF. They
are listed in `mended.terms`, and a `callback.Callback` adds them to any simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import KNOWN_EFFECTS, RESIDUAL, Effect, Place, ResidualTable, Scales, known_effects
from btr_mjx.gap.results.changed_numbers import changed_numbers
from btr_mjx.gap.results.records import FoundEffect
from btr_mjx.gap.results.transcribe import normalised, write_changes
from btr_mjx.gap.simulate import World, differing_fields
from btr_mjx.models import nearest_names, set_values


def found_effects(result: Mapping[str, Any]) -> list[FoundEffect]:
    """All that a mended model has: calibration, then effects, named or not.

    Args:
      result: content of result.json.
    """
    every = [entry for key in ("calibration", "effects", "unnamed") for entry in result.get(key) or ()]
    return [FoundEffect.from_result(entry) for entry in every]


@dataclass(frozen=True)
class MendedModel:
    """A model with the missing effects added.

    Attributes:
      xml: MJCF that plain MuJoCo loads, with every effect that MJCF can express.
      terms: the other effects, for JSON: effect, location, parameters, equation, and why MJCF cannot express them.
      native: "effect@location" of the effects that are entirely inside `xml`.
      notes: remarks for the reader, such as fields that could not be written.
      changes: numbers that differ from the believed model, see `changed_numbers`.
    """

    xml: str
    terms: list[dict[str, Any]] = field(default_factory=list)
    native: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    changes: tuple[dict[str, Any], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Content of mended.json."""
        return {
            "terms": self.terms,
            "native": list(self.native),
            "notes": list(self.notes),
            "changes": list(self.changes),
            "use": self.use,
        }

    @property
    def use(self) -> str:
        """What whoever simulates the model has to add to it."""
        if self.terms:
            return _USE
        if self.notes:
            return "the model does not hold everything that was found: see notes"
        return "nothing has to be added: the model holds everything that was found"

    def what_else(self, name: str, file: str) -> str:
        """What a simulation of an effect needs beside the model, to be appended to a sentence; "" for nothing.

        Args:
          name: "effect@location".
          file: name of the file that holds `as_json`.
        """
        if name in self.native:
            return ""
        if name in {f"{term['effect']}@{term['location']}" for term in self.terms}:
            return f"; needs {file} in a simulation"
        return f"; not in the model, see the notes of {file}"


_USE = (
    "from btr_mjx.gap.results import Callback; missing = Callback(model, terms); before every mj_step set data.ctrl, "
    "then call missing(model, data)"
)


def mend(
    source: str | Path,
    found: Sequence[FoundEffect],
    *,
    believed: Mapping[str, float] | None = None,
    effects: Sequence[Effect] = KNOWN_EFFECTS,
) -> MendedModel:
    """Add effects to a model.

    Every effect edits a simulated world. Fields of the model that differ afterwards are written into the MJCF. An edit
    of the command or a law that depends on the state becomes an entry of `terms`.

    Args:
      source: MJCF of the believed model, text or a file.
      found: the missing effects, in the order in which they apply.
      believed: path into the model -> refitted value of a believed parameter, see `btr_mjx.models.parse_path`.
      effects: the library that `found` refers to.

    Returns:
      The mended model. Its numbers have the six digits of MuJoCo's XML.

    Raises:
      InputError: an effect, place or parameter that the library or the model does not have.
    """
    spec = normalised(source)
    base = spec.compile()
    world = World.of(base)
    if believed:
        set_values(world.model, believed)
    return written(spec, base, world, found, effects)


def written(
    spec: mujoco.MjSpec,
    base: mujoco.MjModel,
    world: World,
    found: Sequence[FoundEffect],
    effects: Sequence[Effect],
    edited: Sequence[FoundEffect] = (),
) -> MendedModel:
    """A world and effects as MJCF.

    Args:
      spec: specification of the base model, changed in place.
      base: the model that it compiles to.
      world: the base model with its changes so far, changed in place.
      found: effects that are added, in this order.
      effects: the library that they refer to.
      edited: effects that the world has already, all of them edits of its model.

    Raises:
      InputError: an effect, place or parameter that the library or the model does not have.
    """
    terms, native = [], dict[str, set[str]]()
    for item in (*edited, *found):
        effect, place, values = resolve_effect(base, item, effects)
        alone, is_edit = applied_alone(effect, base, place, values)
        if item not in edited:
            effect.apply(world, place, values)
        if is_edit or (effect.native is not None and effect.native(spec, base, place, values)):
            native[item.name] = set(differing_fields(alone, base))
            continue
        terms.append(
            {
                "effect": item.effect,
                "location": item.location,
                "parameters": dict(zip(parameter_names(base, effect, place), values.tolist(), strict=True)),
                "equation": effect.equation,
                "why": "MJCF has no such term",
            }
        )
    spec.option.timestep = world.model.opt.timestep
    left = write_changes(spec, world, base)
    notes = tuple(f"{name} differs from the believed model and cannot be written as MJCF" for name in left)
    changes = changed_numbers(base, spec.compile())
    inside = tuple(name for name, fields in native.items() if fields.isdisjoint(left))
    return MendedModel(spec.to_xml(), terms, inside, notes, changes)


def applied_alone(effect: Effect, model: mujoco.MjModel, place: Place, values: np.ndarray) -> tuple[World, bool]:
    """The world of a model with one effect, and whether all that the effect does is to change numbers of the model."""
    world = World.of(model)
    before = len(world.command_edits)
    effect.apply(world, place, values)
    return world, not world.laws and len(world.command_edits) == before and not world.wrench.any()


def acts_through_actuators(model: mujoco.MjModel, found: FoundEffect, effects: Sequence[Effect]) -> bool:
    """Whether an effect changes actuators of a model or their commands."""
    effect, place, values = resolve_effect(model, found, effects)
    world = World.of(model)
    effect.apply(world, place, values)
    fields = {name for name in differing_fields(world, model) if name.startswith("actuator_")}
    return bool(world.command_edits) or not fields <= {"actuator_acc0", "actuator_length0"}


def resolve_effect(
    model: mujoco.MjModel, found: FoundEffect, effects: Sequence[Effect]
) -> tuple[Effect, Place, np.ndarray]:
    """The library's effect, its place in a model and its values.

    Args:
      model: the believed model.
      found: effect, place and values by name.
      effects: the library.

    Returns:
      The effect, the place, and the (p,) values in the order of the effect's parameters.

    Raises:
      InputError: a name that the library or the model does not have; the message lists the nearest.
    """
    library = {effect.name: effect for effect in effects}
    library = library if found.effect in library else known_effects() | library
    if found.effect not in library:
        raise InputError(
            f"effect {found.effect!r} is not in the library; nearest: {nearest_names(found.effect, [*library])}"
        )
    effect = library[found.effect]
    places = {place.label: place for place in effect.places(model)}
    if found.location not in places:
        raise InputError(
            f"{found.effect} has no place {found.location!r} in this model; "
            f"nearest: {nearest_names(found.location, [*places])}"
        )
    place = places[found.location]
    names = parameter_names(model, effect, place)
    if set(names) != set(found.values):
        raise InputError(
            f"{found.effect}@{found.location}: got parameters {sorted(found.values)}, expected {sorted(names)}"
        )
    return effect, place, np.array([float(found.values[name]) for name in names])


def parameter_names(model: mujoco.MjModel, effect: Effect, place: Place) -> list[str]:
    """Names of the parameters of an effect at a place."""
    return [parameter.name for parameter in effect.parameters(model, Scales.of(model), place)]


def with_residual(mended: MendedModel, tables: Sequence[ResidualTable]) -> MendedModel:
    """A mended model with tables of what nothing explains.

    Args:
      mended: without them.
      tables: of joints.
    """
    terms = [
        {
            "effect": RESIDUAL,
            "location": f"joint:{table.joint}",
            "parameters": {},
            "equation": "a smooth table of position, velocity and load",
            "why": "nothing explains this force; the table holds within the recorded range only",
            "table": table.as_json(),
        }
        for table in tables
    ]
    return replace(mended, terms=[*mended.terms, *terms])
