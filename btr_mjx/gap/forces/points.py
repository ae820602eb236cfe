"""A hypothesis with its numbers and calibration, fitted by Gauss-Newton steps in true simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.forces.evidence import LeastSquares, least_squares, penalty
from btr_mjx.gap.forces.kalman_filter import Filtered, Variances, filtered, smoothed
from btr_mjx.gap.forces.motion import FreeNumber, Linearised, linearise_motion, responses
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.forces.unknowns import Library, calibrated_effects, calibrated_number, with_refitted
from btr_mjx.gap.simulate import Counter
from btr_mjx.models import integrate

_SETTLED = 1.0
"""Fall of -2 ln p below which steps end early."""

_SHORTEST = 0.1
"""Part of a Gauss-Newton step that is tried at least."""

ROUNDS = 20
"""Rounds of steps of numbers and of variances, at most. Hypotheses are compared by likelihoods that have to be settled:
a believed model that is 100 away from its best lacks what another one is given."""

_FRESH = 3
"""Steps with derivatives of their own; in later ones numbers move by little."""

_UPDATES = 4
"""Updates of variances in a round."""


@dataclass(frozen=True, eq=False)
class ForceSide:
    """One side of the split.

    Attributes:
      stretches: of its recordings.
      library: columns of the search.
      columns: (S, K, 2 nv, C) responses to all of them beside the believed model.
      counter: adds up the simulated steps.
    """

    stretches: Stretches
    library: Library
    columns: np.ndarray
    counter: Counter


@dataclass(frozen=True, eq=False)
class Point:
    """A hypothesis with its numbers.

    Attributes:
      base: the believed model.
      named: effects with their values.
      calibration: (n,) values of calibration.
    """

    base: Hypothesis
    named: tuple[tuple[Candidate, tuple[float, ...]], ...]
    calibration: np.ndarray

    def hypothesis(self, library: Library, without: int | None = None) -> Hypothesis:
        """The hypothesis that is simulated, calibration included.

        Args:
          library: what calibration consists of.
          without: index of a named effect that is left out.
        """
        out = self.base
        for candidate, own in calibrated_effects(library, self.calibration):
            out = out.with_effect(candidate, own)
        for i, (candidate, own) in enumerate(self.named):
            if i != without:
                out = out.with_effect(candidate, own)
        return out

    @property
    def numbers(self) -> int:
        """Free numbers of the named effects."""
        return sum(len(values) for _, values in self.named)

    def moved(self, changes: np.ndarray, calibration: np.ndarray) -> "Point":
        """Another point: changes (p,) of the numbers, and values of calibration."""
        first, named = 0, []
        for candidate, values in self.named:
            own = np.array(values) + changes[first : first + len(values)]
            first += len(values)
            own = np.clip(own, [p.low for p in candidate.parameters], [p.high for p in candidate.parameters])
            named.append((candidate, tuple(float(v) for v in own)))
        return replace(self, named=tuple(named), calibration=calibration)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A point at which a side was linearised and filtered.

    Attributes:
      point: the point.
      linear: the linearised motion.
      columns: (S, K, 2 nv, p + n) of its numbers and of calibration.
      whitened: of the residual and these columns.
      variances: with which they were whitened.
      loss: -2 ln p, determinants included; inf where the model is no model of a body.
    """

    point: Point
    linear: Linearised
    columns: np.ndarray
    whitened: Filtered
    variances: Variances
    loss: float


def evaluate_point(
    side: ForceSide,
    point: Point,
    variances: Variances,
    known: Fitted | None = None,
    stretches: Stretches | None = None,
    fresh: bool = False,
) -> Fitted:
    """Linearise and filter a point.

    Args:
      side: of the split.
      point: the point.
      variances: of sensors and random force.
      known: a fit of the same names whose transitions and columns are kept; None to compute them.
      fresh: whether of these only columns of calibration are kept, which named effects change little.
      stretches: states around which the motion is linearised; None for those of `known`, or of the side.
    """
    if stretches is None:
        stretches = side.stretches if known is None else known.linear.stretches
    kept = None if known is None or fresh else known.linear
    linear = linearise_motion(stretches, point.hypothesis(side.library), side.counter, kept)
    if known is not None and not fresh:
        return _whitened(point, linear, known.columns, variances, side)
    if known is None:
        calibration = _calibration_columns(side, point, stretches)
    else:
        calibration = known.columns[..., point.numbers :]
    columns = np.concatenate([_own_columns(side, point, stretches), calibration], -1)
    return _whitened(point, linear, columns, variances, side)


