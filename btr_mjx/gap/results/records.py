"""Parts of a diagnosis: effects with their numbers, candidates, refitted parameters, confounds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

BEYOND_TOLERANCE = 2.0
"""Size of a calibration, in tolerances of its number, beyond which it is told as a finding: one number in twenty of a
robot that is as believed."""


@dataclass(frozen=True)
class Estimate:
    """A parameter with its interval.

    Attributes:
      value: best estimate.
      low, high: 90 % interval; it does not assume that the fit is good. None where there is none.
      unit: SI unit.
      null: value at which the effect is absent.
      edge: whether the value is at the edge of its range; the true value may be beyond.
    """

    value: float
    low: float | None
    high: float | None
    unit: str
    null: float = 0.0
    edge: bool = False

    @property
    def reach(self) -> float | None:
        """Distance of the value from the farther end of its interval; None where there is no finite one."""
        if self.low is None or self.high is None:
            return None
        reach = max(self.high - self.value, self.value - self.low)
        return reach if math.isfinite(reach) else None


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was found missing.

    Attributes:
      effect: name of the effect.
      location: label of its place, such as "joint:knee".
      values: parameter name -> value, in SI units.
    """

    effect: str
    location: str
    values: Mapping[str, float]

    @property
    def name(self) -> str:
        """effect@location."""
        return f"{self.effect}@{self.location}"

    @classmethod
    def from_result(cls, entry: Mapping[str, Any]) -> "FoundEffect":
        """A finding from an entry of `effects` in result.json.

        Args:
          entry: effect, location, and parameters as numbers or as mappings with `value`.
        """
        values = {name: float(p["value"] if isinstance(p, Mapping) else p) for name, p in entry["parameters"].items()}
        return cls(str(entry["effect"]), str(entry["location"]), values)


@dataclass(frozen=True)
class NamedEffect:
    """An effect with its numbers: one that was named, or a part of calibration.

    Attributes:
      effect: name of the effect.
      location: label of its place.
      parameters: estimates by name.
      score: fall of the loss by the effect, in units of twice the log-likelihood, less the price of its parameters;
        None of calibration.
      held_out: part of the score that comes from held-out recordings; None where it is not known.
      equivalent: candidates that these data cannot distinguish from it, "effect@location".
      excited_by: motion that makes the effect visible.
      equation: equation in one line, of a law with its numbers.
      latex: the same of a law in LaTeX; empty for an effect of the library.
      tolerances: size of a calibration in tolerances of its number, the largest of several; None of what is no
        calibration, or has no tolerance.
    """

    effect: str
    location: str
    parameters: Mapping[str, Estimate]
    score: float | None = None
    held_out: float | None = None
    equivalent: tuple[str, ...] = ()
    excited_by: str = ""
    equation: str = ""
    latex: str = ""
    tolerances: float | None = None

    @property
    def name(self) -> str:
        """effect@location."""
        return f"{self.effect}@{self.location}"

    def found(self, **changed: float) -> FoundEffect:
        """The effect with its best values, or with others of some parameters."""
        values = {name: estimate.value for name, estimate in self.parameters.items()}
        return FoundEffect(self.effect, self.location, values | changed)


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate in the ranking.

    Attributes:
      effect, location: name and place.
      score: score as of `NamedEffect`.
      margin: score of the first candidate less this one's.
      gain: fall of the loss on the recordings that were fitted.
      held_out: fall of the loss on held-out recordings; None where it was not tried there.
      parameters: values by name.
      beside: effects that were named in earlier rounds and are part of the hypothesis, "effect@location".
      together: members of a hypothesis of several effects that were tried at once, "effect@location", this one
        included; each has the score of all. Empty where it was tried alone.
    """

    effect: str
    location: str
    score: float
    margin: float
    gain: float
    held_out: float | None
    parameters: Mapping[str, float]
    beside: tuple[str, ...] = ()
    together: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refit:
    """A believed parameter and its refitted values.

    Attributes:
      name: name of the parameter.
      believed: value in the dataset.
      refitted: best value without any effect.
      final: best value with the named effects.
    """

    name: str
    believed: float
    refitted: float
    final: float


@dataclass(frozen=True)
class Confound:
    """A candidate or parameter that could be mistaken for a named effect, or a parameter that changed with it.

    Attributes:
      effect: the named effect, "effect@location".
      other: candidate, "effect@location", or believed parameter.
      correlation: correlation of their signatures, in [0, 1]; None for a parameter whose refitted value changed when
        the effect was added.
      text: the same in words.
    """

    effect: str
    other: str
    correlation: float | None
    text: str
