"""Columns of a search: one for every number that an effect of the library may have at a single place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import (
    TIME_IN_SAMPLE,
    TIMING,
    WORLD,
    Candidate,
    Effect,
    Parameter,
    Place,
    believed_steps,
    field_tolerance,
)
from btr_mjx.gap.forces.evidence import CalibrationPrior
from btr_mjx.gap.forces.motion import FreeNumber
from btr_mjx.gap.simulate import World
from btr_mjx.models import PathParameter

LIMIT_SIZES = (0.15, 0.35, 0.6, 0.8, 0.92)
"""Where a limit is tried, as parts of the way from where it does nothing to its tightest."""

_LARGER = (4.0, 16.0)
"""Further steps at which what is not linear is tried, in units of its own step: friction holds a joint that a small
part of it would let go."""

_NEAR = (0.5, 2.0)
"""Between which parts of a step its column serves, where an effect is not linear."""

BELIEVED = "believed "
"""Beginning of the name of a number that may be refitted, among calibration."""

DRIVE = ("dry_friction", "viscous_damping", "armature", "offset_torque")
"""What every drive has, and models leave out together."""

_UNKNOWN = 0.03
"""Tolerance of these where nothing is believed, in units of a visible step: no joint is without friction."""

MOST_CALIBRATED = 4.0
"""Largest number of calibration, in tolerances."""

_WITHIN = 0.75
"""Largest time within a sample at which a command acts, in intervals of commands: half of one, and jitter of stamps."""


@dataclass(frozen=True)
class CandidateColumns:
    """A candidate as a scan sees it: numbers that are sums of columns.

    Attributes:
      candidate: the candidate.
      columns: per number the columns that are added up.
      near: per number, the bounds of changes between which these columns serve.
    """

    candidate: Candidate
    columns: tuple[tuple[int, ...], ...]
    near: tuple[tuple[float, float], ...]

    def design(self, count: int) -> np.ndarray:
        """(C, p) of `evidence.least_squares`."""
        out = np.zeros((count, len(self.columns)))
        for i, own in enumerate(self.columns):
            out[list(own), i] = 1.0
        return out


@dataclass(frozen=True, eq=False)
class Library:
    """All columns.

    Attributes:
      numbers: one per column.
      entries: the candidates.
      calibrated: candidates that are calibration, one number each.
      calibration: their columns and tolerances.
    """

    numbers: tuple[FreeNumber, ...]
    entries: tuple[CandidateColumns, ...]
    calibrated: tuple[CandidateColumns, ...]
    calibration: CalibrationPrior


def library_of(
    candidates: Sequence[Candidate],
    model: mujoco.MjModel,
    believed: Sequence[PathParameter],
    tolerances: Mapping[str, float],
    interval: float,
    of_log: Sequence[Candidate] = (),
) -> Library:
    """Columns of candidates.

    Args:
      candidates: every effect at every place.
      model: the believed model.
      believed: numbers of the model that may be refitted; they are calibration with wide tolerances.
      tolerances: 1 sigma of calibration by effect, as the dataset has them.
      interval: between samples of commands [s].
      of_log: what belongs to the log and is calibration alone.
    """
    numbers: list[FreeNumber] = []
    entries: list[CandidateColumns] = []
    single: dict[str, list[tuple[int, tuple[float, float]]]] = {}
    calibrated: list[tuple[CandidateColumns, float, float]] = []
    for candidate in candidates:
        if candidate.effect.summable and candidate.place.members:
            entries += _group(candidate, [single[f"{candidate.effect.name}@{m}"] for m in candidate.place.members])
            continue
        several = [i for i, p in enumerate(candidate.parameters) if not p.shape]
        column, at = len(numbers), tuple(float(v) for v in candidate.null)
        further = _further_steps(candidate, model)
        numbers += [FreeNumber(candidate, i, at, candidate.parameters[i].step) for i in several]
        near = [_range(candidate, i, bool(further)) for i in several]
        entries.append(CandidateColumns(candidate, tuple((column + i,) for i in range(len(several))), tuple(near)))
        single[candidate.name] = [(column, near[0])]
        for step in further:
            bounds = _near(candidate, step)
            single[candidate.name].append((len(numbers), bounds))
            entries.append(CandidateColumns(candidate, ((len(numbers),),), (bounds,)))
            numbers.append(FreeNumber(candidate, 0, at, step))
        if not candidate.place.members:
            for i in several:
                own = candidate.parameters[i]
                known, least = tolerances.get(candidate.effect.name, 0.0), 0.0
                if candidate.effect.name in DRIVE:
                    least = _UNKNOWN * abs(own.step)
                if sigma := known or max(field_tolerance(candidate.effect.name, own.tolerance), least):
                    calibrated.append(
                        (CandidateColumns(candidate, ((column + i,),), (near[0],)), sigma, MOST_CALIBRATED * sigma)
                    )
    for candidate in of_log:
        (own,), entry = (
            candidate.parameters,
            CandidateColumns(candidate, ((len(numbers),),), (_range(candidate, 0, False),)),
        )
        numbers.append(FreeNumber(candidate, 0, (own.null,), own.step))
        sigma = field_tolerance(candidate.effect.name, own.tolerance)
        calibrated.append((entry, sigma, MOST_CALIBRATED * sigma))
    for parameter in believed:
        candidate = _as_candidate(parameter, model)
        entry = CandidateColumns(candidate, ((len(numbers),),), (_range(candidate, 0, False),))
        numbers.append(FreeNumber(candidate, 0, (candidate.parameters[0].null,), candidate.parameters[0].step))
        calibrated.append((entry, parameter.high - parameter.low, parameter.high - parameter.low))
    whole = [e for e in entries if e.candidate.effect.name == TIMING and e.candidate.parameters[0].low < 0]
    calibrated += [(entry, TIME_IN_SAMPLE * interval, _WITHIN * interval) for entry in whole[:1]]
    prior = CalibrationPrior(
        np.concatenate([np.zeros((len(numbers), 0)), *(e.design(len(numbers)) for e, _, _ in calibrated)], 1),
        np.array([sigma for _, sigma, _ in calibrated]),
        np.array([reach for _, _, reach in calibrated]),
        np.zeros(len(calibrated)),
    )
    return Library(tuple(numbers), tuple(entries), tuple(e for e, _, _ in calibrated), prior)


def _as_candidate(parameter: PathParameter, model: mujoco.MjModel) -> Candidate:
    """A number of the model that may be refitted, as an effect."""

    def write(world: World, place: Place, values: np.ndarray) -> None:
        parameter.write(world.model, float(values[0]))
        mujoco.mj_setConst(world.model, mujoco.MjData(world.model))

    value = parameter.value(model)
    (step,) = believed_steps([parameter], [value])
    low, high = min(parameter.low, value), max(parameter.high, value)
    own = Parameter("value", parameter.unit or "1", low, high, float(step), null=value)
    return Candidate(Effect(BELIEVED + parameter.name, lambda _: [], lambda *_: (own,), write), WORLD, (own,))


def calibrated_number(library: Library, entry: CandidateColumns) -> int:
    """Index of the number of a candidate that is calibration."""
    return library.numbers[entry.columns[0][0]].index if len(entry.columns[0]) == 1 else 0


def with_refitted(number: FreeNumber, change: float) -> FreeNumber:
    """A free number beside a change of calibration; its derivative is taken within its bounds.

    Numbers of the model that may be refitted are written as they are, and beyond their bounds there may be no model.
    Other effects are added to what is there: their numbers stay.

    Args:
      number: at its null.
      change: value of calibration.
    """
    if not number.candidate.effect.name.startswith(BELIEVED):
        return number
    (own,) = number.candidate.parameters
    at = float(np.clip(number.at[0] + change, own.low, own.high))
    return replace(number, at=(at,), step=number.step if own.low <= at + number.step <= own.high else -number.step)


def calibrated_effects(library: Library, calibration: np.ndarray) -> list[tuple[Candidate, tuple[float, ...]]]:
    """Calibration as effects with their values, which stay within their ranges; of those at their null nothing.

    Args:
      library: of the search.
      calibration: (n,) values.
    """
    out: dict[str, tuple[Candidate, np.ndarray]] = {}
    for entry, value in zip(library.calibrated, calibration, strict=True):
        if value:
            _, values = out.setdefault(entry.candidate.name, (entry.candidate, entry.candidate.null))
            values[calibrated_number(library, entry)] += value
    return [
        (candidate, tuple(float(np.clip(v, p.low, p.high)) for v, p in zip(values, candidate.parameters, strict=True)))
        for candidate, values in out.values()
    ]


def believed_values(
    library: Library, believed: Sequence[PathParameter], calibration: np.ndarray, before: Sequence[float]
) -> list[float]:
    """Values of numbers that may be refitted, as part of calibration.

    Args:
      library: of the search.
      believed: the numbers.
      calibration: (n,) values.
      before: their believed values.
    """
    found = {e.candidate.effect.name: v for e, v in zip(library.calibrated, calibration, strict=True)}
    out = []
    for parameter, value in zip(believed, before, strict=True):
        moved = value + float(found.get(BELIEVED + parameter.name, 0.0))
        out.append(float(np.clip(moved, min(parameter.low, value), max(parameter.high, value))))
    return out


def _group(
    candidate: Candidate, members: Sequence[Sequence[tuple[int, tuple[float, float]]]]
) -> list[CandidateColumns]:
    """Entries of a group whose columns are those of its members, one for every step that all of them have."""
    out = []
    for level in range(min(map(len, members))):
        columns, near = zip(*(own[level] for own in members), strict=True)
        if candidate.place.parts:
            out.append(CandidateColumns(candidate, tuple((c,) for c in columns), tuple(near)))
        else:
            # All commands may be late in a log, and none of them alone: a group has a range of its own.
            first = level == 0 and not candidate.effect.saturates
            own_range = [_range(candidate, 0, len(members[0]) > 1)]
            lows, highs = zip(*(own_range if first else near), strict=True)
            # Members of very different sizes have no step in common.
            if (low := max(lows)) < (high := min(highs)):
                out.append(CandidateColumns(candidate, (tuple(columns),), ((low, high),)))
    return out


def _range(candidate: Candidate, index: int, nonlinear: bool) -> tuple[float, float]:
    """Changes of a number that its first column serves."""
    own = candidate.parameters[index]
    low, high = own.low - own.null, own.high - own.null
    if candidate.effect.saturates:
        return _near(candidate, own.step)
    if not nonlinear:
        return low, high
    reach = _NEAR[1] * abs(own.step)
    return max(low, -reach), min(high, reach)


def _near(candidate: Candidate, step: float) -> tuple[float, float]:
    """Changes of the first number that a column at a step serves, within its range."""
    own = candidate.parameters[0]
    ends = np.clip(np.sort([part * step for part in _NEAR]), own.low - own.null, own.high - own.null)
    return float(ends[0]), float(ends[1])


def _further_steps(candidate: Candidate, model: mujoco.MjModel) -> list[float]:
    """Further steps at which a candidate is tried: what it does at its true size may be far from linear."""
    first = candidate.parameters[0]
    if candidate.effect.saturates:
        tightest = first.low if first.step < 0 else first.high
        probes = [share * (tightest - first.null) for share in LIMIT_SIZES]
        return [probe for probe in probes if abs(probe) > 1.5 * abs(first.step)]
    values = candidate.null
    values[0] += first.step
    world = candidate.apply(World.of(model), values)
    friction = not np.array_equal(world.model.dof_frictionloss, model.dof_frictionloss)
    if not (friction or world.command_edits or world.laws):
        return []
    larger = [part * first.step for part in _LARGER]
    return [step for step in larger if first.low <= first.null + step <= first.high]