def again(side: ForceSide, fit: Fitted, variances: Variances) -> Fitted:
    """The same point with other variances."""
    return _whitened(fit.point, fit.linear, fit.columns, variances, side)


def _whitened(point: Point, linear: Linearised, columns: np.ndarray, variances: Variances, side: ForceSide) -> Fitted:
    try:
        found = filtered(linear, columns, variances)
    except np.linalg.LinAlgError:
        # A body that is left with hardly any inertia moves by more than numbers can hold.
        size = 1 + columns.shape[-1]
        found = Filtered(np.full((len(columns), size, size), np.inf), np.zeros(len(columns)), 0)
    loss = float(found.gram[:, 0, 0].sum() + found.log_determinant.sum())
    loss += variances.penalty + penalty(point.calibration, side.library.calibration)
    return Fitted(point, linear, columns, found, variances, loss if np.isfinite(loss) else np.inf)


def _own_columns(side: ForceSide, point: Point, stretches: Stretches) -> np.ndarray:
    """(S, K, 2 nv, p) derivatives with respect to the numbers of named effects, each at its value."""
    out = [side.columns[..., :0]]
    for i, (candidate, values) in enumerate(point.named):
        numbers = [
            FreeNumber(candidate, j, values, _step(own, values[j])) for j, own in enumerate(candidate.parameters)
        ]
        out.append(responses(stretches, point.hypothesis(side.library, without=i), numbers, side.counter))
    return np.concatenate(out, -1)


def _calibration_columns(side: ForceSide, point: Point, stretches: Stretches) -> np.ndarray:
    """(S, K, 2 nv, n) derivatives with respect to calibration, at its values and beside named effects."""
    library = side.library
    if not library.calibrated:
        return side.columns[..., :0]
    numbers = []
    for entry, value in zip(library.calibrated, point.calibration, strict=True):
        own, index = library.numbers[entry.columns[0][0]], calibrated_number(library, entry)
        there = FreeNumber(entry.candidate, index, tuple(entry.candidate.null), own.step)
        numbers.append(with_refitted(there, value))
    return responses(stretches, point.hypothesis(library), numbers, side.counter)


def _step(parameter, value: float) -> float:  # type: ignore[no-untyped-def]
    """A small step that stays within the range of a parameter."""
    step = 0.2 * parameter.step
    return step if parameter.low <= value + step <= parameter.high else -step


def newton_step(side: ForceSide, fit: Fitted) -> LeastSquares:
    """The Gauss-Newton step from a fitted point."""
    p, n = fit.point.numbers, len(side.library.calibrated)
    design = np.zeros((p + n, n))
    design[p + np.arange(n), np.arange(n)] = 1.0
    calibration = replace(side.library.calibration, design=design, at=fit.point.calibration)
    free = np.zeros((p + n, p))
    free[np.arange(p), np.arange(p)] = 1.0
    values = np.array([v for _, own in fit.point.named for v in own])
    parameters = [own for candidate, _ in fit.point.named for own in candidate.parameters]
    low = np.array([own.low for own in parameters]) - values
    high = np.array([own.high for own in parameters]) - values
    return least_squares(fit.whitened.gram.sum(0), free, calibration, low, high)


