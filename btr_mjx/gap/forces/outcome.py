"""From a finished search in forces to the records of a `Diagnosis`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import Candidate, Hypothesis, ResidualTable, equation_of
from btr_mjx.gap.forces.confounds import confounds_of
from btr_mjx.gap.forces.filtering import smoothed
from btr_mjx.gap.forces.held_out import HeldOut
from btr_mjx.gap.forces.horizons import cut_horizons, position_errors
from btr_mjx.gap.forces.joint_forces import QUANTILE, joint_forces
from btr_mjx.gap.forces.law_scan import law_words
from btr_mjx.gap.forces.missing_force import MissingForce, commanded_share
from btr_mjx.gap.forces.points import Fitted, ForceSide, covariance, names
from btr_mjx.gap.forces.predictions import HORIZON, joint_errors, predictions
from btr_mjx.gap.forces.scan import Scanned
from btr_mjx.gap.forces.search import Named, SearchRound
from btr_mjx.gap.forces.sets.combined import combined
from btr_mjx.gap.forces.unknowns import believed_values
from btr_mjx.gap.results import (
    Diagnosis,
    DisagreementMap,
    Estimate,
    Gap,
    NamedEffect,
    Overlay,
    RankedCandidate,
    Refit,
    without_late_log,
)
from btr_mjx.gap.simulate import Segments, simulate
from btr_mjx.models import difference, dof_places, part_names

ALIKE = 6.0
"""Difference of scores below which two candidates are alike: a factor of twenty in odds."""

_OVERLAYS = 3
"""Stretches that are drawn."""

_SLIGHT = 1e-2
"""Part of the usual force of a joint that nobody would miss."""

_NOT_BORNE_OUT = "One more effect explained the recordings that were fitted, but not those held out."

_NO_RESIDUAL = "No table of what is left was made: held-out recordings are predicted no better with one."

_CAP = 1e4
"""Largest squared force in a map, in units of its variance."""


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What a search found.

    Attributes:
      rounds: of the search.
      chain: the believed model, and what was named, one after another, all beside calibration.
      calibration: effects with values that the mended model has beside what was named.
      held_out: what held-out recordings say of the first and the last of them.
      errors: (W, nv) mean square errors of predictions of the believed model, the mended one and constant velocity.
      missing: force that the believed model lacks.
      large: (nv,) bool: the random force that is left is no calibration.
      base: the believed model with what was refitted.
      mended: with what was named.
      side, test: of the split.
      contradicted: whether more was found than held-out recordings bear out.
      law: that a force which is left follows; None where nothing is.
      forces: the last of the chain, with numbers that do not yet follow recordings.
      law_score: of the best law that is left, told or not.
    """

    rounds: tuple[SearchRound, ...]
    chain: tuple[Fitted, ...]
    calibration: Named
    held_out: tuple[HeldOut, HeldOut]
    errors: tuple[np.ndarray, np.ndarray, np.ndarray]
    missing: MissingForce
    large: np.ndarray
    base: Hypothesis
    mended: Hypothesis
    side: ForceSide
    test: ForceSide
    contradicted: bool
    law: Scanned | None
    forces: Fitted
    law_score: float


def diagnosis_of(dataset: Dataset, sigma: np.ndarray, found: SearchOutcome, seconds: float) -> Diagnosis:
    """The records of a diagnosis.

    Args:
      dataset: the data.
      sigma: (2 nv,) noise of the sensors.
      found: by the search.
      seconds: that it took.
    """
    first, last = found.chain[0], found.chain[-1]
    named = _named(found)
    verdict = "unexplained" if found.large.any() or found.law is not None else "effect" if named else "none"
    ranking = _ranking(found.rounds)
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
        equivalent=_alike(_round_of(found, last.point.named[0][0].name)) if named else (),
        gap=Gap(before, after, min(floor, after), floor, float(np.sqrt(before)), float(np.sqrt(after)), *loops),
        disagreement=_map(model, found),
        unexplained=_words(model, found) if verdict == "unexplained" else (),
        believed=_refits(dataset, found),
        confounds=confounds_of(found.side, last) if verdict == "effect" else (),
        overlays=_overlays(model, found),
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
        notes=(_NOT_BORNE_OUT,) if found.contradicted else (),
        joint_forces=joint_forces(found.side, first, last if verdict == "effect" else first),
    )
    told = without_late_log(diagnosis)  # of any verdict
    if told.verdict != "unexplained":
        return told
    return replace(told, effects=(), calibration=_entries(combined(first.point.base.effects, ())))


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


