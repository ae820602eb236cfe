"""What recordings say of a robot, as the calibration of other recordings of the same robot.

A posterior of numbers becomes the prior of the next search, correlations included: what one set of recordings cannot
tell apart (a gain and a mass), another set may not tell apart either, and only their combination is known well. The
same could be had from one likelihood of both sets in which effects act on one of them. It would simulate both sets for
every hypothesis and would trust its own variances; a covariance can say that recordings differ by more than these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import OF_LOG, TIMING, Candidate, Hypothesis
from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.evidence import CalibrationPrior
from btr_mjx.gap.forces.kalman_filter import Filtered, Variances, smoothed
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, again, covariance, evaluate_point
from btr_mjx.gap.forces.sets.combined import Named, at_single_places, combined
from btr_mjx.gap.forces.settling import newton_step
from btr_mjx.gap.forces.unknowns import (
    BELIEVED,
    MOST_CALIBRATED,
    CandidateColumns,
    Library,
    calibrated_effects,
    calibrated_number,
)

CarriedNumber = tuple[str, int]
"""Name of a candidate, "effect@place", and index of its parameter."""

_ONE_WAY = ("actuator_lag", "actuator_delay", "backlash")
"""Effects of which a second one adds to the first and cannot undo it."""

_UPDATES = 4
"""Updates of variances of held-out recordings."""


@dataclass(frozen=True, eq=False)
class Carried:
    """What recordings say of a robot.

    Attributes:
      effects: named effects and calibration with their values, at single places; without what belongs to the log.
      believed: values of numbers of the model that may be refitted, by name.
      numbers: (m,) those that are known with an uncertainty.
      covariance: (m, m) of them.
      random: (nv,) variance of the random force that is left.
      law: evidence of a law that is left, per measured value.
    """

    effects: Named
    believed: dict[str, float]
    numbers: tuple[CarriedNumber, ...]
    covariance: np.ndarray
    random: np.ndarray
    law: float

    def base(self, dataset: Dataset) -> Hypothesis:
        """The robot, as a hypothesis about a dataset's believed model."""
        values = tuple(self.believed.get(p.name, p.value(dataset.model)) for p in dataset.parameters)
        return Hypothesis(dataset.parameters, values, self.effects)

    def spread(self, number: CarriedNumber) -> float:
        """1 sigma of a number; 0 for one that is not known with an uncertainty."""
        return float(np.sqrt(self.covariance.diagonal()[self.numbers.index(number)])) if number in self.numbers else 0.0


def carried_of(found: SearchOutcome) -> Carried:
    """What a search says of a robot, with the held-out recordings as well: no name is left that they have to confirm.

    Numbers are those of forces, which do not yet follow recordings: the next recordings are fitted so, too.
    """
    side, test, fit = found.side, found.test, found.forces
    pooled = _with_held_out(test, fit)
    step = newton_step(side, pooled)
    change = np.concatenate([step.values, step.calibration - fit.point.calibration])
    turn = np.eye(1 + len(change))
    turn[1:, 0] = change
    moved = pooled.with_whitened(replace(pooled.whitened, gram=turn.T @ pooled.whitened.gram @ turn))
    recording = np.r_[side.stretches.recording, len(side.stretches.data.recordings) + test.stretches.recording]
    numbers, sums = _numbers(side.library, fit.point)
    point = fit.point.moved(step.values, step.calibration)
    refits = {e.candidate.effect.name: v for e, v in zip(side.library.calibrated, point.calibration, strict=True)}
    believed = {
        p.name: value + refits.get(BELIEVED + p.name, 0.0)
        for p, value in zip(point.base.parameters, point.base.believed, strict=True)
    }
    return Carried(
        combined(point.base.effects, effects_of(side.library, point)),
        believed,
        numbers,
        sums @ covariance(side, moved, recording) @ sums.T,
        fit.variances.force,
        found.law_score / (fit.whitened.count * len(side.stretches)),
    )


def _with_held_out(test: ForceSide, fit: Fitted) -> Fitted:
    """A fit whose whitened columns are those of fitted and of held-out stretches."""
    variances = replace(fit.variances, weight=None)
    own = evaluate_point(test, fit.point, variances)
    for _ in range(_UPDATES):
        variances = _updated(own, variances)
    own = again(test, own, variances)
    both = (fit.whitened, own.whitened)
    gram, logs = (np.concatenate([getattr(w, name) for w in both]) for name in ("gram", "log_determinant"))
    return fit.with_whitened(Filtered(gram, logs, fit.whitened.count))


def _updated(fit: Fitted, variances: Variances) -> Variances:
    return smoothed(fit.linear, np.zeros_like(fit.linear.defect), variances).variances


