"""The mended model as a robot of Back-to-Reality, whose space S is spanned by the parameters of the effects found.

Each dimension of S is a parameter of an effect, within a multiple of its interval. Every effect is an edit of the
compiled model, the one that the search made, so that any engine simulates it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import KNOWN_EFFECTS, Effect, Place, Scales
from btr_mjx.gap.results.mended_model import FoundEffect, mend, resolve_effect
from btr_mjx.gap.results.transcribe import normalised
from btr_mjx.gap.simulate import World, differing_fields
from btr_mjx.models import write_field
from btr_mjx.robots import Box, Edit, Robot, Signal


@dataclass(frozen=True)
class EffectEdit:
    """An effect at a place as an edit of a model, see `robots.Edit`.

    Attributes:
      effect: of the library.
      place: in the model.
      parameters: names of the parameters of S that are its numbers.
    """

    effect: Effect
    place: Place
    parameters: tuple[str, ...]

    def __call__(self, model: mujoco.MjModel, values: Sequence[float]) -> None:
        """Change the numbers of a model that the effect changes."""
        world = World.of(model)
        self.effect.apply(world, self.place, np.array(values))
        for name, value in differing_fields(world, model).items():
            write_field(model, name, value)


def is_model_edit(effect: Effect, model: mujoco.MjModel, place: Place, values: Sequence[float]) -> bool:
    """Whether all that an effect does is to change numbers of a model, so that `EffectEdit` is the whole of it."""
    world = World.of(model)
    before = len(world.command_edits)
    effect.apply(world, place, np.array(values))
    return not world.laws and len(world.command_edits) == before and not world.wrench.any()


@dataclass(frozen=True)
class DelayOrLagEdit:
    """A delay or a lag of commands as an edit of a model whose actuators have one.

    Attributes:
      field: of MjModel.
      actuators: their ids.
      believed: value of the field without the effect, by actuator.
      parameters: name of the parameter of S, one.
    """

    field: str
    actuators: tuple[int, ...]
    believed: tuple[float, ...]
    parameters: tuple[str, ...]

    def __call__(self, model: mujoco.MjModel, values: Sequence[float]) -> None:
        """Change delays or time constants."""
        column = getattr(model, self.field).reshape(len(model.actuator_trntype), -1)[:, 0]
        column[list(self.actuators)] = np.array(self.believed) + values[0]


_COMMAND_FIELDS = {"actuator_delay": "actuator_delay", "actuator_lag": "actuator_dynprm"}
"""Effects on commands that MuJoCo's actuators have themselves, and the fields with their sizes."""


@dataclass(frozen=True)
class ControllerTrial:
    """How controllers are tried on the robot: settings that an MJCF does not hold.

    Attributes:
      signal: reference signal of the controllers.
      controller_box: space of the controllers.
      base_body: body whose position is measured, None for a robot with a fixed base.
      duration: duration of a trial [s].
    """

    signal: Signal
    controller_box: Box
    base_body: str | None = None
    duration: float = 1.7


def mended_robot(
    source: str | Path,
    effects_found: Sequence[Mapping[str, Any]],
    trial: ControllerTrial,
    *,
    name: str = "mended",
    believed: Mapping[str, float] | None = None,
    widen: float = 2.0,
    effects: Sequence[Effect] = KNOWN_EFFECTS,
) -> Robot:
    """A robot whose space of simulations is spanned by the parameters of the effects that were found.

    Args:
      source: MJCF of the believed model, text or a file.
      effects_found: `effects` of result.json: effect, location, parameters with value, low and high.
      trial: how controllers are tried.
      name: name of the robot.
      believed: path into the model -> refitted value, as for `mend`.
      widen: width of the box in units of the intervals; the bounds of the effects' parameters limit it.
      effects: the library that `effects_found` refers to.

    Returns:
      The robot; its nominal simulation is the mended model.

    Raises:
      InputError: an effect that MJCF cannot express, or no parameters.
    """
    found = [FoundEffect.from_result(entry) for entry in effects_found]
    mended = mend(source, found, believed=believed, effects=effects)
    if mended.terms:
        lacking = ", ".join(f"{term['effect']}@{term['location']}" for term in mended.terms)
        raise InputError(f"{lacking}: MJCF has no such term, so that it cannot be a simulation of Back-to-Reality")
    names, nominal, low, high = _box(source, found, effects_found, widen, effects)
    if not names:
        raise InputError("effects: got none with parameters, expected at least one")
    # Actuators have their delays and lags at compilation, at the largest size, which sets the length of the history.
    of_command = [i for i, item in enumerate(found) if item.effect in _COMMAND_FIELDS]
    first = np.cumsum([0, *(len(item.values) for item in found)])
    largest = [replace(found[i], values={key: high[first[i]] for key in found[i].values}) for i in of_command]
    base = mend(source, largest, believed=believed, effects=effects).xml
    model, edits = normalised(source).compile(), list[Edit]()
    for i, item in enumerate(found):
        effect, place, _ = resolve_effect(model, item, effects)
        own = tuple(names[first[i] : first[i + 1]])
        if i in of_command:
            field = _COMMAND_FIELDS[item.effect]
            # A lag replaces no other: MuJoCo's default of an actuator without one is 1.
            known = model.actuator_delay[list(place.actuators)] * (item.effect == "actuator_delay")
            edits.append(DelayOrLagEdit(field, place.actuators, tuple(known.tolist()), own))
        else:
            edits.append(EffectEdit(effect, place, own))
    return Robot(
        name=name,
        template=base,
        template_path=f"{name}.xml",
        simulation_box=Box(names, low, high),
        controller_box=trial.controller_box,
        signal=trial.signal,
        nominal=tuple(nominal),
        base_body=trial.base_body,
        edits=tuple(edits),
        plain=True,
        duration=trial.duration,
    )


def _box(
    source: str | Path,
    found: Sequence[FoundEffect],
    entries: Sequence[Mapping[str, Any]],
    widen: float,
    effects: Sequence[Effect],
) -> tuple[list[str], list[float], list[float], list[float]]:
    """Names, nominal values and bounds of the new dimensions."""
    model = normalised(source).compile()
    names: list[str] = []
    nominal: list[float] = []
    low: list[float] = []
    high: list[float] = []
    for item, entry in zip(found, entries, strict=True):
        effect, place, _ = resolve_effect(model, item, effects)
        bounds = {p.name: p for p in effect.parameters(model, Scales.of(model), place)}
        for key, value in item.values.items():
            given = entry["parameters"][key]
            given = given if isinstance(given, Mapping) else {}
            parameter = bounds[key]
            reach = widen * max(abs(float(given.get(end, value)) - value) for end in ("low", "high"))
            reach = reach or 0.2 * abs(value) or abs(parameter.step)
            names.append(re.sub(r"\W+", "_", f"{item.effect}_{item.location}_{key}").strip("_"))
            nominal.append(value)
            low.append(max(value - reach, min(parameter.low, value)))
            high.append(min(value + reach, max(parameter.high, value)))
    return names, nominal, low, high
