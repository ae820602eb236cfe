"""The mended model as a robot of Back-to-Reality, whose space S is spanned by the parameters of the effects found.

Each dimension of S is a parameter of an effect, within a multiple of its interval. Effects are edits of the compiled
model, as in the search, so that any engine simulates them; an `EffectSimulator` simulates those that are not.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import KNOWN_EFFECTS, Effect, Scales
from btr_mjx.gap.results.effect_simulator import added_effects
from btr_mjx.gap.results.mended_model import mend, resolve_effect
from btr_mjx.gap.results.records import FoundEffect
from btr_mjx.gap.results.transcribe import normalised
from btr_mjx.robots import Box, Robot, Signal


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
    calibration: Sequence[Mapping[str, Any]] = (),
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
      calibration: `calibration` of result.json, which stays as it is.
      widen: width of the box in units of the intervals; the bounds of the effects' parameters limit it.
      effects: the library that `effects_found` refers to.

    Returns:
      The robot; its nominal simulation is the mended model.

    Raises:
      InputError: no parameters, or an effect, place or parameter that the library or the model does not have.
    """
    found = [FoundEffect.from_result(entry) for entry in effects_found]
    dimensions = _box(source, found, effects_found, widen, effects)
    if not dimensions:
        raise InputError("effects: got none with parameters, expected at least one")
    names, nominal, low, high = (list(column) for column in zip(*dimensions, strict=True))
    text = mend(source, [FoundEffect.from_result(one) for one in calibration], believed=believed, effects=effects).xml
    first = np.cumsum([0, *(len(item.values) for item in found)])
    named = [tuple(names[first[i] : first[i + 1]]) for i in range(len(found))]
    edits, simulator = added_effects(mujoco.MjModel.from_xml_string(text), found, named, effects)
    return Robot(
        name=name,
        template=text,
        template_path=f"{name}.xml",
        simulation_box=Box(names, low, high),
        controller_box=trial.controller_box,
        signal=trial.signal,
        nominal=tuple(nominal),
        base_body=trial.base_body,
        edits=edits,
        simulator=simulator,
        plain=True,
        duration=trial.duration,
    )


def _box(
    source: str | Path,
    found: Sequence[FoundEffect],
    entries: Sequence[Mapping[str, Any]],
    widen: float,
    effects: Sequence[Effect],
) -> list[tuple[str, float, float, float]]:
    """Name, nominal value and bounds of each new dimension."""
    model, out = normalised(source).compile(), []
    for item, entry in zip(found, entries, strict=True):
        effect, place, _ = resolve_effect(model, item, effects)
        parameters = {p.name: p for p in effect.parameters(model, Scales.of(model), place)}
        for key, value in item.values.items():
            given, parameter = entry["parameters"][key], parameters[key]
            ends = [given.get(end, value) if isinstance(given, Mapping) else value for end in ("low", "high")]
            reach = widen * max(abs(float(end) - value) for end in ends) or 0.2 * abs(value) or abs(parameter.step)
            low = max(value - reach, min(parameter.low, value))
            high = min(value + reach, max(parameter.high, value))
            name = re.sub(r"\W+", "_", f"{item.effect}_{item.location}_{key}").strip("_")
            out.append((name, value, low, high))
    return out