def _named(found: SearchOutcome) -> tuple[NamedEffect, ...]:
    """Named effects with intervals."""
    last = found.chain[-1]
    spread = np.sqrt(np.diag(covariance(found.side, last)))
    scores = [a.loss - b.loss for a, b in zip(found.chain[:-1], found.chain[1:], strict=True)]
    held = float((found.held_out[0].loss - found.held_out[1].loss).sum())
    out, i = [], 0
    for k, (candidate, values) in enumerate(last.point.named):
        parameters = {}
        for own, value in zip(candidate.parameters, values, strict=True):
            half = QUANTILE * spread[i]
            low, high = (float(np.clip(value + s * half, own.low, own.high)) for s in (-1, 1))
            parameters[own.name] = Estimate(value, low, high, own.unit, float(own.null), own.at_edge(value))
            i += 1
        score = scores[min(k, len(scores) - 1)] if scores else 0.0
        rivals = _alike(_round_of(found, candidate.name))
        own_names = names(last.point.named)
        out.append(
            NamedEffect(
                candidate.effect.name,
                candidate.place.label,
                parameters,
                float(score),
                held,
                tuple(name for name in rivals if name not in own_names) if candidate.name in rivals else (),
                candidate.effect.excited_by,
                equation_of(candidate, values),
                equation_of(candidate, values, latex=True),
            )
        )
    return tuple(out)


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
    return _entries(combined(before, own) if before else own)


def _entries(effects: Sequence[tuple[Candidate, tuple[float, ...]]]) -> tuple[NamedEffect, ...]:
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


def _round_of(found: SearchOutcome, name: str) -> SearchRound:
    """The round in which an effect was chosen."""
    for of in found.rounds:
        if of.finalists and name in names(of.finalists[0][1].point.named) and name not in names(of.before.point.named):
            return of
    return found.rounds[0]


def _alike(of: SearchRound) -> tuple[str, ...]:
    """Names of finalists that the data cannot tell from the best one, which comes first.

    What every drive has is tried as several effects together: none of them alone is an alternative.
    """
    if not of.finalists:
        return ()
    best = of.finalists[0][0]
    given = set(names(of.before.point.named))
    out: list[str] = []
    for score, fit in of.finalists:
        if score > 0 and best - score <= ALIKE:
            new = [name for name in names(fit.point.named) if name not in given]
            out += new if len(new) == 1 else []
    return tuple(dict.fromkeys(out))


def _ranking(rounds: Sequence[SearchRound]) -> tuple[RankedCandidate, ...]:
    """Rows of all rounds: refined candidates, then those that were scanned only."""
    rows = []
    for of in rounds:
        given = names(of.before.point.named)
        seen: set[str] = set()
        scored = []
        for score, fit in of.finalists:
            new = [(c, v) for c, v in fit.point.named if c.name not in given]
            if len(new) == 1:
                scored.append((score, *new[0]))
            else:
                scored += [(score, c, v) for c, v in new]
        scored += [(lead.score, lead.candidate, lead.values) for lead in of.leads]
        best = max((row[0] for row in scored), default=0.0)
        for score, candidate, values in scored:
            if candidate.name in seen:
                continue
            seen.add(candidate.name)
            rows.append(
                RankedCandidate(
                    candidate.effect.name,
                    candidate.place.label,
                    float(score),
                    float(best - score),
                    float(score),
                    float("nan"),
                    {p.name: float(v) for p, v in zip(candidate.parameters, values, strict=True)},
                    tuple(given),
                )
            )
    return tuple(rows)


def _open_loop(found: SearchOutcome) -> tuple[float, float]:
    """Mean absolute position error over whole held-out recordings [rad or m], believed and mended."""
    trial = cut_horizons(found.test.stretches.data, np.inf)
    errors = position_errors(trial, [found.base, found.mended], found.test.counter)
    before, after = (float(np.mean([np.abs(own).mean() for own in row])) for row in errors)
    return before, after


def _places(model: mujoco.MjModel) -> list[str]:
    """(nv,) the place of every degree of freedom."""
    joints, bodies = part_names(model, "joint"), part_names(model, "body")
    free = mujoco.mjtJoint.mjJNT_FREE
    return [
        f"body:{bodies[model.jnt_bodyid[j]]}" if model.jnt_type[j] == free else f"joint:{joints[j]}"
        for j in model.dof_jntid
    ]


