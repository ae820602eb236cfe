"""From a finished search in forces to the records of a `Diagnosis`."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import TORQUE_CONSTANT, Hypothesis, ResidualTable
from btr_mjx.gap.forces.answer.force_confounds import confounds_of
from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.answer.joint_forces import joint_forces
from btr_mjx.gap.forces.answer.named import ALIKE, alternatives_of, named_by_forces, ranking_by_forces, round_of
from btr_mjx.gap.forces.answer.regimes import map_of_forces, unexplained_words
from btr_mjx.gap.forces.answer.shown import forces_overlays
from btr_mjx.gap.forces.horizons import cut_horizons, position_errors
from btr_mjx.gap.forces.predictions import joint_errors, noise_errors, predicts_better, step_errors
from btr_mjx.gap.forces.sets.combined import combined
from btr_mjx.gap.forces.unknowns import believed_values
from btr_mjx.gap.results import (
    Chi2,
    Diagnosis,
    Estimate,
    JointError,
    NamedEffect,
    OpenLoop,
    Refit,
    misfit_of,
    verdict_of,
    without_late_log,
)

_NOT_BORNE_OUT = "One more effect explained the recordings that were fitted, but predictions do not bear it out."

_NO_RESIDUAL = "No table of what is left was made: held-out recordings are predicted no better with one."


def diagnosis_of(dataset: Dataset, sigma: np.ndarray, found: SearchOutcome, seconds: float) -> Diagnosis:
    """The records of a diagnosis.

    Args:
      dataset: the data.
      sigma: (2 nv,) noise of the sensors.
      found: by the search.
      seconds: that it took.
    """
    model, named = dataset.model, named_by_forces(found)
    is_left = bool(found.large.any()) or found.law is not None
    errors, chi2 = _errors(model, found), _chi2(found)
    verdict = verdict_of(bool(named), is_left, misfit_of(errors), chi2)
    if verdict == "unexplained" and not predicts_better(*found.errors):
        # Beside the believed model: what was found follows held-out recordings no better, and is no model of the robot.
        named, found = (), replace(found, calibration=(), mended=found.base, errors=_unchanged(found.errors))
        errors = _errors(model, found)
    first, last = found.chain[0], found.chain[-1]
    shown = last if named else first
    loops = _open_loop(found)
    disagreement = map_of_forces(model, found, shown)
    diagnosis = Diagnosis(
        found=named,
        ranking=ranking_by_forces(found.rounds),
        unexplained=unexplained_words(model, found, disagreement) if is_left else (),
        joint_errors=errors,
        open_loop=loops,
        chi2=chi2,
        calibration=_calibration(found),
        equivalent=alternatives_of(round_of(found, last.point.named[0][0].name)) if verdict == "effect" else (),
        disagreement=disagreement,
        believed=_refits(dataset, found),
        confounds=confounds_of(found.side, last) if verdict == "effect" else (),
        overlays=forces_overlays(model, found),
        share=1 - float(last.variances.force.sum() / max(first.variances.force.sum(), 1e-300)),
        lack_of_fit=(found.held_out[0].lack, found.held_out[1].lack),
        sigma=sigma,
        windows=(
            len(found.side.stretches),
            len(found.test.stretches),
            found.side.stretches.intervals,
            float(np.ptp(found.side.stretches.time[0])),
        ),
        survivors=_survivors(found),
        notes=(*([_NOT_BORNE_OUT] if found.contradicted else []), *_of_drives(found)),
        joint_forces=joint_forces(found.side, first, shown),
        steps=found.side.counter.steps,
        seconds=seconds,
    )
    return without_late_log(diagnosis)


def _errors(model: mujoco.MjModel, found: SearchOutcome) -> tuple[JointError, ...]:
    """Errors of predictions by joint, of the believed model and, where there is one, of the mended one."""
    before, after, steady = found.errors
    about = found.test.stretches.data, found.mended, found.side.counter
    floor = noise_errors(*about), step_errors(*about)
    return joint_errors(model, before, None if found.mended is found.base else after, floor, steady)


def _chi2(found: SearchOutcome) -> Chi2:
    """chi^2 of held-out recordings; of a few stretches any mean is large: somebody pushes, time stamps jump."""
    sensor, sigma = found.chain[-1].variances.sensor, found.side.stretches.sigma
    # In units of the noise of the dataset, whatever was estimated beside it.
    floor = float(np.mean((sensor / sigma**2)[found.side.stretches.seen]))
    before, after = (floor * float(np.median(own.chi2)) for own in found.held_out)
    return Chi2(before, after, floor)


def _unchanged(errors: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors where the mended model is the believed one."""
    before, _, steady = errors
    return before, before, steady


