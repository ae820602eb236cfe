"""A hypothesis with its numbers and calibration, fitted by Gauss-Newton steps in true simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.forces.evidence import penalty
from btr_mjx.gap.forces.kalman_filter import Filtered, Variances, filtered
from btr_mjx.gap.forces.motion import FreeNumber, Linearised, linearise_motion, pushes
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.forces.unknowns import Library, calibrated_effects, calibrated_number, with_refitted
from btr_mjx.gap.simulate import Counter
from btr_mjx.models import integrate

Named = tuple[tuple[Candidate, tuple[float, ...]], ...]
"""Effects with their values."""

_SMALL = 0.2
"""Step of a derivative, in units of one that is visible: rotors of light joints are larger than all that they turn."""

QUANTILE = 1.645
"""Half width of a 90 % interval, in standard errors."""


@dataclass(frozen=True, eq=False)
class ForceSide:
    """One side of the split.

    Attributes:
      stretches: of its recordings.
      library: of the search.
      counter: adds up the simulated steps.
    """

    stretches: Stretches
    library: Library
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
    named: Named
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


Expansion = tuple[Point, Stretches]
"""A point, and states around which the motion is linearised there."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A point at which a side was linearised and filtered.

    Attributes:
      point: the point.
      variances: with which residual and columns were whitened.
      loss: -2 ln p, determinants included; inf where the model is no model of a body.
      parts: its linearised motion, pushes of its numbers and of calibration, and residual and columns whitened, which
        are computed at the first call where the fit was read from a file.
      places: where pushes of calibration, other derivatives, and the motion were computed.
    """

    point: Point
    variances: Variances
    loss: float
    parts: Callable[[], tuple[Linearised, np.ndarray, Filtered]]
    places: tuple[Expansion, Expansion, Expansion]

    @property
    def linear(self) -> Linearised:
        """The linearised motion."""
        return self.parts()[0]

    @property
    def pushes(self) -> np.ndarray:
        """(S, K, nv + m, p + n) of its numbers and of calibration."""
        return self.parts()[1]

    @property
    def columns(self) -> np.ndarray:
        """(S, K, nx, p + n) derivatives with respect to its numbers and to calibration."""
        return self.linear.responses(self.pushes)

    @property
    def whitened(self) -> Filtered:
        """Of the residual and the columns."""
        return self.parts()[2]

    @property
    def stretches(self) -> Stretches:
        """With the states around which the motion is linearised."""
        return self.places[-1][1]

    def with_whitened(self, whitened: Filtered) -> "Fitted":
        """The same with another residual and columns, whitened."""
        return replace(self, parts=lambda: (self.linear, self.pushes, whitened))


def evaluate_point(
    side: ForceSide,
    point: Point,
    variances: Variances,
    known: Fitted | None = None,
    stretches: Stretches | None = None,
    anew: bool = False,
) -> Fitted:
    """Linearise and filter a point.

    Args:
      side: of the split.
      point: the point.
      variances: of sensors and random force.
      known: a fit of the same names whose derivatives are kept; None to compute them.
      stretches: states around which the motion is linearised; None for those of `known`, or of the side.
      anew: whether only pushes of calibration, which moves by little, are those of `known`.
    """
    if stretches is None:
        stretches = side.stretches if known is None else known.stretches
    here = (point, stretches)
    if known is not None and not anew:
        linear = linearise_motion(stretches, point.hypothesis(side.library), side.counter, known.linear)
        return _whitened(linear, known.pushes, variances, side, (*known.places[:2], here))
    linear = linearise_motion(stretches, point.hypothesis(side.library), side.counter)
    own = _pushes(side, point, linear)
    if known is None:
        return _whitened(linear, _with_calibration(side, point, linear, own), variances, side, (here, here, here))
    every = np.concatenate([own, known.pushes[..., own.shape[-1] :]], -1)
    return _whitened(linear, every, variances, side, (known.places[0], here, here))


def evaluate_places(side: ForceSide, places: tuple[Expansion, Expansion, Expansion], variances: Variances) -> Fitted:
    """Linearise and filter the last of the places of a fit, see `Fitted`, with derivatives of the others.

    Args:
      side: of the split.
      places: of a fit.
      variances: of sensors and random force.
    """
    (begun, first), (taken, derived), (last, moved) = places
    fit = evaluate_point(side, begun, variances, stretches=first)
    fit = evaluate_point(side, taken, variances, fit, derived, anew=True)
    return evaluate_point(side, last, variances, fit, moved)


def again(side: ForceSide, fit: Fitted, variances: Variances) -> Fitted:
    """The same point with other variances."""
    return _whitened(fit.linear, fit.pushes, variances, side, fit.places)


def _whitened(
    linear: Linearised,
    forces: np.ndarray,
    variances: Variances,
    side: ForceSide,
    places: tuple[Expansion, Expansion, Expansion],
) -> Fitted:
    point, columns = places[-1][0], linear.responses(forces)
    try:
        found = filtered(linear, columns, variances)
    except np.linalg.LinAlgError:
        # A body that is left with hardly any inertia moves by more than numbers can hold.
        size = 1 + columns.shape[-1]
        found = Filtered(np.full((len(columns), size, size), np.inf), np.zeros(len(columns)), 0)
    loss = float(found.gram[:, 0, 0].sum() + found.log_determinant.sum())
    loss += variances.penalty + penalty(point.calibration, side.library.calibration)
    return Fitted(point, variances, loss if np.isfinite(loss) else np.inf, lambda: (linear, forces, found), places)


def _pushes(side: ForceSide, point: Point, linear: Linearised) -> np.ndarray:
    """(S, K, nv + m, p) of numbers of named effects, each at its value."""
    out = [np.zeros((*linear.interval.shape, linear.force.shape[-1] + linear.slope.shape[-2], 0))]
    for i, (candidate, values) in enumerate(point.named):
        numbers = [
            FreeNumber(candidate, j, values, _step(own, values[j])) for j, own in enumerate(candidate.parameters)
        ]
        out.append(pushes(linear, point.hypothesis(side.library, without=i), numbers, side.counter))
    return np.concatenate(out, -1)


def _with_calibration(side: ForceSide, point: Point, linear: Linearised, own: np.ndarray) -> np.ndarray:
    """Pushes (S, K, nv + m, p + n) of a point: its own, then those of calibration."""
    numbers = []
    for entry, value in zip(side.library.calibrated, point.calibration, strict=True):
        step, index = side.library.numbers[entry.columns[0][0]].step, calibrated_number(side.library, entry)
        there = FreeNumber(entry.candidate, index, tuple(entry.candidate.null), _SMALL * step)
        numbers.append(with_refitted(there, value))
    return np.concatenate([own, pushes(linear, point.hypothesis(side.library), numbers, side.counter)], -1)


def _step(parameter, value: float) -> float:  # type: ignore[no-untyped-def]
    """A small step that stays within the range of a parameter."""
    step = _SMALL * parameter.step
    return step if parameter.low <= value + step <= parameter.high else -step


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


def numbers_of(point: Point) -> np.ndarray:
    """(p + n,) numbers of named effects, and calibration."""
    return np.array([*(v for _, values in point.named for v in values), *point.calibration], float)


def with_numbers(point: Point, numbers: np.ndarray) -> Point:
    """A point with the numbers (p + n,) of another one of the same names."""
    named, first = [], 0
    for candidate, values in point.named:
        named.append((candidate, tuple(float(v) for v in numbers[first : first + len(values)])))
        first += len(values)
    return replace(point, named=tuple(named), calibration=numbers[first:])


def names(named: Sequence[tuple[Candidate, tuple[float, ...]]]) -> list[str]:
    """Names of effects."""
    return [candidate.name for candidate, _ in named]