def _map(model: mujoco.MjModel, found: SearchOutcome) -> DisagreementMap:
    """Mean square of the missing force by joint and regime, in units of the random force that is left."""
    missing, first = found.missing, found.chain[0]
    force = smoothed(first.linear, np.zeros_like(first.linear.defect), first.variances).force
    usual = (missing.actuator**2).mean((0, 1)) + (missing.force**2).mean((0, 1))
    floor = np.maximum(found.chain[-1].variances.force, _SLIGHT**2 * usual + 1e-300)
    square = np.minimum(force**2 / floor, _CAP)
    speed, load = np.abs(missing.velocity), np.abs(missing.actuator)
    middle = np.array([r.time.mean() for r in found.side.stretches.data.recordings])
    late = found.side.stretches.time[:, :-1] > middle[found.side.stretches.recording][:, None]
    late = np.broadcast_to(late[..., None], square.shape)
    masks = {
        "all": np.ones(square.shape, bool),
        "slow": speed <= np.median(speed, (0, 1)),
        "fast": speed > np.median(speed, (0, 1)),
        "low load": load <= np.median(load, (0, 1)),
        "high load": load > np.median(load, (0, 1)),
        "contact": np.zeros(square.shape, bool),
        "air": np.ones(square.shape, bool),
        "early": ~late,
        "late": late,
    }
    every = _places(model)
    places = tuple(dict.fromkeys(every))
    value, count = np.full((len(places), len(masks)), np.nan), np.zeros((len(places), len(masks)), int)
    for i, place in enumerate(places):
        own = np.array([name == place for name in every])
        for j, mask in enumerate(masks.values()):
            chosen = mask[..., own]
            count[i, j] = int(chosen.sum())
            if count[i, j]:
                value[i, j] = float(square[..., own][chosen].mean())
    return DisagreementMap(places, tuple(masks), value, count)


def _words(model: mujoco.MjModel, found: SearchOutcome) -> tuple[str, ...]:
    """What is unexplained, in words."""
    law = (law_words(model, found.law),) if found.law is not None else ()
    left = np.sqrt(found.chain[-1].variances.force)
    usual = np.sqrt((found.missing.actuator**2).mean((0, 1)))
    commanded = commanded_share(found.missing, float(np.median(np.diff(found.side.stretches.time, axis=1))))
    places = dof_places(model)
    worst = np.argsort(-left / np.maximum(usual, 1e-300))
    return (
        *law,
        *(
            f"{places[j][0]}: a force of {left[j]:.3g} {places[j][1]} (root mean square) beside {usual[j]:.3g} of its "
            f"actuators, whose commands predict {100 * commanded[j]:.0f} % of the force that its motion needs"
            for j in worst
            if found.large[j]
        ),
    )[:3]


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


def _overlays(model: mujoco.MjModel, found: SearchOutcome) -> tuple[Overlay, ...]:
    """Held-out stretches in which believed and mended model differ most, over a few horizons."""
    stretches = found.test.stretches
    plain = np.flatnonzero(model.jnt_type[model.dof_jntid] >= 2)
    if not len(plain):
        return ()
    interval = float(np.median(np.diff(stretches.time, axis=1)))
    count = int(np.clip(round(4 * HORIZON / interval), 1, stretches.intervals))
    names_of, out = _places(model), []
    tries = []
    for s in range(len(stretches)):
        recording = stretches.data.recordings[stretches.recording[s]]
        segments = Segments(
            stretches.time[s, :1],
            stretches.qpos[s, :1],
            stretches.qvel[s, :1],
            (stretches.time[s, : count + 1] - stretches.time[s, 0])[None],
            stretches.data.commands,
            stretches.recording[s : s + 1],
            stretches.act[s, :1] if model.na else None,
        )
        jobs = [(make(recording.model), segments) for make in (found.base, found.mended)]
        before, after = (states[0] for states in simulate(jobs, threads=1, counter=found.test.counter))
        away = np.nan_to_num(difference(model, before[:, : model.nq], after[:, : model.nq]) ** 2, nan=0.0)
        far = away.mean(0)[plain] / np.maximum(found.side.stretches.sigma[plain], 1e-12) ** 2
        if not np.isfinite(before).all() or not np.isfinite(after).all():
            continue
        tries.append((float(far.max()), s, int(plain[np.argmax(far)]), before, after))
    for _, s, dof, before, after in sorted(tries, key=lambda row: -row[0])[:_OVERLAYS]:
        address = int(model.jnt_qposadr[model.dof_jntid[dof]])
        recording = stretches.data.recordings[stretches.recording[s]]
        out.append(
            Overlay(
                recording.name,
                names_of[dof],
                stretches.time[s, : count + 1],
                stretches.measured_q[s, : count + 1, address],
                before[:, address],
                after[:, address],
            )
        )
    return tuple(out)


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
