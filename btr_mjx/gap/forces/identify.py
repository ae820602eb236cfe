"""Name what a robot that touches nothing lacks: forces propose, recordings that were not fitted decide.

    diagnosis = identify_forces(dataset)

A name needs evidence beyond the price of its numbers, and predictions of held-out stretches that are better by more
than two standard errors.
"""

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, noise_of
from btr_mjx.gap.effects import (
    LAW_EFFECTS,
    OF_LOG,
    TIMING,
    TORQUE_CONSTANT,
    Candidate,
    Effect,
    Hypothesis,
    candidates,
    has_closed_loops,
    of_forces,
)
from btr_mjx.gap.forces.answer.final_numbers import last_numbers, without_invisible
from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.answer.outcome import diagnosis_of, with_tables_told
from btr_mjx.gap.forces.held_out import HeldOut, held_out, is_confirmed
from btr_mjx.gap.forces.law_scan import scan_laws
from btr_mjx.gap.forces.missing_force import missing_force
from btr_mjx.gap.forces.points import Fitted, ForceSide, Named, Point
from btr_mjx.gap.forces.predictions import horizon_errors, predicts_well, predicts_worse
from btr_mjx.gap.forces.residual import fit_residual
from btr_mjx.gap.forces.search import SearchRound, select_effects, start
from btr_mjx.gap.forces.sets.carried import Carried, carried_library, with_room
from btr_mjx.gap.forces.stretches import samples_of_interval, spread_stretches
from btr_mjx.gap.forces.unknowns import (
    BELIEVED,
    Library,
    believed_values,
    calibrated_effects,
    library_of,
)
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import PreparedData, best_span, contact_samples, prepare, scales_of, track_of

_TOUCHES = 0.01
"""Part of the samples with a contact, from which on a robot touches the world."""

_LARGE = 0.1
"""Random force of a joint, in units of the force that its actuators usually have, that is no calibration."""

_TOLD = 10.0
"""Evidence of a force of another shape from which on it is told."""

_LEFT = 0.1
"""The same where effects are named, as a part of theirs."""

_AGAIN = 2.0
"""Force that was left before and is left again, in units of what was: other motions excite it more or less."""

_BEYOND = 1.5
"""Square of what held-out recordings leave, in units of the noise, where something is left."""

_START_STEPS = 2
"""Steps of a derivative over an interval, for an estimate of the work: a derivative for each number, and ten for those
of calibration, which are fitted (`python -m btr_mjx.diagnose --demo --robot arm`)."""


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
    every = min(samples_of_interval(r.time) for r in dataset.recordings)
    span = best_span(dataset.model, [track_of(r) for r in dataset.recordings], sigma, every)
    fit, test = (prepare(side, sigma, span) for side in (dataset.fit, dataset.test))
    touching = np.concatenate([own for side in (fit, test) for own in contact_samples(side, Counter())])
    if touching.mean() > _TOUCHES:
        return None
    if not touching.any():
        fit, test = _without_contacts(fit), _without_contacts(test)
    return PreparedForces(dataset, fit, test, sigma)


def _without_contacts(data: PreparedData) -> PreparedData:
    """The same of a robot that touches nothing: a step need not look for contacts."""
    models = {id(r.model): copy.copy(r.model) for r in data.recordings}
    for model in models.values():
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return replace(data, recordings=tuple(replace(r, model=models[id(r.model)]) for r in data.recordings))


def identify_forces(
    prepared: PreparedForces,
    effects: Sequence[Effect],
    max_effects: int,
    progress: Callable[[str], None],
    counter: Counter,
    residual: bool = False,
) -> Diagnosis:
    """Find what is missing, see `search_forces`.

    Args:
      prepared: both sides of the data.
      effects: the library of effects.
      max_effects: largest number of effects that are named.
      progress: called with a word on what is being done.
      counter: adds up the simulated steps.
      residual: whether tables of what nothing explains are fitted.

    Returns:
      The diagnosis.

    Raises:
      InputError: there is no motion.
    """
    diagnosis, found = search_forces(prepared, effects, max_effects, progress, counter)
    if not residual:
        return diagnosis
    progress("residual")
    first, last = found.chain[0].point, found.chain[-1]
    # Beside the model that is written: without names, calibration is left out as well.
    beside = last.point if diagnosis.found else Point(first.base, (), np.zeros_like(first.calibration))
    return with_tables_told(diagnosis, fit_residual(found.side, found.test, beside, last.variances))


