"""Screening by fitness: what every candidate would do to the fitness of some trials, and which explain what was seen.

A candidate is simulated once, at a size that can be felt. What it does there, scaled, is what it would do at other
sizes, roughly: after a whole trial contacts have mixed up small causes, so that there are no derivatives to take, but
what a large effect does keeps its shape over the controllers. The answers do not depend on what was measured. They
serve any number of realities that are tried with the same controllers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.effect import Candidate
from btr_mjx.gap.fitness_trials import Trials
from btr_mjx.gap.worlds import World

SIZE = 8.0
"""Size at which candidates are simulated, in finite-difference steps of their parameters."""
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
      sizes: per candidate (p,) differences from the null at which its numbers were tried, one at a time.
      change: per candidate (p, M) what that does to the fitness [m/s].
    """

    candidates: tuple[Candidate, ...]
    rows: np.ndarray
    timestep: float
    believed: np.ndarray
    sizes: tuple[np.ndarray, ...]
    change: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Lead:
    """A candidate as the screening sees it.

    Attributes:
      candidate: the candidate.
      values: (p,) its numbers.
      explained: share of the mean square that it explains, corrected for the count of its numbers.
    """

    candidate: Candidate
    values: np.ndarray
    explained: float


def answers(
    trials: Trials,
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
    sizes, worlds = [], []
    for candidate in candidates:
        own = []
        for axis in axes(candidate):
            parameter = candidate.parameters[axis]
            values = candidate.null
            values[axis] = np.clip(parameter.null + SIZE * parameter.step, parameter.low, parameter.high)
            if values[axis] == parameter.null:  # at a bound: the other way
                values[axis] = np.clip(parameter.null - SIZE * parameter.step, parameter.low, parameter.high)
            own.append(values[axis] - parameter.null)
            worlds.append(candidate.apply(World.of(model), values))
        sizes.append(np.array(own))
    note(f"{len(candidates)} candidates on {len(rows)} trials")
    believed = trials.fitness([World.of(model)], rows, timestep)[0]
    change = np.nan_to_num(trials.fitness(worlds, rows, timestep) - believed)
    ends = np.cumsum([len(own) for own in sizes])[:-1]
    return Answers(tuple(candidates), rows, timestep, believed, tuple(sizes), tuple(np.split(change, ends)))


def axes(candidate: Candidate) -> list[int]:
    """Numbers of a candidate that say how large it is: the first one, or all of a vector."""
    return [i for i, parameter in enumerate(candidate.parameters) if i == 0 or not parameter.shape]


def leads(known: Answers, wanted: np.ndarray) -> list[Lead]:
    """Candidates by how much they explain, best first.

    Args:
      known: what the candidates do.
      wanted: (M,) measured fitness less that of the believed model [m/s].
    """
    out = []
    energy = float(wanted @ wanted) + 1e-300
    for candidate, size, change in zip(known.candidates, known.sizes, known.change, strict=True):
        values, share = candidate.null, np.linalg.lstsq(change.T, wanted, rcond=1e-6)[0]
        for axis, own, part in zip(axes(candidate), size, share, strict=True):
            parameter = candidate.parameters[axis]
            low, high = sorted(((parameter.low - parameter.null) / own, (parameter.high - parameter.null) / own))
            values[axis] = parameter.null + float(np.clip(part, low, high)) * own
        used = np.array([values[a] - candidate.null[a] for a in axes(candidate)]) / size
        left = wanted - used @ change
        freedom = len(wanted) / max(1, len(wanted) - len(size))
        out.append(Lead(candidate, values, 1.0 - float(left @ left) / energy * freedom))
    return sorted(out, key=lambda lead: -lead.explained)


def coarse_step(trials: Trials, rows: np.ndarray, own: np.ndarray, wanted: np.ndarray) -> float:
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
