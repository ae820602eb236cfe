"""A diagnosis: what a search found, as numbers, and what follows from them.

The verdict, whether the noise's level is reached, and what a mended model may be called are functions of the numbers.
Nothing that can be computed is stored, and what was not measured is None: no sentence speaks of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from btr_mjx.gap.effects import ResidualTable
from btr_mjx.gap.results.drawn import DisagreementMap, JointForce, Overlay
from btr_mjx.gap.results.records import Confound, NamedEffect, RankedCandidate, Refit

Verdict = Literal["effect", "none", "unexplained"]
"""An effect is missing, nothing is missing, or something is missing that no known effect explains."""

MendedKind = Literal["explained", "partly explained", "unnamed", "calibrated"]
"""What a mended model is: it has effects that were named, which explain what is missing down to the noise or a part of
it; or numbers that predict better and may not be called by name; or calibration alone."""

DELTA_FITNESS = "Delta_fitness"
"""What stands for a joint where only fitness was measured."""

NOISE_REACHED = 2.0
"""Error of a prediction, in units of what noise and time step make, up to which it is at the noise's level."""


@dataclass(frozen=True)
class JointError:
    """Root mean square error of a joint's position on held-out recordings, predicted from measured states.

    Attributes:
      joint: in words; "position of body torso" and "orientation of body torso" for a free joint.
      unit: "rad" or "m"; "m/s" of fitness.
      horizon: time from a measured state to the prediction [s].
      before: of the believed model.
      after: of the mended model; None where there is none.
      noise: what the sensors' noise alone makes of these predictions; None where it is not known.
      time_step: what the time step of the model alone makes of them; None where it is not known.
      constant_velocity: of the simplest predictor; None where it was not tried.
    """

    joint: str
    unit: str
    horizon: float
    before: float
    after: float | None = None
    noise: float | None = None
    time_step: float | None = None
    constant_velocity: float | None = None

    @property
    def floor(self) -> float | None:
        """What noise and time step together make; None where noise is not known."""
        return math.hypot(self.noise, self.time_step or 0.0) if self.noise else None


@dataclass(frozen=True)
class Misfit:
    """How far predictions of held-out recordings are off, on one scale.

    Attributes:
      unit: "noise": 1 is what the sensors' noise and the model's time step make, and each number the root mean square
        over joints. Else an SI unit, of a single number whose noise is not known.
      before, after, constant_velocity: of the believed model, the mended one and the simplest predictor.
      noise_before, noise_after: whether every joint is at the noise's level, see `NOISE_REACHED`.
    """

    unit: str
    before: float
    after: float | None
    constant_velocity: float | None
    noise_before: bool | None
    noise_after: bool | None

    @property
    def noise_reached(self) -> bool | None:
        """Whether the best model that there is predicts down to the noise; None where noise is not known."""
        return self.noise_before if self.after is None else self.noise_after

    @property
    def explained(self) -> float | None:
        """Share of what is beyond the noise that the mended model explains, in [0, 1]; None where it does not fall."""
        excess = self.before - (1.0 if self.unit == "noise" else 0.0)
        if self.after is None or not self.after < self.before or excess <= 0:
            return None
        return min((self.before - self.after) / excess, 1.0)


def misfit_of(errors: Sequence[JointError]) -> Misfit | None:
    """The misfit over all joints; None where there is nothing that could be compared.

    Args:
      errors: of each joint, by the same models.
    """
    known = [(row, row.floor) for row in errors if row.floor]
    if not known:
        if len(errors) != 1:
            return None
        (row,) = errors
        return Misfit(row.unit, row.before, row.after, row.constant_velocity, None, None)

    def ratios(key: str) -> np.ndarray | None:
        values = [getattr(row, key) for row, _ in known]
        if any(value is None for value in values):
            return None
        return np.array(values) / np.array([floor for _, floor in known])

    def root_mean_square(ratio: np.ndarray | None) -> float | None:
        return None if ratio is None else float(np.sqrt((ratio**2).mean()))

    before, after = ratios("before"), ratios("after")
    assert before is not None
    return Misfit(
        "noise",
        float(np.sqrt((before**2).mean())),
        root_mean_square(after),
        root_mean_square(ratios("constant_velocity")),
        bool((before <= NOISE_REACHED).all()),
        None if after is None else bool((after <= NOISE_REACHED).all()),
    )


def verdict_of(is_found: bool, is_left: bool, misfit: Misfit | None, chi2: "Chi2 | None" = None) -> Verdict:
    """The verdict.

    Args:
      is_found: whether effects were found that may be named.
      is_left: whether something is left that they do not explain.
      misfit: of held-out recordings.
      chi2: of held-out recordings; what predicts them down to the noise, and leaves no more than nulls do, leaves
        nothing.
    """
    at_noise = misfit is not None and misfit.noise_reached and (chi2 is None or chi2.after <= chi2.nulls)
    if is_left and not at_noise:
        return "unexplained"
    return "effect" if is_found else "none"


