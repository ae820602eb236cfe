"""Numbers and variances at which the likelihood is largest; a search that is resumed reads them."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from btr_mjx.gap.forces.evidence import LeastSquares, least_squares
from btr_mjx.gap.forces.kalman_filter import Variances, smoothed
from btr_mjx.gap.forces.points import (
    Expansion,
    Fitted,
    ForceSide,
    Point,
    again,
    evaluate_places,
    evaluate_point,
    moved_states,
    numbers_of,
    with_numbers,
)
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import Counter

_SETTLED = 1.0
"""Fall of -2 ln p below which steps end early."""

_SHORTEST = 0.1
"""Part of a Gauss-Newton step that is tried at least."""

_TOLERATED = 1.0
"""Rise of -2 ln p of a step that is taken: around other states the same motion is a little more or less likely."""

ROUNDS = 20
"""Rounds of steps of numbers and of variances, at most. Hypotheses are compared by likelihoods that have to be settled:
a believed model that is 100 away from its best lacks what another one is given."""

_FRESH = 3
"""Steps with derivatives of their own; in later ones numbers move by little."""

_FARTHEST = 8.0
"""Largest factor by which changes of variances are extrapolated."""


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


def settled(
    side: ForceSide, point: Point, variances: Variances, about: Stretches | None = None, rounds: int = ROUNDS
) -> Fitted:
    """A point with numbers and variances at which the likelihood is largest.

    Steps of the numbers and of the variances take turns: random forces start large, where the fit is nearly linear, and
    fall as the numbers come right.

    Args:
      side: the recordings to fit.
      point: where to start.
      variances: with which to start.
      about: states to start from; None for those of the side.
      rounds: of steps, at most.

    Returns:
      The fitted point, as it was where its likelihood is nothing.
    """
    library = side.library
    calibrated = [(own.candidate.name, library.numbers[own.columns[0][0]].step) for own in library.calibrated]
    named = [(candidate.name, candidate.parameters, values) for candidate, values in point.named]
    start = (point.base, named, point.calibration, calibrated, library.calibration, variances, rounds)
    found: list[Fitted] = []

    def record() -> dict[str, np.ndarray]:
        found.append(_settled(side, point, variances, about, rounds))
        return record_of(found[0])

    known = side.counter.remembered(("settled", start, about or side.stretches), record)
    return found[0] if found else fit_of(side, point, known)


def _settled(side: ForceSide, point: Point, variances: Variances, about: Stretches | None, rounds: int) -> Fitted:
    fit = evaluate_point(side, point, variances, stretches=about)
    if np.isinf(fit.loss):
        return fit
    stuck, taken = False, 0
    for _ in range(rounds):
        before = fit.loss
        fit = again(side, fit, updated_variances(fit))
        # A step that failed is tried again when variances have settled, which costs no simulation. Derivatives behind
        # the last round would serve nothing.
        if not stuck or before - fit.loss < _SETTLED:
            after = _stepped(side, fit, fresh=taken < min(_FRESH, rounds - 1))
            stuck, fit, taken = after is fit, after, taken + 1
        if before - fit.loss < _SETTLED:
            break
    return fit


def updated_variances(fit: Fitted) -> Variances:
    """Variances nearer to their best at a point: three updates, with an extrapolation of two of them before the last.

    Updates converge slowly where a random force and the noise of a sensor explain the same; squared extrapolation of
    their logarithms does not (SQUAREM; Varadhan and Roland, 2008). An extrapolation that is less likely than what it
    starts from is not taken.
    """
    nothing = np.zeros_like(fit.linear.defect)
    first = smoothed(fit.linear, nothing, fit.variances)
    second = smoothed(fit.linear, nothing, first.variances)
    path = [np.log(np.r_[v.sensor, v.force, v.jitter]) for v in (fit.variances, first.variances, second.variances)]
    change, bend = path[1] - path[0], path[2] - 2 * path[1] + path[0]
    length = np.clip(np.linalg.norm(change) / max(np.linalg.norm(bend), 1e-300), 1.0, _FARTHEST)
    there = np.exp(path[0] + 2 * length * change + length**2 * bend)
    nx = len(fit.variances.sensor)
    sensor, force, jitter = there[:nx], there[nx:-1], float(there[-1])
    bold = replace(second.variances, sensor=np.maximum(sensor, fit.stretches.least**2), force=force, jitter=jitter)
    third = smoothed(fit.linear, nothing, bold)
    return third.variances if third.loss < first.loss else second.variances


def _stepped(side: ForceSide, fit: Fitted, fresh: bool) -> Fitted:
    """The point behind the part of a Gauss-Newton step that gains most; the same one where every part loses.

    Args:
      side: the recordings to fit.
      fit: where to start.
      fresh: whether derivatives are computed there anew. The first part that does not lose is taken where they are not,
        since numbers move by little then.
    """
    step, own = newton_step(side, fit), fit.point.calibration
    change = np.concatenate([step.values, step.calibration - own])

    def part(size: float) -> Fitted:
        # Dry friction turns round within a sample: around states that are smoothed without it, it would be late.
        states = smoothed(fit.linear, size * fit.columns @ change, fit.variances).state
        trial = fit.point.moved(size * step.values, own + size * (step.calibration - own))
        places = moved_states(fit.stretches, states), fit.stretches
        moved, same = (evaluate_point(side, trial, fit.variances, fit, about) for about in places)
        return moved if moved.loss < min(same.loss, fit.loss) + _TOLERATED else same

    size, best = 1.0, part(1.0)
    while size > _SHORTEST:
        after = part(size / 2) if fresh or best.loss >= fit.loss + _TOLERATED else best
        size /= 2
        if after.loss < best.loss:
            best = after
            continue
        # Derivatives cost ten times what a step does that is tried and not taken.
        found = best
        if fresh and best.loss < fit.loss + _TOLERATED:
            found = evaluate_point(side, best.point, fit.variances, fit, best.stretches, anew=True)
        if found.loss < fit.loss + _TOLERATED:
            return found
        best = after
    return fit


def record_of(fit: Fitted) -> dict[str, np.ndarray]:
    """What `fit_of` needs: numbers and states of its places, variances and loss, a thousandth of its derivatives."""
    weight = fit.variances.weight
    return {
        "numbers": np.stack([numbers_of(point) for point, _ in fit.places]),
        "qpos": np.stack([own.qpos for _, own in fit.places]),
        "qvel": np.stack([own.qvel for _, own in fit.places]),
        "sensor": fit.variances.sensor,
        "jitter": np.array(fit.variances.jitter),
        "force": fit.variances.force,
        "weight": np.zeros((0,)) if weight is None else weight,
        "loss": np.array(fit.loss),
    }


def fit_of(side: ForceSide, start: Point, record: Mapping[str, np.ndarray]) -> Fitted:
    """The fit of which `record_of` was made, bit for bit.

    Args:
      side: as it was.
      start: point with the same names.
      record: of the fit.
    """

    def place(numbers: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> Expansion:
        return with_numbers(start, numbers), side.stretches.about(qpos, qvel)

    first, second, third = map(place, record["numbers"], record["qpos"], record["qvel"])
    weight = record["weight"] if record["weight"].size else None
    variances = Variances(record["sensor"], float(record["jitter"]), record["force"], weight)
    uncounted = replace(side, counter=Counter())  # its steps are those of the record
    places = (first, second, third)
    parts = cache(lambda: evaluate_places(uncounted, places, variances).parts())
    return Fitted(third[0], variances, float(record["loss"]), parts, places)
