"""Name what a robot that touches nothing lacks: forces propose, recordings that were not fitted decide.

    diagnosis = identify_forces(dataset)

A name needs evidence beyond the price of its numbers, and predictions of held-out stretches that are better by more
than two standard errors.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, noise_of
from btr_mjx.gap.effects import Effect, Hypothesis, candidates, has_closed_loops, with_motors
from btr_mjx.gap.forces.held_out import HeldOut, held_out, is_better
from btr_mjx.gap.forces.horizons import follow_horizons
from btr_mjx.gap.forces.intervals import covariance
from btr_mjx.gap.forces.missing_force import missing_force
from btr_mjx.gap.forces.motion import responses
from btr_mjx.gap.forces.outcome import SearchOutcome, diagnosis_of
from btr_mjx.gap.forces.points import ROUNDS, Fitted, ForceSide, evaluate_point, settled
from btr_mjx.gap.forces.predictions import compared_predictions, horizon_errors, predicts_well
from btr_mjx.gap.forces.search import Named, SearchRound, select_effects, start
from btr_mjx.gap.forces.shapes import best_shape
from btr_mjx.gap.forces.stretches import Stretches, spread_stretches
from btr_mjx.gap.forces.unknowns import BELIEVED, TIMING, Library, believed_values, library_of
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import PreparedData, best_span, contact_samples, prepare, scales_of, track_of

_TOUCHES = 0.01
"""Part of the samples with a contact, from which on a robot touches the world."""

_LARGE = 0.1
"""Random force of a joint, in units of the force that its actuators usually have, that is no calibration."""

_BEFORE = 3
"""Rounds of the believed model's refit: it is compared with, not used."""

_SEEN = 0.3
"""Smallest number that is named, in units of the step at which its effect is clearly visible."""

_NONE = 1e-6
"""Tolerances that leave no calibration."""

_TOLD = 10.0
"""Evidence of a force of another shape from which on it is told."""

_LEFT = 0.1
"""The same where effects are named, as a part of theirs."""

_BEYOND = 1.5
"""Square of what held-out recordings leave, in units of the noise, where something is left."""


@dataclass(frozen=True, eq=False)
class PreparedForces:
    """Both sides of a dataset, ready for a search.

    Attributes:
      dataset: the data.
      fit, test: recordings to fit and held out.
      sigma: (2 nv,) noise of the sensors.
    """

    dataset: Dataset
    fit: PreparedData
    test: PreparedData
    sigma: np.ndarray


def prepare_forces(dataset: Dataset) -> PreparedForces | None:
    """Prepare a dataset, if its robot touches nothing.

    Args:
      dataset: recordings on both sides of the split, and the believed model.

    Returns:
      Both sides; None where the robot touches the world, has closed loops, or joints that were not measured.

    Raises:
      InputError: no recordings on one side of the split.
    """
    for name, side in (("fit", dataset.fit), ("test", dataset.test)):
        if not side:
            raise InputError(f"{dataset.folder}: no recording is in split {name!r}")
    if has_closed_loops(dataset.model) or not all(r.seen.all() for r in dataset.recordings):
        return None
    noise = noise_of(dataset)
    sigma = np.concatenate([noise.qpos, noise.qvel])
    span = best_span(dataset.model, [track_of(r) for r in dataset.recordings], sigma)
    fit, test = (prepare(side, dataset.interpolation, sigma, span) for side in (dataset.fit, dataset.test))
    touching = np.concatenate([own for side in (fit, test) for own in contact_samples(side, Counter())])
    return None if touching.mean() > _TOUCHES else PreparedForces(dataset, fit, test, sigma)


