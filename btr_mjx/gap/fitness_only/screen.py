"""Screening by fitness: what every candidate would do to the fitness of some trials, and which explain what was seen.

A candidate is simulated once, at a size that can be felt. What it does there, scaled, is what it would do at other
sizes, roughly: after a whole trial contacts have mixed up small causes, so that there are no derivatives to take, but
what a large effect does keeps its shape over the controllers. Only directions (a slope, a force) are tried both ways:
a robot that is pushed hard goes further whether it is pushed forwards or backwards. The answers do not depend on what
was measured. They serve any number of realities that are tried with the same controllers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.fitness_only.trials import TrialSimulator
from btr_mjx.gap.simulate import World

SIZE, VECTOR_SIZE = 8.0, 4.0
"""Sizes at which numbers and components of vectors are simulated, in finite-difference steps."""
COARSER = (4.0, 2.0)
"""Time steps that screening tries, as factors on the model's own."""
ERROR = 0.5
"""What a coarser time step may change, as a share of what is to be explained."""


@dataclass(frozen=True)
class Answers:
    """What candidates do to the fitness of some trials.

    Attributes:
      candidates: (C,) of them.
      rows: (M,) trials.
      timestep: of the simulations [s].
      believed: (M,) fitness of the believed model at that time step [m/s].
      tried: per candidate (q, p) differences of its numbers from their nulls.
      change: per candidate (q, M) what these do to the fitness [m/s].
    """

    candidates: tuple[Candidate, ...]
    rows: np.ndarray
    timestep: float
    believed: np.ndarray
    tried: tuple[np.ndarray, ...]
    change: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class ScreenedCandidate:
    """A candidate as the screening sees it.

    Attributes:
      candidate: the candidate.
      values: (p,) its numbers.
      explained: share of the mean square that it explains, corrected for the count of its numbers.
    """

    candidate: Candidate
    values: np.ndarray
    explained: float


def simulate_candidates(
    trials: TrialSimulator,
    candidates: Sequence[Candidate],
    rows: np.ndarray,
    timestep: float,
    note: Callable[[str], None] = lambda _: None,
) -> Answers:
    """Simulate every candidate at its size.

    Args:
      trials: of the table.
      candidates: all of them.
      rows: (M,) trials that are simulated.
      timestep: of the simulations [s].
      note: called with a word on what is being done.
    """
    model = trials.table.head.model
    tried = [_sizes(candidate) for candidate in candidates]
    worlds = [c.apply(World.of(model), c.null + row) for c, own in zip(candidates, tried, strict=True) for row in own]
    note(f"{len(candidates)} candidates on {len(rows)} trials")
    believed = trials.fitness([World.of(model)], rows, timestep)[0]
    change = np.nan_to_num(trials.fitness(worlds, rows, timestep) - believed)
    ends = np.cumsum([len(own) for own in tried])[:-1]
    return Answers(tuple(candidates), rows, timestep, believed, tuple(tried), tuple(np.split(change, ends)))


def _sizes(candidate: Candidate) -> np.ndarray:
    """Differences (q, p) from the null at which a candidate is tried."""
    own = axes(candidate)
    out = []
    for axis in own:
        parameter = candidate.parameters[axis]
        steps = (VECTOR_SIZE, -VECTOR_SIZE) if len(own) > 1 else (SIZE,)
        for size in steps:
            value = float(np.clip(parameter.null + size * parameter.step, parameter.low, parameter.high))
            if value == parameter.null:  # at a bound: the other way
                value = float(np.clip(parameter.null - size * parameter.step, parameter.low, parameter.high))
            row = np.zeros(len(candidate.parameters))
            row[axis] = value - parameter.null
            out.append(row)
    return np.array(out)


def axes(candidate: Candidate) -> list[int]:
    """Numbers of a candidate that say how large it is: the first one, or all of a vector."""
    return [i for i, parameter in enumerate(candidate.parameters) if i == 0 or not parameter.shape]


def leads(known: Answers, wanted: np.ndarray) -> list[ScreenedCandidate]:
    """Candidates by how much they explain, best first.

    Args:
      known: what the candidates do.
      wanted: (M,) measured fitness less that of the believed model [m/s].
    """
    out = []
    energy = float(wanted @ wanted) + 1e-300
    for candidate, tried, change in zip(known.candidates, known.tried, known.change, strict=True):
        low, high = (np.array([getattr(p, end) for p in candidate.parameters]) for end in ("low", "high"))
        # What was tried one way only is taken to do the opposite the other way, where it may go there.
        both = np.concatenate([tried, -tried]) if len(axes(candidate)) == 1 else tried
        answer = np.concatenate([change, -change]) if len(axes(candidate)) == 1 else change
        inside = ((candidate.null + 1e-9 * both >= low) & (candidate.null + 1e-9 * both <= high)).all(axis=1)
        share = nnls(answer[inside].T, wanted)[0]
        share *= _within(candidate.null, share @ both[inside], low, high)
        left = wanted - share @ answer[inside]
        freedom = len(wanted) / max(1, len(wanted) - len(axes(candidate)))
        explained = 1.0 - float(left @ left) / energy * freedom
        out.append(ScreenedCandidate(candidate, candidate.null + share @ both[inside], explained))
    return sorted(out, key=lambda lead: -lead.explained)


def _within(null: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """The largest factor up to 1 that keeps a step within bounds."""
    room = np.where(step > 0, high - null, null - low)
    return float(np.min(room / np.maximum(np.abs(step), 1e-300), initial=1.0))


def coarse_step(trials: TrialSimulator, rows: np.ndarray, own: np.ndarray, wanted: np.ndarray) -> float:
    """The largest time step that is good enough to screen with [s].

    Args:
      trials: of the table.
      rows: (M,) trials.
      own: (M,) fitness of the believed model at its own time step [m/s].
      wanted: (M,) what is to be explained [m/s].
    """
    model = trials.table.head.model
    for factor in COARSER:
        step = factor * float(model.opt.timestep)
        found = trials.fitness([World.of(model)], rows, step)[0]
        if np.isfinite(found).all() and np.abs(found - own).mean() < ERROR * np.abs(wanted).mean():
            return step
    return float(model.opt.timestep)
