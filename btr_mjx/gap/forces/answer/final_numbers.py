"""Numbers of the effects that were confirmed, as the mended model has them."""

from dataclasses import replace

import numpy as np

from btr_mjx.gap.effects import OF_LOG
from btr_mjx.gap.forces.horizons import follow_horizons
from btr_mjx.gap.forces.points import QUANTILE, Fitted, ForceSide, Named, Point, covariance, numbers_of, with_numbers
from btr_mjx.gap.forces.settling import settled
from btr_mjx.gap.forces.unknowns import Library, calibrated_number

_SEEN = 0.3
"""Smallest number that is named, in units of the step at which its effect is clearly visible."""


def without_invisible(side: ForceSide, fit: Fitted) -> Fitted:
    """A fit without effects whose numbers are too small to be seen, or may as well be nothing."""
    while len(seen := _visible(side, fit)) < len(fit.point.named):
        fit = settled(side, replace(fit.point, named=seen), fit.variances, about=fit.stretches)
    return fit


def last_numbers(side: ForceSide, fit: Fitted, follow: bool) -> Point:
    """The point of a fit as the mended model has it.

    A change is the difference of two sets whose numbers are found alike: those of neither follow recordings, and what
    moves within the calibration that the first set leaves open is no change.

    Args:
      side: the recordings to fit.
      fit: with named effects.
      follow: whether its numbers follow recordings, see `follow_horizons`.
    """
    return _followed(side, fit) if follow else _without_log(side.library, fit.point)


def _followed(side: ForceSide, fit: Fitted) -> Point:
    """The point of a fit as the mended model has it, with numbers that follow recordings."""
    point, spread = _without_log(side.library, _merged(side.library, fit.point)), covariance(side, fit)
    named = [(candidate.name, candidate.parameters, values) for candidate, values in point.named]
    start = (point.base, named, point.calibration, side.library.calibration.reach, spread, side.stretches.data)

    def found() -> dict[str, np.ndarray]:
        return {"numbers": numbers_of(follow_horizons(side, point, spread, side.library))}

    return with_numbers(point, side.counter.remembered(("followed", start), found)["numbers"])


def _without_log(library: Library, point: Point) -> Point:
    """A point without what belongs to the log: when commands act within a sample, torque constants of drives."""
    of_log = np.array([entry.candidate.effect.name in OF_LOG for entry in library.calibrated], bool)
    return replace(point, calibration=np.where(of_log, 0.0, point.calibration))


def _merged(library: Library, point: Point) -> Point:
    """A point whose calibration of a number that is named is part of that number."""
    rest, named = point.calibration.copy(), []
    for candidate, values in point.named:
        own, labels = np.array(values), [single.place.label for single in candidate.singles]
        for i, entry in enumerate(library.calibrated):
            place = entry.candidate.place.label
            if entry.candidate.effect is candidate.effect and place in labels:
                own[labels.index(place) + calibrated_number(library, entry)] += rest[i]
                rest[i] = 0.0
        bounded = np.clip(own, [p.low for p in candidate.parameters], [p.high for p in candidate.parameters])
        named.append((candidate, tuple(float(v) for v in bounded)))
    return replace(point, named=tuple(named), calibration=rest)


def _visible(side: ForceSide, fit: Fitted) -> Named:
    """Named effects with a number that is visible.

    It is of the size of its step, no smaller than what is never named, and "none" is not within its interval.
    """
    half, out, i = QUANTILE * np.sqrt(np.diag(covariance(side, fit))), [], 0
    for candidate, values in fit.point.named:
        rows = zip(values, candidate.parameters, half[i : i + len(values)], strict=True)
        if any(abs(v - p.null) > max(_SEEN * abs(p.step), p.negligible, h) for v, p, h in rows if not p.shape):
            out.append((candidate, values))
        i += len(values)
    return tuple(out)