def _numbers(library: Library, point: Point) -> tuple[tuple[CarriedNumber, ...], np.ndarray]:
    """Numbers that are carried, and (m, p + n) how they are sums of named numbers and calibration.

    A place of a payload has no meaning without its mass, and so a payload is carried without an uncertainty of its own,
    beside that of the mass of its body. When commands act belongs to the log.
    """
    every: list[tuple[CarriedNumber, ...]] = []
    for candidate, values in point.named:
        shaped = any(p.shape for p in candidate.parameters) or candidate.effect.name in OF_LOG
        if candidate.place.parts:
            every += [((single.name, 0),) for single in candidate.singles]
        elif candidate.place.members and not shaped:
            every.append(tuple((single.name, 0) for single, _ in at_single_places(library, candidate, values)))
        else:
            every += [() if shaped else ((candidate.name, i),) for i in range(len(values))]
    for entry in library.calibrated:
        of_log = entry.candidate.effect.name in OF_LOG
        every.append(() if of_log else ((entry.candidate.name, calibrated_number(library, entry)),))
    numbers = tuple(dict.fromkeys(number for own in every for number in own))
    sums = np.zeros((len(numbers), len(every)))
    for j, own in enumerate(every):
        sums[[numbers.index(number) for number in own], j] = 1.0
    return numbers, sums


def effects_of(library: Library, point: Point) -> Named:
    """Named effects and calibration of a point, at single places, without what belongs to the log.

    Args:
      library: of the search.
      point: the point.
    """
    calibrated = [
        (candidate, values)
        for candidate, values in calibrated_effects(library, point.calibration)
        if candidate.effect.name not in OF_LOG and not candidate.effect.name.startswith(BELIEVED)
    ]
    late = [(c, v) for c, v in point.named if c.effect.name == TIMING and v[0] < 0]
    named = [one for row in point.named if row not in late for one in at_single_places(library, *row)]
    return combined((), (*named, *calibrated))


def with_room(candidates: Sequence[Candidate], carried: Carried) -> list[Candidate]:
    """Candidates that may undo what was named before, where their range ends at nothing.

    Args:
      candidates: every effect at every place.
      carried: what was named before.
    """
    known = {candidate.name: values for candidate, values in carried.effects}
    out = []
    for candidate in candidates:
        first, effect = candidate.parameters[0], candidate.effect
        found = known.get(candidate.name, (0.0,))[0]
        adds = effect.summable and not effect.saturates and effect.name not in _ONE_WAY
        if found > 0 and first.low == first.null == 0 and adds:
            candidate = replace(candidate, parameters=(replace(first, low=-found), *candidate.parameters[1:]))
        out.append(candidate)
    return out


def carried_library(library: Library, carried: Carried) -> Library:
    """A library whose calibration is what other recordings say of the robot.

    Numbers that were named before are calibration as well. What was never known with an uncertainty keeps its
    tolerance, and so does what belongs to the log.

    Args:
      library: of the believed model with what was found before.
      carried: what the other recordings say.
    """
    calibrated = list(library.calibrated)
    own = [(e.candidate.name, calibrated_number(library, e)) for e in calibrated]
    for number in carried.numbers:
        if number not in own and (entry := _entry(library, number)) is not None:
            calibrated.append(entry)
            own.append(number)
    size, old = len(calibrated), library.calibration
    tolerance, reach = np.ones(size), np.ones(size)
    tolerance[: len(old.tolerance)], reach[: len(old.reach)] = old.tolerance, old.reach
    precision = np.diag(1 / tolerance**2)
    known = [i for i, number in enumerate(own) if number in carried.numbers]
    index = [carried.numbers.index(own[i]) for i in known]
    found = carried.covariance[np.ix_(index, index)]
    tolerance[known] = np.sqrt(np.diag(found))
    free = [i for i in known if not calibrated[i].candidate.effect.name.startswith(BELIEVED)]
    reach[free] = MOST_CALIBRATED * tolerance[free]
    # Members of a group with one number move together, to within a thousandth of their uncertainty.
    correlation = found / tolerance[known] / tolerance[known][:, None] + 1e-6 * np.eye(len(known))
    precision[np.ix_(known, known)] = np.linalg.inv(correlation) / tolerance[known] / tolerance[known][:, None]
    count = len(library.numbers)
    design = np.concatenate([np.zeros((count, 0)), *(e.design(count) for e in calibrated)], 1)
    prior = CalibrationPrior(design, tolerance, reach, np.zeros(size), precision)
    return replace(library, calibrated=tuple(calibrated), calibration=prior)


def _entry(library: Library, number: CarriedNumber) -> CandidateColumns | None:
    """The columns of a number that may become larger and smaller; None where there are none.

    A second lag or play adds to the first one and cannot undo it: such numbers stay as they were found.
    """
    for entry in library.entries:
        if entry.candidate.name == number[0]:
            own, parameter = entry.candidate, entry.candidate.parameters[number[1]]
            for columns, near in zip(entry.columns, entry.near, strict=True):
                two_sided = parameter.low < parameter.null < parameter.high and not own.effect.saturates
                if library.numbers[columns[0]].index == number[1] and two_sided:
                    return CandidateColumns(own, (columns,), (near,))
            return None
    return None