@dataclass(frozen=True)
class OpenLoop:
    """Mean absolute position error over whole held-out recordings, simulated from their first sample [rad or m].

    Attributes:
      before: of the believed model.
      after: of the mended model; None where there is none.
    """

    before: float
    after: float | None = None


@dataclass(frozen=True)
class Chi2:
    """chi^2 per degree of freedom of held-out recordings, by the likelihood that compares hypotheses.

    Scores are differences of it. How far a model is from the noise is told by `Misfit` alone.

    Attributes:
      before, after: of the believed model and the mended one, tolerances at their best, bounded per window; where the
        robot touches nothing that of the median stretch.
      nulls: of simulated nulls; where the robot touches nothing the level of the noise that was estimated.
    """

    before: float
    after: float
    nulls: float


@dataclass(frozen=True)
class Diagnosis:
    """The outcome of a search.

    Attributes:
      found: effects that the mended model has beside calibration, the largest first; `effects` are those to be named.
      ranking: candidates, best first.
      steps: simulated steps.
      seconds: duration of the search [s].
      unexplained: descriptions of the part that no candidate explains; empty where nothing is left.
      joint_errors: errors of predictions by joint, of which the misfit and the verdict follow.
      open_loop: errors over whole recordings; None where contacts make the motion chaotic.
      chi2: of the likelihood; None where there is none.
      calibration: effects within the usual tolerances, the largest first, which the mended model has beside those.
      equivalent: candidates that these data cannot distinguish from the first one, which is included; for "none" those
        that are not ruled out.
      disagreement: map by place and regime; None where none was made.
      believed: believed parameters that could be refitted.
      confounds: possible confusions with the named effects, and parameters that changed with them.
      overlays: parts of held-out recordings for figures.
      share: share of the chi^2 that any force could explain that the found effects explain.
      lack_of_fit: standard deviations by which the misfit exceeds the noise, before and after.
      threshold: score that a name needs at least.
      dispersion: chi^2 per degree of freedom of the best fit; scores are divided by it.
      sigma: (2 nv,) noise of positions and velocities.
      windows: numbers of windows to fit and held out, samples of each, length [s].
      survivors: hypotheses that are still possible, for the choice of the next experiment.
      notes: remarks for the reader.
      joint_forces: missing force at joints, for a figure.
      residual: tables of the force that nothing explains, where they were asked for.
    """

    found: tuple[NamedEffect, ...]
    ranking: tuple[RankedCandidate, ...]
    steps: int
    seconds: float
    unexplained: tuple[str, ...] = ()
    joint_errors: tuple[JointError, ...] = ()
    open_loop: OpenLoop | None = None
    chi2: Chi2 | None = None
    calibration: tuple[NamedEffect, ...] = ()
    equivalent: tuple[str, ...] = ()
    disagreement: DisagreementMap | None = None
    believed: tuple[Refit, ...] = ()
    confounds: tuple[Confound, ...] = ()
    overlays: tuple[Overlay, ...] = ()
    share: float | None = None
    lack_of_fit: tuple[float, float] | None = None
    threshold: float | None = None
    dispersion: float | None = None
    sigma: np.ndarray | None = None
    windows: tuple[int, int, int, float] | None = None
    survivors: tuple = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    joint_forces: tuple[JointForce, ...] = field(default=(), repr=False)
    residual: tuple[ResidualTable, ...] = field(default=(), repr=False)

    @property
    def misfit(self) -> Misfit | None:
        """How far predictions of held-out recordings are off."""
        return misfit_of(self.joint_errors)

    @property
    def verdict(self) -> Verdict:
        """What the numbers say, see `verdict_of`."""
        return verdict_of(bool(self.found), bool(self.unexplained), self.misfit, self.chi2)

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """Effects that are called by name."""
        return self.found if self.verdict == "effect" else ()

    @property
    def unnamed(self) -> tuple[NamedEffect, ...]:
        """Effects of the mended model that may not be called by name, since something else is missing."""
        return () if self.verdict == "effect" else self.found

    @property
    def mended_kind(self) -> MendedKind | None:
        """What the mended model is; None where there is none."""
        if self.effects:
            misfit = self.misfit
            return "partly explained" if misfit is not None and misfit.noise_reached is False else "explained"
        if self.unnamed or self.residual:
            return "unnamed"
        return "calibrated" if self.calibration else None
