"""Effects with a number for every member of a group: "each:all" beside "all", "each:subtree:leg" beside "subtree:leg".

The motors of a robot seldom have the same rotor, nor its joints the same friction. One number for a group says that
they have; a number for each member costs the price of as many numbers.
"""

from dataclasses import replace
from functools import wraps

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.places import Place
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import World

EACH_MEMBER = "each:"
"""Beginning of the label of a place with a number for each member."""


def per_member(effect: Effect) -> Effect:
    """The same effect, which may also have a number of its own for each member of a group.

    Args:
      effect: with one parameter, whose groups list their members among the single places.

    Returns:
      The effect. Its places "each:GROUP" have one parameter "NAME[MEMBER]" for each member.
    """

    def places(model: mujoco.MjModel) -> list[Place]:
        found = effect.places(model)
        singles = {place.label: place for place in found if not place.members}
        each = [
            replace(place, label=EACH_MEMBER + place.label, parts=tuple(singles[label] for label in place.members))
            for place in found
            if place.members
        ]
        return found + each

    def parameters(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
        if not place.parts:
            return effect.parameters(model, scales, place)
        single = [(part, effect.parameters(model, scales, part)) for part in place.parts]
        return tuple(replace(own, name=f"{own.name}[{_short(part)}]") for part, (own,) in single)

    @wraps(effect.apply)
    def apply(world: World, place: Place, values: np.ndarray) -> None:
        for part, own in _parts(place, values):
            effect.apply(world, part, own)

    native = effect.native

    def each_native(spec: mujoco.MjSpec, model: mujoco.MjModel, place: Place, values: np.ndarray) -> bool:
        return native is not None and all(native(spec, model, part, own) for part, own in _parts(place, values))

    return replace(effect, places=places, parameters=parameters, apply=apply, native=native and each_native)


def _short(part: Place) -> str:
    """Name of a member without its kind."""
    return part.label.partition(":")[2]


def _parts(place: Place, values: np.ndarray) -> list[tuple[Place, np.ndarray]]:
    """Places and their values: the place itself, or its members with a number each."""
    if not place.parts:
        return [(place, values)]
    return [(part, values[i : i + 1]) for i, part in enumerate(place.parts)]
