"""Records of a diagnosis: plain data classes that hold everything that the page or result.json needs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from btr_mjx.gap.effects import ResidualTable
from btr_mjx.gap.results.drawn import DisagreementMap, JointForce, Overlay

Verdict = Literal["effect", "none", "unexplained"]
"""An effect is missing, nothing is missing, or something is missing that no known effect explains."""


@dataclass(frozen=True)
class Estimate:
    """A parameter with its interval.

    Attributes:
      value: best estimate.
      low, high: 90 % interval; it does not assume that the fit is good.
      unit: SI unit.
      null: value at which the effect is absent.
      edge: whether the value is at the edge of its range; the true value may be beyond.
    """

    value: float
    low: float
    high: float
    unit: str
    null: float = 0.0
    edge: bool = False


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
    """An effect that was named.

    Attributes:
      effect: name of the effect.
      location: label of its place.
      parameters: estimates by name.
      score: fall of the loss by the effect, in units of twice the log-likelihood, less the price of its parameters.
      held_out: part of the score that comes from held-out recordings.
      equivalent: candidates that these data cannot distinguish from it, "effect@location".
      excited_by: motion that makes the effect visible.
      equation: equation in one line, of a law with its numbers.
      latex: the same of a law in LaTeX; empty for an effect of the library.
    """

    effect: str
    location: str
    parameters: Mapping[str, Estimate]
    score: float
    held_out: float
    equivalent: tuple[str, ...] = ()
    excited_by: str = ""
    equation: str = ""
    latex: str = ""

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
      held_out: fall of the loss on held-out recordings.
      parameters: values by name.
      beside: effects that were named in earlier rounds and are part of the hypothesis, "effect@location".
    """

    effect: str
    location: str
    score: float
    margin: float
    gain: float
    held_out: float
    parameters: Mapping[str, float]
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Gap:
    """The gap between simulation and held-out data, before and after.

    Attributes:
      before, after: chi^2 of a window per degree of freedom, tolerances at their best, bounded per window; where the
        robot touches nothing that of the median stretch.
      noise_floor: chi^2 with nothing missing: that of simulated nulls, or that of the mended model where it is smaller.
        Before and after share one realisation of the noise; nulls have other realisations of the same size.
      nulls: chi^2 of simulated nulls.
      error_before, error_after: root mean square error at the end of a window [units of the noise].
      open_loop_before, open_loop_after: mean absolute position error over whole held-out recordings, simulated from
        the first sample [rad or m]; NaN where contacts make the motion chaotic.
    """

    before: float
    after: float
    noise_floor: float
    nulls: float
    error_before: float
    error_after: float
    open_loop_before: float
    open_loop_after: float

    @property
    def closed(self) -> float:
        """Share of the excess over the noise floor that is closed."""
        excess = self.before - self.noise_floor
        return float((self.before - self.after) / excess) if excess > 0 else 0.0


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


@dataclass(frozen=True)
class Predictions:
    """Root mean square errors of positions of held-out recordings, predicted over a horizon from measured states.

    Attributes:
      horizon: [s].
      believed: error of the believed model, of all joints together [rad or m].
      mended: of the mended model; the same where nothing is named.
      constant_velocity: of the simplest predictor.
    """

    horizon: float
    believed: float
    mended: float
    constant_velocity: float


@dataclass(frozen=True)
class JointError:
    """Root mean square error of a joint's position on held-out recordings, as in `Predictions`.

    Attributes:
      joint: in words; "position of body torso" and "orientation of body torso" for a free joint.
      unit: "rad" or "m".
      horizon: time from a measured state to the prediction [s].
      before, after: of the believed and the mended model.
      noise: what the sensor's noise alone makes.
    """

    joint: str
    unit: str
    horizon: float
    before: float
    after: float
    noise: float


@dataclass(frozen=True)
class Diagnosis:
    """The outcome of a search.

    Attributes:
      verdict: "effect", "none" or "unexplained".
      effects: named effects, the largest first; empty for "unexplained".
      calibration: effects within the usual tolerances, the largest first, which the mended model has beside those.
      ranking: candidates, best first.
      equivalent: candidates that these data cannot distinguish from the first one, which is included; for "none" those
        that are not ruled out.
      gap: gap between simulation and held-out recordings.
      disagreement: map by place and regime.
      unexplained: descriptions of the part that no candidate explains.
      believed: believed parameters that could be refitted.
      confounds: possible confusions with the named effects, and parameters that changed with them.
      overlays: parts of held-out recordings for figures.
      share: share of the chi^2 that any force could explain that the named effects explain.
      lack_of_fit: standard deviations by which the misfit exceeds the noise, before and after.
      threshold: score that a name needs at least.
      dispersion: chi^2 per degree of freedom of the best fit; scores are divided by it.
      sigma: (2 nv,) noise of positions and velocities.
      windows: numbers of windows to fit and held out, samples of each, length [s].
      steps: simulated steps.
      seconds: duration of the search [s].
      survivors: hypotheses that are still possible, for the choice of the next experiment.
      predictions: of held-out recordings over a short horizon; None where none were made.
      notes: remarks for the reader.
      joint_forces: missing force at joints, for a figure.
      residual: tables of the force that nothing explains, where they were asked for.
      joint_errors: errors of the same predictions by joint.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    ranking: tuple[RankedCandidate, ...]
    equivalent: tuple[str, ...]
    gap: Gap
    disagreement: DisagreementMap
    unexplained: tuple[str, ...]
    believed: tuple[Refit, ...]
    confounds: tuple[Confound, ...]
    overlays: tuple[Overlay, ...]
    share: float
    lack_of_fit: tuple[float, float]
    threshold: float
    dispersion: float
    sigma: np.ndarray
    windows: tuple[int, int, int, float]
    steps: int
    seconds: float
    survivors: tuple = field(default=(), repr=False)
    predictions: Predictions | None = None
    notes: tuple[str, ...] = ()
    calibration: tuple[NamedEffect, ...] = ()
    joint_forces: tuple[JointForce, ...] = field(default=(), repr=False)
    residual: tuple[ResidualTable, ...] = field(default=(), repr=False)
    joint_errors: tuple[JointError, ...] = ()
