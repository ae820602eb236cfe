"""From a finished search in forces to the records of a `Diagnosis`."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import TORQUE_CONSTANT, Candidate, Hypothesis, ResidualTable
from btr_mjx.gap.forces.answer.force_confounds import confounds_of
from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.answer.joint_forces import joint_forces
from btr_mjx.gap.forces.answer.named import ALIKE, alternatives_of, named_by_forces, ranking_by_forces, round_of
from btr_mjx.gap.forces.answer.regimes import map_of_forces, unexplained_words
from btr_mjx.gap.forces.answer.shown import forces_overlays
from btr_mjx.gap.forces.horizons import cut_horizons, position_errors
from btr_mjx.gap.forces.predictions import joint_errors, predictions
from btr_mjx.gap.forces.sets.combined import combined
from btr_mjx.gap.forces.unknowns import believed_values
from btr_mjx.gap.results import (
    Diagnosis,
    Estimate,
    Gap,
    NamedEffect,
    Refit,
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
    first, last = found.chain[0], found.chain[-1]
    named = named_by_forces(found)
    verdict = "unexplained" if found.large.any() or found.law is not None else "effect" if named else "none"
    ranking = ranking_by_forces(found.rounds)
    seen = found.side.stretches.seen
    # In units of the noise of the dataset, whatever was estimated beside it.
    floor = float(np.mean((last.variances.sensor / found.side.stretches.sigma**2)[seen]))
    # Somebody pushes, time stamps jump: of a few stretches any mean is large.
    before, after = (floor * float(np.median(own.chi2)) for own in found.held_out)
    loops = _open_loop(found)
    model = dataset.model
    diagnosis = Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        effects=named,
        calibration=_calibration(found),
        ranking=ranking,
        equivalent=alternatives_of(round_of(found, last.point.named[0][0].name)) if named else (),
        gap=Gap(before, after, min(floor, after), floor, float(np.sqrt(before)), float(np.sqrt(after)), *loops),
        disagreement=map_of_forces(model, found),
        unexplained=unexplained_words(model, found) if verdict == "unexplained" else (),
        believed=_refits(dataset, found),
        confounds=confounds_of(found.side, last) if verdict == "effect" else (),
        overlays=forces_overlays(model, found),
        share=1 - float(last.variances.force.sum() / max(first.variances.force.sum(), 1e-300)),
        lack_of_fit=(found.held_out[0].lack, found.held_out[1].lack),
        threshold=0.0,
        dispersion=1.0,
        sigma=sigma,
        windows=(
            len(found.side.stretches),
            len(found.test.stretches),
            found.side.stretches.intervals,
            float(np.ptp(found.side.stretches.time[0])),
        ),
        steps=found.side.counter.steps,
        seconds=seconds,
        survivors=_survivors(found),
        predictions=predictions(found.errors[:2], found.errors[2]),
        joint_errors=joint_errors(model, found.errors[:2], sigma),
        notes=(*([_NOT_BORNE_OUT] if found.contradicted else []), *_of_drives(found)),
        joint_forces=joint_forces(found.side, first, last if verdict == "effect" else first),
    )
    told = without_late_log(diagnosis)  # of any verdict
    if told.verdict != "unexplained":
        return told
    return replace(told, effects=(), calibration=without_intervals(combined(first.point.base.effects, ())))


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
    size = {
        entry.candidate.name: abs(value) / tolerance
        for entry, value, tolerance in zip(
            found.side.library.calibrated,
            found.chain[-1].point.calibration,
            found.side.library.calibration.tolerance,
            strict=True,
        )
    }
    own = sorted(found.calibration, key=lambda row: -size[row[0].name])
    before = found.chain[0].point.base.effects
    return without_intervals(combined(before, own) if before else own)


def without_intervals(effects: Sequence[tuple[Candidate, tuple[float, ...]]]) -> tuple[NamedEffect, ...]:
    """Effects without intervals."""
    return tuple(
        NamedEffect(
            candidate.effect.name,
            candidate.place.label,
            {
                own.name: Estimate(value, value, value, own.unit, float(own.null))
                for own, value in zip(candidate.parameters, values, strict=True)
            },
            0.0,
            0.0,
            equation=candidate.effect.equation,
        )
        for candidate, values in effects
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


def _open_loop(found: SearchOutcome) -> tuple[float, float]:
    """Mean absolute position error over whole held-out recordings [rad or m], believed and mended."""
    trial = cut_horizons(found.test.stretches.data, np.inf)
    errors = position_errors(trial, [found.base, found.mended], found.test.counter)
    before, after = (float(np.mean([np.abs(own).mean() for own in row])) for row in errors)
    return before, after


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