def with_tables_told(diagnosis: Diagnosis, tables: Sequence[ResidualTable]) -> Diagnosis:
    """A diagnosis with tables of what nothing explains.

    Args:
      diagnosis: without them.
      tables: of joints; nothing where there are none.
    """
    note = _NO_RESIDUAL
    if tables:
        joints = ", ".join(table.joint for table in tables)
        note = f"The force that nothing explains is a table in mended.json, within the recorded range only: {joints}."
    return replace(diagnosis, residual=tuple(tables), notes=(*diagnosis.notes, note))


def _of_drives(found: SearchOutcome) -> list[str]:
    """What was found of torque constants, which belong to the log: those that are off by more than half a tolerance."""
    prior, values = found.side.library.calibration, found.forces.point.calibration
    off = [
        f"{entry.candidate.place.label.partition(':')[2]} {1 + value:.3g}"
        for entry, value, sigma in zip(found.side.library.calibrated, values, prior.tolerance, strict=True)
        if entry.candidate.effect is TORQUE_CONSTANT and abs(value) > sigma / 2
    ]
    return [f"Drives report another force than they have, by these factors: {', '.join(off)}."] if off else []


def _calibration(found: SearchOutcome) -> tuple[NamedEffect, ...]:
    """Calibration of the mended model, without intervals: most of it is known beforehand.

    First what was known of the robot before, with the values that it has now, then the largest.
    """
    library, size = found.side.library, dict[str, float]()
    values = found.chain[-1].point.calibration
    for entry, value, tolerance in zip(library.calibrated, values, library.calibration.tolerance, strict=True):
        name = entry.candidate.name
        size[name] = max(size.get(name, 0.0), float(abs(value) / tolerance))
    own = sorted(found.calibration, key=lambda row: -size[row[0].name])
    before = found.chain[0].point.base.effects
    every = combined(before, own) if before else own
    return tuple(
        NamedEffect(
            candidate.effect.name,
            candidate.place.label,
            {
                number.name: Estimate(value, None, None, number.unit, float(number.null))
                for number, value in zip(candidate.parameters, values, strict=True)
            },
            equation=candidate.effect.equation,
            tolerances=size.get(candidate.name),
        )
        for candidate, values in every
    )


def _refits(dataset: Dataset, found: SearchOutcome) -> tuple[Refit, ...]:
    """Where the believed numbers went, without and with what was named."""
    library = found.side.library
    before = [p.value(dataset.model) for p in dataset.parameters]
    first, last = (
        believed_values(library, dataset.parameters, fit.point.calibration, fit.point.base.believed)
        for fit in (found.chain[0], found.chain[-1])
    )
    return tuple(
        Refit(p.name, float(a), float(b), float(c))
        for p, a, b, c in zip(dataset.parameters, before, first, last, strict=True)
    )


def _open_loop(found: SearchOutcome) -> OpenLoop:
    """Mean absolute position error over whole held-out recordings, believed and mended."""
    trial = cut_horizons(found.test.stretches.data, np.inf)
    makes = [found.base] if found.mended is found.base else [found.base, found.mended]
    errors = position_errors(trial, makes, found.test.counter)
    return OpenLoop(*(float(np.mean([np.abs(own).mean() for own in row])) for row in errors))


def _survivors(found: SearchOutcome) -> tuple[Hypothesis, ...]:
    """Hypotheses that are still possible: those near the best, and nothing where no name was found."""
    if not found.rounds or not found.rounds[0].finalists:
        return (found.base,)
    best = found.rounds[0].finalists[0][0]
    close = [
        replace(fit.point, calibration=np.zeros_like(fit.point.calibration)).hypothesis(found.side.library)
        for score, fit in found.rounds[0].finalists
        if best - score <= 2 * ALIKE and len(fit.point.named) == 1
    ]
    if len(found.chain) > 1:
        return tuple(close) or (found.mended,)
    return (found.base, *close[:2])