def search_forces(
    prepared: PreparedForces,
    effects: Sequence[Effect],
    max_effects: int,
    progress: Callable[[str], None],
    counter: Counter,
    known: Carried | None = None,
) -> tuple[Diagnosis, SearchOutcome]:
    """Find what is missing.

    Args:
      prepared: both sides of the data.
      effects: the library of effects.
      max_effects: largest number of effects that are named.
      progress: called with a word on what is being done.
      counter: adds up the simulated steps.
      known: what other recordings say of the robot; what is missing is then what has changed. None for nothing.

    Returns:
      The diagnosis, and what was found, of which `carried_of` is what these recordings say of the robot.

    Raises:
      InputError: there is no motion.
    """
    begun = time.monotonic()
    dataset = prepared.dataset
    progress("effects of the library")
    base = Hypothesis(dataset.parameters, tuple(p.value(dataset.model) for p in dataset.parameters))
    model = dataset.model
    if known is not None:
        base = known.base(dataset)
        model = base(model).update_constants()
    drives = dataset.reporting
    stretches, other = (spread_stretches(side, actuators=drives) for side in (prepared.fit, prepared.test))
    if not any(np.ptp(r.qpos, axis=0).max() > 0 for r in dataset.fit):
        raise InputError(f"{dataset.folder}: the robot does not move in any recording of split 'fit'")
    scales, (physical, dictionary) = scales_of(prepared.fit), of_forces(effects)
    of_log = [one for one in candidates(model, scales, [TORQUE_CONSTANT]) if one.place.actuators[0] in drives]
    possible, laws = (candidates(model, scales, own) for own in (physical, dictionary))
    interval = float(np.median(np.diff(dataset.fit[0].commands[0])))
    if known is None:
        library = library_of(possible, model, dataset.parameters, dataset.tolerances, interval, of_log)
    else:
        possible = with_room(possible, known)
        library = library_of(possible, model, dataset.parameters, dataset.tolerances, interval, of_log)
        library = carried_library(library, known)
    side, test = (ForceSide(own, library, counter) for own in (stretches, other))
    counter.expect(_START_STEPS * (len(library.numbers) + 10 * len(library.calibrated)) * stretches.time.size)
    first = start(side, base)
    # Drives that were there before do not vanish all at once.
    confirm = partial(is_confirmed, test)
    rounds, confirmed, contradicted = select_effects(
        side, first, max_effects, progress, confirm, laws, drives=known is None
    )
    progress("numbers")
    final, point, worse = _settled_names(side, test, confirmed, known is None)
    contradicted, last = contradicted or worse, final[-1]
    after = held_out(test, final[-1].point, final[-1].variances)
    before = held_out(test, final[0].point, final[0].variances, after.sensor)
    final[-1] = replace(last, point=point)
    dictionary_of = candidates(model, scales, LAW_EFFECTS)
    found = _found(side, test, rounds, final, (before, after), contradicted, known, last, dictionary_of)
    return diagnosis_of(dataset, prepared.sigma, found, time.monotonic() - begun + counter.earlier), found


