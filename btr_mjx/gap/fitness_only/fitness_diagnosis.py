"""The diagnosis of a search by fitness: a ranking, and a name where Delta_fitness falls on both sides of the split."""

from collections.abc import Sequence
from dataclasses import dataclass

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.fitness_only.trials import TrialSimulator
from btr_mjx.gap.results import (
    DELTA_FITNESS,
    Diagnosis,
    Estimate,
    JointError,
    NamedEffect,
    RankedCandidate,
    format_number,
)
from btr_mjx.gap.simulate import World

LEAST_REDUCTION = 0.25
"""Relative reduction of Delta_fitness that a name needs, on the trials to fit and on the held-out trials."""
_CLOSE = 0.25
"""Candidates whose reduction is smaller than the best one's by less than this share of it are equivalent."""


@dataclass(frozen=True)
class ValuedCandidate:
    """A candidate with values of its parameters.

    Attributes:
      candidate: the candidate.
      values: (p,) values of its parameters.
      delta: Delta_fitness on the trials to fit [m/s]; NaN before it was simulated.
    """

    candidate: Candidate
    values: tuple[float, ...]
    delta: float = float("nan")

    def apply(self, trials: TrialSimulator) -> World:
        """The believed model with the effect at these values."""
        return self.candidate.apply(World.of(trials.table.head.model), self.values)


def as_diagnosis(
    refined: Sequence[ValuedCandidate],
    ends: Sequence[float],
    rest: Sequence[ValuedCandidate],
    believed: Sequence[float],
    floor: float,
    trials: TrialSimulator,
    seconds: float,
) -> Diagnosis:
    """The diagnosis of a search by fitness.

    Refined leaders, best first, were simulated at the model's own time step on all trials to fit; `ends` are their
    Delta_fitness on the held-out trials, `rest` other candidates with an estimate. `believed` has Delta_fitness of the
    believed model on the trials to fit and on the held-out ones, `floor` is the change of the fitness by half the time
    step [m/s].
    """
    table = trials.table
    rows = []
    for t, held_out in zip((*refined, *rest), (*ends, *[None] * len(rest)), strict=True):
        numbers = {p.name: v for p, v in zip(t.candidate.parameters, t.values, strict=True)}
        gain, effect, place = believed[0] - t.delta, t.candidate.effect.name, t.candidate.place.label
        score, margin = 100 * gain / believed[0], 100 * (t.delta - refined[0].delta) / believed[0]
        fall = None if held_out is None else believed[1] - held_out
        rows.append(RankedCandidate(effect, place, score, margin, gain, fall, numbers))
    first, row, left = refined[0], rows[0], ends[0]
    named = min(1 - first.delta / believed[0], 1 - left / believed[1]) >= LEAST_REDUCTION
    close = tuple(t.candidate.name for t in refined if t.delta <= first.delta + _CLOSE * (believed[0] - first.delta))
    effects: tuple[NamedEffect, ...] = ()
    if named:
        estimates = {
            p.name: Estimate(row.parameters[p.name], None, None, p.unit, p.null) for p in first.candidate.parameters
        }
        same = tuple(name for name in close if name != first.candidate.name)
        about = (first.candidate.effect.excited_by, first.candidate.effect.equation)
        effects = (NamedEffect(row.effect, row.location, estimates, row.score, row.held_out, same, *about),)
    notes = (
        "Only fitness was known: scores are per cent of Delta_fitness on the trials to fit. Half the time step changes "
        f"fitness by {format_number(floor)} m/s. Fitness alone does not give intervals, and something outside the "
        "library looks like nothing.",
    )
    return Diagnosis(
        found=effects,
        ranking=tuple(rows),
        steps=trials.counter.steps,
        seconds=seconds,
        joint_errors=(JointError(DELTA_FITNESS, "m/s", table.duration, believed[1], left if named else None),),
        equivalent=close if named else (),
        threshold=100 * LEAST_REDUCTION,
        windows=(int((~table.test).sum()), int(table.test.sum()), 1, table.duration),
        notes=notes,
    )
