"""Sources of a model's elements: which number of a template each element copies, found by tagging the numbers.

The template's numbers (the slots of its `Skeleton`) are replaced by tags: distinct values close to real ones. MuJoCo's
own parser (with its rules for defaults, classes, units and shorthands) and compiler then process the tagged MJCF. An
element that equals the tag of one slot in all tagged models is a copy of that slot; an element that never changes is a
constant; every other element is computed by the compiler.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from btr_mjx.models.symbolic import Skeleton
from btr_mjx.robots import Robot

_TAGGINGS = 3
"""Number of tagged models, so that a chance coincidence of values is not taken for a copy."""

_FACTORS = (1.0, -1.0, math.pi / 180, -math.pi / 180)
"""Factors that the parser and the compiler apply to a plain attribute: none, a sign, degrees to radians."""


@dataclass(frozen=True)
class TaggedModel:
    """A model compiled with tags in place of the template's numbers.

    Attributes:
      spec: the parsed MJCF, before compilation.
      model: the compiled model.
      slots: value in this array -> (slot, factor), for float64 and for float32 arrays.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    slots: Mapping[Any, Mapping[float, tuple[int, float]]]


@dataclass(frozen=True)
class ElementSources:
    """Sources of the E elements of a flattened array.

    Attributes:
      slot: (E,) slot that an element copies; -1 for a constant, -2 for an element that the compiler computes.
      factor: (E,) factor of the slot's value.
      constant: (E,) value of the constants.
    """

    slot: np.ndarray
    factor: np.ndarray
    constant: np.ndarray

    @property
    def responding(self) -> np.ndarray:
        """Bool (E,): elements that are not constant."""
        return self.slot != -1

    @property
    def computed(self) -> np.ndarray:
        """Bool (E,): elements that are neither constants nor copies."""
        return self.slot == -2

    def values(self, slots: np.ndarray) -> np.ndarray:
        """All elements (E, L) for slots' values (slots, L); those computed by the compiler are NaN."""
        out = np.empty((len(self.slot), slots.shape[1]))
        for row, slot, factor, constant in zip(out, self.slot, self.factor, self.constant, strict=True):
            row[:] = slots[slot] * factor if slot >= 0 else constant if slot == -1 else np.nan
        return out


def tag_models(robot: Robot, skeleton: Skeleton) -> list[TaggedModel]:
    """Compile the skeleton with tags in its slots, several times.

    Raises:
      ValueError: MuJoCo does not accept a tagged model.
    """
    rng, found = np.random.default_rng(0), []
    for _ in range(_TAGGINGS):
        values, _ = skeleton.evaluate(robot.simulation_box.sample(rng, 1))
        # Tags are larger than the values: numbers that must not be negative are often exactly zero.
        tags = values[:, 0] * (1 + 1e-3 * rng.random(len(values))) + 1e-5 * (0.5 + rng.random(len(values)))
        spec = mujoco.MjSpec.from_string(skeleton.fill(tags.tolist()))
        model = spec.compile()
        slots = {
            kind: {float(kind(tag * factor)): (i, factor) for i, tag in enumerate(tags) for factor in _FACTORS}
            for kind in (np.float64, np.float32)
        }
        found.append(TaggedModel(spec, model, slots))
    return found


def sources(tagged: Sequence[TaggedModel], read: Callable[[TaggedModel], np.ndarray]) -> ElementSources:
    """Sources of the elements of an array.

    Args:
      tagged: the tagged models.
      read: reads the array from one of them.

    Returns:
      One source per element, in C order.
    """
    arrays = [np.asarray(read(t)) for t in tagged]
    kind = arrays[0].dtype.type
    rows = np.stack([x.ravel() for x in arrays]).astype(np.float64)
    same = np.all((rows == rows[0]) | (np.isnan(rows) & np.isnan(rows[0])), axis=0)
    slot, factor = np.where(same, -1, -2), np.ones(len(same))
    for e in np.flatnonzero(~same):
        matches = {t.slots.get(kind, {}).get(float(row[e])) for t, row in zip(tagged, rows, strict=True)}
        match = matches.pop()
        if match is not None and not matches:
            slot[e], factor[e] = match
    return ElementSources(slot, factor, np.where(same, rows[0], 0.0))