def settled(side: ForceSide, point: Point, variances: Variances, about: Stretches | None = None) -> Fitted:
    """A point with numbers and variances at which the likelihood is largest.

    Steps of the numbers and of the variances take turns: random forces start large, where the fit is nearly linear, and
    fall as the numbers come right.

    Args:
      side: the recordings to fit.
      point: where to start.
      variances: with which to start.
      about: states to start from; None for those of the side.

    Returns:
      The fitted point, as it was where its likelihood is nothing.
    """
    fit = evaluate_point(side, point, variances, stretches=about)
    if np.isinf(fit.loss):
        return fit
    stuck, taken = False, 0
    for _ in range(ROUNDS):
        before, updated = fit.loss, fit.variances
        for _ in range(_UPDATES):
            updated = smoothed(fit.linear, np.zeros_like(fit.linear.defect), updated).variances
        fit = again(side, fit, updated)
        # A step that failed is tried again when variances have settled, which costs no simulation.
        if not stuck or before - fit.loss < _SETTLED:
            after = _stepped(side, fit, fresh=taken < _FRESH)
            stuck, fit, taken = after is fit, after, taken + 1
        if before - fit.loss < _SETTLED:
            break
    return fit


def _stepped(side: ForceSide, fit: Fitted, fresh: bool) -> Fitted:
    """The point behind the longest part of a Gauss-Newton step that does not lose; the same one where every part does.

    Args:
      side: the recordings to fit.
      fit: where to start.
      fresh: whether derivatives are computed there anew.
    """
    step, size, own = newton_step(side, fit), 1.0, fit.point.calibration
    change = np.concatenate([step.values, step.calibration - own])
    while size > _SHORTEST:
        # Dry friction turns round within a sample: around states that are smoothed without it, it would be late.
        states = smoothed(fit.linear, size * fit.columns @ change, fit.variances).state
        trial = fit.point.moved(size * step.values, own + size * (step.calibration - own))
        for about in (moved_states(fit.linear.stretches, states), fit.linear.stretches):
            # Derivatives cost ten times what a step does that is tried and not taken.
            after = evaluate_point(side, trial, fit.variances, fit, about)
            if fresh and after.loss < fit.loss + 1.0:
                after = evaluate_point(side, trial, fit.variances, fit, about, fresh=True)
            if after.loss < fit.loss + 1.0:
                return after
        size *= 0.2
    return fit


def moved_states(stretches: Stretches, change: np.ndarray) -> Stretches:
    """Stretches around other states, changed by (S, K + 1, 2 nv)."""
    model = stretches.data.recordings[0].model
    nv = model.nv
    return stretches.about(
        integrate(model, stretches.qpos, change[..., :nv]), stretches.qvel + change[..., nv : 2 * nv]
    )


def covariance(side: ForceSide, fit: Fitted, recording: np.ndarray | None = None) -> np.ndarray:
    """Covariance (p + n, p + n) of the numbers of a fit and of its calibration.

    For every number the larger one of the inverse information and of the sandwich estimate
    H^-1 (sum_s g_s g_s^T) H^-1 with the gradients g_s of the stretches, which holds where stretches differ by more than
    the model says. Given the recording of each stretch, gradients of whole recordings are a third one: stretches of one
    recording err alike.

    Args:
      side: the recordings that were fitted.
      fit: at its numbers.
      recording: (S,) of each stretch; None where only stretches are compared.
    """
    p, cal = fit.point.numbers, side.library.calibration
    gram = fit.whitened.gram[:, 1:, 1:]
    gradient = fit.whitened.gram[:, 1:, 0]
    normal = gram.sum(0)
    normal = normal + np.diag(1e-10 * np.diag(normal) + 1e-300)
    normal[p:, p:] += cal.precision
    inverse = np.linalg.inv(normal)
    variance = np.maximum(_sandwich(inverse, gradient), np.diag(inverse))
    if recording is not None:
        whole = np.stack([gradient[recording == r].sum(0) for r in np.unique(recording)])
        variance = np.maximum(variance, _sandwich(inverse, whole))
    scale = np.sqrt(variance / np.diag(inverse))
    return inverse * scale[:, None] * scale[None, :]


def _sandwich(inverse: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Diagonal of the sandwich estimate with gradients (N, C) of independent parts."""
    count = len(gradient)
    centred = gradient - gradient.mean(0)
    meat = centred.T @ centred * count / max(count - 1, 1)
    return np.diag(inverse @ meat @ inverse)


def names(named: Sequence[tuple[Candidate, tuple[float, ...]]]) -> list[str]:
    """Names of effects."""
    return [candidate.name for candidate, _ in named]