def _settled_names(
    side: ForceSide, test: ForceSide, chain: Sequence[Fitted], follow: bool
) -> tuple[list[Fitted], Point, bool]:
    """The chain with its last numbers, the point of the mended model, and whether predictions cost it an effect.

    With its last numbers, a model that predicts recordings of either side worse than the believed one loses the effect
    that was found last, and is tried again.

    Args:
      side: the recordings to fit.
      test: the recordings held out.
      chain: the believed model, and one more confirmed effect each.
      follow: see `last_numbers`.
    """
    base, worse = _believed(side, chain[0]), False
    for count in range(len(chain), 1, -1):
        seen, followed = without_invisible(side, chain[count - 1]), None
        while seen.point.named and seen is not followed:
            last, point = seen, last_numbers(side, seen, follow)
            followed = replace(last, point=point)
            seen = without_invisible(side, followed)
        if not seen.point.named:
            continue
        before, after = (_as_logged(side.library, one, last) for one in (base, point.hypothesis(side.library)))
        if not any(predicts_worse(own.stretches.data, before, after, own.counter) for own in (side, test)):
            return [*chain[: count - 1], last], point, worse
        worse = True
    return [chain[0]], last_numbers(side, chain[0], follow=False), worse


def _believed(side: ForceSide, fit: Fitted) -> Hypothesis:
    """The believed model with numbers of the dataset as a fit has them, without calibration."""
    base = fit.point.base
    values = believed_values(side.library, base.parameters, fit.point.calibration, base.believed)
    return replace(base, believed=tuple(values))


def _as_logged(library: Library, make: Hypothesis, fit: Fitted) -> Hypothesis:
    """A model whose commands act when they did in the recordings of a fit: within a sample, which no model tells."""
    for candidate, values in calibrated_effects(library, fit.point.calibration):
        if candidate.effect.name == TIMING:
            make = make.with_effect(candidate, values)
    return make


def _found(
    side: ForceSide,
    test: ForceSide,
    rounds: Sequence[SearchRound],
    chain: Sequence[Fitted],
    outcomes: tuple[HeldOut, HeldOut],
    contradicted: bool,
    known: Carried | None,
    forces: Fitted,
    laws: Sequence[Candidate],
) -> SearchOutcome:
    """What was found, with the models as they will be used: calibrated, and with named effects."""
    first, last = chain[0], chain[-1]
    base, mended = (_believed(side, fit) for fit in (first, last))
    calibration = _calibration(side.library, last.point)
    for candidate, own in (*calibration, *last.point.named):
        mended = mended.with_effect(candidate, own)
    base, mended = (_as_logged(side.library, one, forces) for one in (base, mended))
    errors, steady = horizon_errors(test.stretches.data, [base, mended], side.counter)
    missing = missing_force(side.stretches, base)
    # What was left before, and is left again, has not changed.
    earlier = np.zeros_like(last.variances.force) if known is None else _AGAIN * known.random
    random = np.sqrt(np.maximum(last.variances.force - earlier, 0.0))
    share = random / np.maximum(np.sqrt((missing.actuator**2).mean((0, 1))) + random, 1e-300)
    # Names with which the model predicts well stand, whatever is left at one joint; noise is no force.
    well = predicts_well(errors[0], errors[1], steady)
    large = (share > _LARGE) & (not (well and len(chain) > 1)) & bool(np.median(outcomes[1].chi2) > _BEYOND)
    if not well and len(chain) == 1:
        calibration, mended, errors = (), base, [errors[0], errors[0]]
    leads = scan_laws(side, last, laws).leads
    law_score = max((lead.score for lead in leads), default=0.0)
    again = 0.0 if known is None else _AGAIN * known.law * last.whitened.count * len(side.stretches)
    told = max(_TOLD, _LEFT * (rounds[0].before.loss - last.loss))
    law = leads[0] if law_score - again > told else None
    return SearchOutcome(
        tuple(rounds),
        tuple(chain),
        calibration,
        outcomes,
        (errors[0], errors[1], steady),
        missing,
        large,
        base,
        mended,
        side,
        test,
        contradicted,
        law,
        forces,
        max(law_score, 0.0),
    )


def _calibration(library: Library, point: Point) -> Named:
    """Calibration of the mended model: without the timing of the log, and what is told as a refitted number."""
    return tuple(
        (candidate, values)
        for candidate, values in calibrated_effects(library, point.calibration)
        if candidate.effect.name not in OF_LOG and not candidate.effect.name.startswith(BELIEVED)
    )
