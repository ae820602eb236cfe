"""Screening of candidates by fitness: the change of fitness that every candidate causes, fitted to the measured change.

Every candidate is simulated at one size (vectors at both signs of every component), on M trials. Its response is the
change of fitness, d (M,). With w (M,) the measured fitness less that of the believed model, its explained share is

    1 - min over a >= 0 of  |w - a d|^2 / |w|^2,    by non-negative least squares

Whole trials with contacts are too irregular for derivatives with respect to small parameters; the response to a large
change is roughly proportional to its size instead. A response to a vector (a slope, a force) is not odd in its sign:
a push in either direction may increase the distance. The responses do not depend on the measured fitness, so that they
can be reused for several realities that are tried with the same controllers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.fitness_only.trials import TrialSimulator
from btr_mjx.gap.simulate import World

SCALAR_STEPS, VECTOR_STEPS = 8.0, 4.0
"""Sizes at which scalar parameters and components of vectors are simulated, in finite-difference steps."""
COARSE_FACTORS = (4.0, 2.0)
"""Time steps for screening, as factors on the model's own, tried in this order."""
TIMESTEP_ERROR = 0.5
"""Largest change of the fitness by a coarser time step, as a share of the mean change that is to be explained."""


@dataclass(frozen=True)
class CandidateResponses:
    """Changes of fitness that candidates cause.

    Attributes:
      candidates: (C,) candidates.
      rows: (M,) indices of the trials.
      timestep: time step of the simulations [s].
      believed: (M,) fitness of the believed model at that time step [m/s].
      tried: per candidate (q, p) differences of its parameters from their nulls.
      change: per candidate (q, M) changes of the fitness [m/s].
    """

    candidates: tuple[Candidate, ...]
    rows: np.ndarray
    timestep: float
    believed: np.ndarray
    tried: tuple[np.ndarray, ...]
    change: tuple[np.ndarray, ...]


class ScreenedCandidate(NamedTuple):
    """A candidate with fitted values (p,), and the share of the mean square that they explain, adjusted for freedom."""

    candidate: Candidate
    values: np.ndarray
    explained: float


def simulate_candidates(
    trials: TrialSimulator,
    candidates: Sequence[Candidate],
    rows: np.ndarray,
    timestep: float,
    note: Callable[[str], None] = lambda _: None,
) -> CandidateResponses:
    """Simulate every candidate at its screening size.

    Args:
      trials: simulator of the table's trials.
      candidates: (C,) candidates.
      rows: (M,) indices of the trials that are simulated.
      timestep: time step of the simulations [s].
      note: called with a short description of the progress.

    Returns:
      The responses.
    """
    model = trials.table.head.model
    tried = [_sizes(candidate) for candidate in candidates]
    worlds = [c.apply(World.of(model), c.null + row) for c, own in zip(candidates, tried, strict=True) for row in own]
    note(f"{len(candidates)} candidates on {len(rows)} trials")
    believed = trials.fitness([World.of(model)], rows, timestep)[0]
    change = np.nan_to_num(trials.fitness(worlds, rows, timestep) - believed)
    ends = np.cumsum([len(own) for own in tried])[:-1]
    return CandidateResponses(tuple(candidates), rows, timestep, believed, tuple(tried), tuple(np.split(change, ends)))


def _sizes(candidate: Candidate) -> np.ndarray:
    """Differences (q, p) from the null at which a candidate is simulated."""
    own = size_parameters(candidate)
    out = []
    for axis in own:
        parameter = candidate.parameters[axis]
        steps = (VECTOR_STEPS, -VECTOR_STEPS) if len(own) > 1 else (SCALAR_STEPS,)
        for size in steps:
            value = float(np.clip(parameter.null + size * parameter.step, parameter.low, parameter.high))
            if value == parameter.null:  # at a bound: the other way
                value = float(np.clip(parameter.null - size * parameter.step, parameter.low, parameter.high))
            row = np.zeros(len(candidate.parameters))
            row[axis] = value - parameter.null
            out.append(row)
    return np.array(out)


def size_parameters(candidate: Candidate) -> list[int]:
    """Indices of the parameters that scale an effect: the first one, or all components of a vector."""
    return [i for i, parameter in enumerate(candidate.parameters) if i == 0 or not parameter.shape]


def rank_by_fit(responses: CandidateResponses, wanted: np.ndarray) -> list[ScreenedCandidate]:
    """Rank candidates by the share of a change of fitness (M,) [m/s] that their fitted response explains."""
    out = []
    energy = float(wanted @ wanted) + 1e-300
    for candidate, tried, change in zip(responses.candidates, responses.tried, responses.change, strict=True):
        low, high = (np.array([getattr(p, end) for p in candidate.parameters]) for end in ("low", "high"))
        # The response of a scalar is taken to be odd; its negative is used where the bounds admit it.
        both = np.concatenate([tried, -tried]) if len(size_parameters(candidate)) == 1 else tried
        answer = np.concatenate([change, -change]) if len(size_parameters(candidate)) == 1 else change
        inside = ((candidate.null + 1e-9 * both >= low) & (candidate.null + 1e-9 * both <= high)).all(axis=1)
        share = scipy.optimize.nnls(answer[inside].T, wanted)[0]
        share *= _within(candidate.null, share @ both[inside], low, high)
        left = wanted - share @ answer[inside]
        freedom = len(wanted) / max(1, len(wanted) - len(size_parameters(candidate)))
        explained = 1.0 - float(left @ left) / energy * freedom
        out.append(ScreenedCandidate(candidate, candidate.null + share @ both[inside], explained))
    return sorted(out, key=lambda screened: -screened.explained)


def _within(null: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """The largest factor up to 1 that keeps a step within bounds."""
    room = np.where(step > 0, high - null, null - low)
    return float(np.min(room / np.maximum(np.abs(step), 1e-300), initial=1.0))


def screening_timestep(trials: TrialSimulator, rows: np.ndarray, own: np.ndarray, wanted: np.ndarray) -> float:
    """The largest time step [s] whose error is small compared with the change that is to be explained.

    `own` is the fitness of the believed model at its own time step in some trials (M,), `wanted` the measured fitness
    less that [m/s]. Where no coarser step is accurate enough it is the model's own.
    """
    model = trials.table.head.model
    for factor in COARSE_FACTORS:
        step = factor * float(model.opt.timestep)
        found = trials.fitness([World.of(model)], rows, step)[0]
        if np.isfinite(found).all() and np.abs(found - own).mean() < TIMESTEP_ERROR * np.abs(wanted).mean():
            return step
    return float(model.opt.timestep)