def identify_forces(
    prepared: PreparedForces,
    effects: Sequence[Effect],
    max_effects: int,
    progress: Callable[[str], None],
    counter: Counter,
) -> Diagnosis:
    """Find what is missing.

    Args:
      prepared: both sides of the data.
      effects: the library of effects.
      max_effects: largest number of effects that are named.
      progress: called with a word on what is being done.
      counter: adds up the simulated steps.

    Returns:
      The diagnosis.

    Raises:
      InputError: there is no motion.
    """
    begun = time.monotonic()
    dataset = prepared.dataset
    progress("effects of the library")
    base = Hypothesis(dataset.parameters, tuple(p.value(dataset.model) for p in dataset.parameters))
    stretches, other = spread_stretches(prepared.fit), spread_stretches(prepared.test)
    if not any(np.ptp(r.qpos, axis=0).max() > 0 for r in dataset.fit):
        raise InputError(f"{dataset.folder}: the robot does not move in any recording of split 'fit'")
    possible = candidates(dataset.model, scales_of(prepared.fit), with_motors(effects))
    interval = float(np.median(np.diff(dataset.fit[0].commands[0])))
    library = library_of(possible, dataset.model, dataset.parameters, dataset.tolerances, interval)
    test = ForceSide(other, library, np.zeros((0,)), counter)
    side, first = start(
        ForceSide(stretches, library, _of_calibration(stretches, library, base, counter), counter), base
    )
    rounds, chain = select_effects(side, first, max_effects, progress)
    progress("held-out recordings")
    confirmed = _confirmed(test, chain)
    progress("numbers")
    marginal = confirmed[-1]
    ends = [_refitted(side, confirmed[0], _BEFORE), _refitted(side, marginal)]
    if seen := _visible(ends[1].point.named):
        if len(seen) < len(ends[1].point.named):
            marginal, ends[1] = (
                settled(side, replace(marginal.point, named=seen), marginal.variances, about=marginal.linear.stretches),
                _refitted(side, replace(ends[1], point=replace(ends[1].point, named=seen))),
            )
    else:
        confirmed, ends[1] = confirmed[:1], ends[0]
    if ends[1].point.named:
        spread = covariance(side, marginal)
        point = follow_horizons(side, ends[1].point, spread, side.library)
        ends[1] = evaluate_point(
            side, point, replace(ends[1].variances, weight=None), stretches=ends[1].linear.stretches
        )
    # Calibration counts here, as in windows: what is missing is what it cannot explain.
    both = confirmed[0], marginal if len(confirmed) > 1 else confirmed[0]
    outcomes = (held_out(test, both[0].point, both[0].variances), held_out(test, both[1].point, both[1].variances))
    final = [ends[0], *confirmed[1:-1], *ends[1:]] if len(confirmed) > 1 else [ends[0]]
    found = _found(side, test, rounds, final, outcomes, len(confirmed) < len(chain), dataset, marginal)
    return diagnosis_of(dataset, prepared.sigma, found, time.monotonic() - begun + counter.earlier)


def _of_calibration(stretches: Stretches, library: Library, base: Hypothesis, counter: Counter) -> np.ndarray:
    """(S, K, 2 nv, C) columns, of calibration alone."""
    used = sorted({column for entry in library.calibrated for own in entry.columns for column in own})
    nv = stretches.qvel.shape[-1]
    columns = np.zeros((len(stretches), stretches.intervals, 2 * nv, len(library.numbers)))
    columns[..., used] = responses(stretches, base, [library.numbers[column] for column in used], counter)
    return columns


def _confirmed(test: ForceSide, chain: Sequence[Fitted]) -> list[Fitted]:
    """The chain up to the last hypothesis that held-out recordings bear out, one after another.

    Predictions over a horizon decide where they can tell. Where noise hides the difference the likelihood decides,
    which sees more, but believes in its variances.
    """
    makes = [fit.point.hypothesis(test.library) for fit in chain]
    better = compared_predictions(test.stretches.data, makes, test.counter)
    out, before = [chain[0]], held_out(test, chain[0].point, chain[0].variances)
    for i, fit in enumerate(chain[1:]):
        own = held_out(test, fit.point, fit.variances)
        told = better[i, i + 1]
        if not (told > 0 if told else is_better(before, own)):
            break
        before = own
        out.append(fit)
    return out


