"""The mended model as a robot of Back-to-Reality, whose space S is spanned by the parameters of the effects found.

Each dimension of S is a parameter of an effect, within a multiple of its interval. The MJCF of the mended model is
written at random points of that box. A number of the MJCF that depends on the parameters is replaced by a polynomial in
them, fitted by least squares, in a Jinja2 template.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import KNOWN_EFFECTS, Effect, Scales
from btr_mjx.gap.results.mended_model import FoundEffect, mend, resolve_effect
from btr_mjx.gap.results.transcribe import normalised
from btr_mjx.robots import Box, Robot, Signal

_NUMBER = re.compile(r'(?<=[" ])-?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?=[" ])')
_DEGREES = (1, 2, 3, 5)
"""Degrees of the polynomials, tried in this order."""

_TOLERANCE = 3e-5
"""Largest relative error of a polynomial: MJCF that MuJoCo writes has six digits."""

_MOST = 6
"""Largest number of dimensions: the number of points at which the MJCF is written grows as their cube."""


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
      InputError: an effect that MJCF cannot express, too many parameters, or numbers that no polynomial follows.
    """
    found = [FoundEffect.from_result(entry) for entry in effects_found]
    mended = mend(source, found, believed=believed, effects=effects)
    if mended.terms:
        lacking = ", ".join(f"{term['effect']}@{term['location']}" for term in mended.terms)
        raise InputError(f"{lacking}: MJCF has no such term, so that it cannot be a simulation of Back-to-Reality")
    names, nominal, low, high = _box(source, found, effects_found, widen, effects)
    if not names or len(names) > _MOST:
        raise InputError(f"effects with {len(names)} parameters: expected 1 to {_MOST}")
    point = np.array(nominal)

    def text(values: np.ndarray) -> str:
        rest = list(values.tolist())
        items = [FoundEffect(i.effect, i.location, {key: rest.pop(0) for key in i.values}) for i in found]
        return mend(source, items, believed=believed, effects=effects).xml

    template = _template(text, names, np.array(low), np.array(high))
    return Robot(
        name=name,
        template=template,
        template_path=f"{name}.xml.j2",
        simulation_box=Box(names, low, high),
        controller_box=trial.controller_box,
        signal=trial.signal,
        nominal=tuple(point.tolist()),
        base_body=trial.base_body,
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
            names.append(re.sub(r"\W+", "_", f"{item.effect}_{item.location}_{key}"))
            nominal.append(value)
            low.append(max(value - reach, min(parameter.low, value)))
            high.append(min(value + reach, max(parameter.high, value)))
    return names, nominal, low, high


def _template(text: Any, names: Sequence[str], low: np.ndarray, high: np.ndarray) -> str:
    """Jinja2 template that renders to `text(values)`, up to rounding, at every point of the box."""
    rng = np.random.default_rng(0)
    count = 3 * len(_monomials(len(names), _DEGREES[-1])) if len(names) == 1 else 3 * len(_monomials(len(names), 3))
    unit = np.concatenate(
        [rng.uniform(-1, 1, (count, len(names))), 0.999 * np.sign(rng.uniform(-1, 1, (4, len(names))))]
    )
    texts = [text(low + (high - low) * (u + 1) / 2) for u in unit]
    skeletons = {_NUMBER.sub("#", one) for one in texts}
    if len(skeletons) != 1:
        raise InputError("the mended MJCF changes its form within the box of the parameters; expected only its numbers")
    tokens = np.array([[float(t) for t in _NUMBER.findall(one)] for one in texts])
    written = _NUMBER.findall(texts[0])
    out = []
    for i, values in enumerate(tokens.T):
        if (values == values[0]).all():
            out.append(written[i])
            continue
        out.append(_expression(unit, values, names, low, high))
    pieces = _NUMBER.split(texts[0])
    # Names with "{{" are not supported: Jinja2 would read them as expressions.
    return "".join(itertools.chain.from_iterable(itertools.zip_longest(pieces, out, fillvalue="")))


def _monomials(variables: int, degree: int) -> list[tuple[int, ...]]:
    powers = itertools.product(range(degree + 1), repeat=variables)
    return sorted((p for p in powers if sum(p) <= degree), key=lambda p: (sum(p), p))


def _expression(unit: np.ndarray, values: np.ndarray, names: Sequence[str], low: np.ndarray, high: np.ndarray) -> str:
    """The polynomial of least degree that fits the values, as a Jinja2 expression."""
    if np.isclose(values, np.round(values)).all() and float(np.ptp(values)) >= 1:
        # A count, such as the length of a delay's history: the largest one is enough for the whole box.
        return str(int(values.max()))
    size = max(float(np.abs(values).max()), 1e-12)
    for degree in _DEGREES:
        monomials = _monomials(unit.shape[1], degree)
        if 2 * len(monomials) > len(values):
            break
        columns = np.stack([np.prod(unit ** np.array(m), axis=1) for m in monomials], axis=1)
        weights = np.linalg.lstsq(columns, values, rcond=None)[0]
        if np.abs(columns @ weights - values).max() <= _TOLERANCE * size:
            return _jinja(weights, monomials, names, low, high, size)
    raise InputError(f"a number of the mended MJCF ({values.min():.6g} to {values.max():.6g}) follows no polynomial")


def _jinja(
    weights: np.ndarray,
    monomials: Sequence[tuple[int, ...]],
    names: Sequence[str],
    low: np.ndarray,
    high: np.ndarray,
    size: float,
) -> str:
    centre, half = (low + high) / 2, (high - low) / 2
    scaled = [f"(({n}) - ({c!r})) / ({h!r})" for n, c, h in zip(names, centre.tolist(), half.tolist(), strict=True)]
    terms = []
    for weight, powers in zip(weights.tolist(), monomials, strict=True):
        if abs(weight) > 1e-9 * size:
            factors = [f"({weight!r})"] + [
                f"({x})" for x, power in zip(scaled, powers, strict=True) for _ in range(power)
            ]
            terms.append(" * ".join(factors))
    return "{{ " + (" + ".join(terms) or "0") + " }}"
