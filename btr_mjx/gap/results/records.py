"""What a diagnosis says: plain records, everything that a report or result.json needs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Verdict = Literal["effect", "none", "unexplained"]


@dataclass(frozen=True)
class Estimate:
    """A number with its interval.

    Attributes:
      value: best estimate.
      low, high: 90 % interval, from resampled windows; it does not assume that the fit is good.
      unit: SI.
      null: value at which the effect is absent.
      edge: whether it is the largest or smallest value that is tried: the true one may be beyond.
    """

    value: float
    low: float
    high: float
    unit: str
    null: float = 0.0
    edge: bool = False


@dataclass(frozen=True)
class Named:
    """An effect that was named.

    Attributes:
      effect: its name.
      location: where it sits.
      parameters: its numbers by name.
      score: by how much the data prefer it to its absence, in units of log-likelihood times two, less its price.
      held_out: the part of it that comes from held-out recordings.
      equivalent: candidates that these data cannot tell from it, "effect@location".
      excited_by: motion that shows it.
      equation: in one line.
    """

    effect: str
    location: str
    parameters: Mapping[str, Estimate]
    score: float
    held_out: float
    equivalent: tuple[str, ...] = ()
    excited_by: str = ""
    equation: str = ""

    @property
    def name(self) -> str:
        """effect@location."""
        return f"{self.effect}@{self.location}"


@dataclass(frozen=True)
class Calibrated:
    """A small error of calibration beside which an effect was named; by itself it needs no name.

    Attributes:
      effect: its name.
      location: where it sits.
      parameters: its numbers by name.
    """

    effect: str
    location: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """A row of the ranking.

    Attributes:
      effect, location: the candidate.
      score: as of `Named`.
      margin: by how much the winner's score is larger.
      gain: fall of the loss on the recordings that were fitted.
      held_out: fall of the loss on those held out.
      parameters: its numbers by name.
      beside: effects that were found before and stay, "effect@location".
      fresh: fall of the loss on windows that were looked at last; 0 where there was no need.
    """

    effect: str
    location: str
    score: float
    margin: float
    gain: float
    held_out: float
    parameters: Mapping[str, float]
    beside: tuple[str, ...] = ()
    fresh: float = 0.0


@dataclass(frozen=True)
class Gap:
    """The gap between simulation and held-out data, before and after.

    Attributes:
      before, after: chi^2 of a window per degree of freedom, tolerances at their best, bounded per window.
      noise_floor: what it would be with nothing missing: what simulated nulls leave, or what the mended model leaves
        where that is less. Before and after share one realisation of the noise, of which nulls know the size alone.
      nulls: what simulated nulls leave.
      error_before, error_after: root mean square error at the end of a window [units of the noise].
      open_loop_before, open_loop_after: mean absolute position error over whole held-out recordings, simulated from
        the first sample [rad or m]; NaN where motion touches the world and is chaotic.
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
        """Part of the excess over the noise floor that is closed."""
        excess = self.before - self.noise_floor
        return float((self.before - self.after) / excess) if excess > 0 else 0.0


@dataclass(frozen=True)
class Refit:
    """A believed number and where it went.

    Attributes:
      name: of the parameter.
      believed: as the dataset has it.
      refitted: with nothing missing.
      final: with the named effects.
    """

    name: str
    believed: float
    refitted: float
    final: float


@dataclass(frozen=True)
class Confound:
    """Something that could be mistaken for a named effect, or that gave way to it.

    Attributes:
      effect: what was named, "effect@location".
      other: candidate, "effect@location", or believed parameter.
      correlation: of their traces, in [0, 1]; None for a parameter that moved when the effect entered.
      text: in words.
    """

    effect: str
    other: str
    correlation: float | None
    text: str


@dataclass(frozen=True)
class Overlay:
    """A held-out stretch for a figure.

    Attributes:
      recording: its name.
      coordinate: name of the joint at which the two models differ most, or the data from the only one.
      time: (K,) [s].
      measured, before, after: (K,) position [rad or m].
    """

    recording: str
    coordinate: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class DisagreementMap:
    """Where simulation and data disagree before any fit.

    Attributes:
      places: joints, and bodies with a free joint.
      regimes: what the motion is like.
      value: (places, regimes) mean square of the unknown generalised force there in units of what noise would give; 1
        is the noise floor, NaN where the regime does not occur.
      count: (places, regimes) intervals behind each number.
    """

    places: tuple[str, ...]
    regimes: tuple[str, ...]
    value: np.ndarray
    count: np.ndarray


@dataclass(frozen=True)
class Diagnosis:
    """The outcome of a search.

    Attributes:
      verdict: "effect", "none" or "unexplained".
      effects: what was named, the largest first; for "unexplained" empty.
      ranking: candidates, best first.
      equivalent: names that these data cannot tell from the winner, the winner included; of "none" what is not ruled
        out either.
      gap: on the held-out recordings.
      disagreement: the map.
      unexplained: what is left, in words.
      believed: what may be refitted.
      calibration: small errors beside which the effects were named; the mended model has them, too.
      confounds: what could be mistaken for what was named, and what gave way to it.
      overlays: stretches for figures.
      share: part of what any force could explain that the named effects explain.
      lack_of_fit: standard deviations by which the data exceed the noise, before and after.
      threshold: score that a name needs.
      dispersion: chi^2 per degree of freedom of the best fit; scores are divided by it.
      sigma: (2 nv,) noise that was used.
      windows: numbers of windows to fit and held out, samples of each, length [s].
      steps: simulated steps.
      seconds: time it took.
      survivors: hypotheses that are still possible, for the choice of the next experiment.
      notes: for the reader.
    """

    verdict: Verdict
    effects: tuple[Named, ...]
    ranking: tuple[Row, ...]
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
    calibration: tuple[Calibrated, ...] = ()
    survivors: tuple = field(default=(), repr=False)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class NextExperiment:
    """A command that is proposed to be recorded next.

    Attributes:
      time: (K,) [s].
      values: (K, nu) command.
      between: the two names that it is expected to separate.
      disagreement: expected difference of their scores in one recording.
      others: the same for every command that was compared, in their order.
      chosen: which of these it is.
      reason: in words.
    """

    time: np.ndarray
    values: np.ndarray
    between: tuple[str, str]
    disagreement: float
    others: tuple[float, ...]
    chosen: int
    reason: str