def _known(side: ForceSide, named: Named) -> np.ndarray:
    """(n,) bool: calibration that the mended model is without."""
    names = [entry.candidate.effect.name for entry in side.library.calibrated]
    # When commands act within a sample stays unknown, unless a delay is what was named.
    unknown = {TIMING} - {candidate.effect.name for candidate, _ in named}
    return np.array([not name.startswith(BELIEVED) and name not in unknown for name in names], bool)


def _refitted(side: ForceSide, fit: Fitted, rounds: int = ROUNDS) -> Fitted:
    """A fit without calibration of the model.

    What is named has to hold beside calibration; its numbers are those with which the mended model, which knows none,
    predicts best. When a command acts within its sample belongs to the log, not to the model, and stays unknown.
    """
    own, known = side.library.calibration, _known(side, fit.point.named)
    factor = np.where(known, _NONE, 1.0)
    library = replace(
        side.library, calibration=replace(own, tolerance=own.tolerance * factor, reach=own.reach * factor)
    )
    start = replace(fit.point, calibration=np.where(known, 0.0, fit.point.calibration))
    variances = replace(fit.variances, weight=None)
    return settled(replace(side, library=library), start, variances, rounds, fit.linear.stretches)


def _visible(named: Named) -> Named:
    """Effects with a number that is visible: of the size of its step, and no smaller than what is never named."""
    out = []
    for candidate, values in named:
        pairs = zip(candidate.parameters, values, strict=True)
        if any(abs(v - p.null) > max(_SEEN * abs(p.step), p.negligible) for p, v in pairs if not p.shape):
            out.append((candidate, values))
    return tuple(out)


def _found(
    side: ForceSide,
    test: ForceSide,
    rounds: Sequence[SearchRound],
    chain: Sequence[Fitted],
    outcomes: tuple[HeldOut, HeldOut],
    contradicted: bool,
    dataset: Dataset,
    marginal: Fitted,
) -> SearchOutcome:
    """What was found, with the models as they will be used: named effects, and no calibration."""
    first, last = chain[0], chain[-1]
    before = [p.value(dataset.model) for p in dataset.parameters]
    values = [
        tuple(believed_values(side.library, dataset.parameters, fit.point.calibration, before)) for fit in (first, last)
    ]
    base = replace(first.point.base, believed=values[0])
    mended = replace(last.point.base, believed=values[1])
    for candidate, own in last.point.named:
        mended = mended.with_effect(candidate, own)
    errors, steady = horizon_errors(test.stretches.data, [base, mended], side.counter)
    missing = missing_force(side.stretches, base)
    random = np.sqrt(last.variances.force)
    share = random / np.maximum(np.sqrt((missing.actuator**2).mean((0, 1))) + random, 1e-300)
    # Names with which the model predicts well stand, whatever is left at one joint; noise is no force.
    stands = len(chain) > 1 and predicts_well(errors[0], errors[1], steady)
    large = (share > _LARGE) & (not stands) & bool(np.median(outcomes[1].chi2) > _BEYOND)
    shape = best_shape(side, marginal, missing)
    gained = rounds[0].before.loss - marginal.loss
    if shape.score < max(_TOLD, _LEFT * gained):
        shape = replace(shape, score=0.0)
    return SearchOutcome(
        tuple(rounds),
        tuple(chain),
        outcomes,
        (errors[0], errors[1], steady),
        missing,
        large,
        base,
        mended,
        side,
        test,
        contradicted,
        marginal,
        shape,
    )


def bears_out(prepared: PreparedForces, mended: Hypothesis) -> bool:
    """Whether a mended model predicts held-out recordings better than the believed one and constant velocity.

    Args:
      prepared: both sides of the data.
      mended: the model.
    """
    dataset = prepared.dataset
    base = Hypothesis(dataset.parameters, tuple(p.value(dataset.model) for p in dataset.parameters))
    errors, steady = horizon_errors(prepared.test, [base, mended])
    return predicts_well(errors[0], errors[1], steady)
