"""Search for the missing effect from fitness alone: which candidate reduces Delta_fitness, on held-out trials as well.

Every measured number costs a simulation of a whole trial, so that the search has three stages:

1. all candidates, at one size each, on `SCREENING_TRIALS` trials with a coarse time step (`screen`);
2. the leaders at several sizes, on the same trials with the same time step;
3. the best of these on all trials, with the model's own time step.

The result is a ranking with the reduction of Delta_fitness. These data cannot distinguish an effect outside the library
from no missing effect.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.effects import EFFECTS, Candidate, Effect, candidates
from btr_mjx.gap.fitness_only.fitness_diagnosis import ValuedCandidate, as_diagnosis
from btr_mjx.gap.fitness_only.fitness_table import FitnessTable
from btr_mjx.gap.fitness_only.screen import (
    COARSE_FACTORS,
    CandidateResponses,
    ScreenedCandidate,
    rank_by_fit,
    screening_timestep,
    simulate_candidates,
    size_parameters,
)
from btr_mjx.gap.fitness_only.trials import TrialSimulator
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import Counter, World

SCREENING_TRIALS = 16
"""Trials on which all candidates are simulated."""
LEADERS_RESIZED, LEADERS_PER_EFFECT = 10, 3
"""Leaders that are simulated at several sizes, and how many of them may have the same effect."""
LEADERS_REFINED = 3
"""Leaders that are simulated on all trials with the model's own time step."""
SIZE_FACTORS, FINE_SIZE_FACTORS = (0.5, 1.0, 1.6), (0.8, 1.25)
"""Factors on the size of the leaders, and on that of the best one at the end."""


def identify_fitness(
    table: FitnessTable,
    effects: Sequence[Effect] = EFFECTS,
    progress: Callable[[str], None] | None = None,
    counter: Counter | None = None,
    responses: CandidateResponses | None = None,
) -> Diagnosis:
    """Rank effects by the reduction of Delta_fitness.

    Args:
      table: the trials.
      effects: the library.
      progress: called with a short description of the progress.
      counter: counts the simulated steps; a `btr_mjx.gap.simulate.Journal` keeps results for a resumed search.
      responses: responses of the candidates, where they were simulated before for the same controllers.

    Returns:
      The diagnosis; its verdict is "effect" or "none". Its gap is Delta_fitness on the held-out trials [m/s], its noise
      floor the change of fitness by half the time step.
    """
    begun, note = time.monotonic(), progress or (lambda _: None)
    trials = TrialSimulator(table, counter)
    model = table.head.model
    fit, test = np.flatnonzero(~table.test), np.flatnonzero(table.test)
    every = np.concatenate([fit, test])
    note("the believed model")
    own = np.full(len(table.fitness), np.nan)
    own[every] = trials.fitness([World.of(model)], every)[0]
    wanted = np.nan_to_num(table.fitness - own)
    before = [float(np.abs(wanted[rows]).mean()) for rows in (fit, test)]
    if responses is None:
        rows = fit[:SCREENING_TRIALS]
        step = screening_timestep(trials, rows, own[rows], wanted[rows])
        responses = simulate_candidates(trials, _candidates(trials, fit, effects), rows, step, note)
    found = rank_by_fit(responses, wanted[responses.rows])
    note("leaders at other sizes")
    narrowed = _narrow(trials, responses, _pick(found), wanted)
    note("leaders on all trials")
    refined = _refine(trials, narrowed[:LEADERS_REFINED], fit)
    held_out = trials.fitness([t.apply(trials) for t in refined], test)
    ends = [_delta(row, table.fitness[test], trials) for row in held_out]
    half = trials.fitness([World.of(model)], test, 0.5 * float(model.opt.timestep))[0]
    floor = float(np.nanmean(np.abs(half - own[test])))
    tried = {t.candidate.name for t in narrowed}
    rest = [*narrowed[LEADERS_REFINED:], *_unrefined(found, tried, before[0])]
    return as_diagnosis(refined, ends, rest, before, floor, trials, time.monotonic() - begun + trials.counter.earlier)


def expected_steps(table: FitnessTable, effects: Sequence[Effect] = EFFECTS) -> float:
    """Approximate number of simulated steps of a search."""
    trials = TrialSimulator(table)
    model, fit = table.head.model, np.flatnonzero(~table.test)
    worlds = sum(2 * len(size_parameters(c)) - 1 for c in _candidates(trials, fit, effects))
    per_trial = table.duration / float(model.opt.timestep)
    screened = min(SCREENING_TRIALS, len(fit)) / COARSE_FACTORS[0] * (worlds + LEADERS_RESIZED * len(SIZE_FACTORS))
    return per_trial * (screened + len(fit) * (LEADERS_REFINED + len(FINE_SIZE_FACTORS)) + 3 * len(table.fitness))


def _candidates(trials: TrialSimulator, fit: np.ndarray, effects: Sequence[Effect]) -> list[Candidate]:
    """Candidates with few numbers: one fitness a trial does not tell the joints of a group apart."""
    found = candidates(trials.table.head.model, trials.scales(fit[:3]), effects)
    return [candidate for candidate in found if not candidate.place.parts]


def _delta(fitness: np.ndarray, real: np.ndarray, trials: TrialSimulator) -> float:
    """Delta_fitness; a diverged trial counts as the whole spread of fitness."""
    worst = float(np.ptp(trials.table.fitness)) + 1e-12
    return float(np.nan_to_num(np.abs(fitness - real), nan=worst).mean())


def _pick(found: Sequence[ScreenedCandidate]) -> list[ScreenedCandidate]:
    """The best candidates, few of each effect: these data determine the effect better than its place."""
    out: list[ScreenedCandidate] = []
    for leader in found:
        same = sum(leader.candidate.effect.name == other.candidate.effect.name for other in out)
        absent = np.array_equal(leader.values, leader.candidate.null)
        if same < LEADERS_PER_EFFECT and len(out) < LEADERS_RESIZED and not absent:
            out.append(leader)
    return out


def _narrow(
    trials: TrialSimulator, responses: CandidateResponses, chosen: Sequence[ScreenedCandidate], wanted: np.ndarray
) -> list[ValuedCandidate]:
    """Leaders at the best of several sizes, best first, with the time step and the trials of the screening.

    The fitness of the believed model at that time step is subtracted, which removes most of the time step's error.
    """
    tries = [
        ValuedCandidate(one.candidate, v) for one in chosen for v in _sizes(one.candidate, one.values, SIZE_FACTORS)
    ]
    worlds = [t.apply(trials) for t in tries]
    rows, real = responses.rows, wanted[responses.rows]
    change = trials.fitness(worlds, rows, responses.timestep) - responses.believed
    return _best([replace(t, delta=_delta(row, real, trials)) for t, row in zip(tries, change, strict=True)])


def _refine(trials: TrialSimulator, leaders: Sequence[ValuedCandidate], fit: np.ndarray) -> list[ValuedCandidate]:
    """Leaders on all trials to fit with the model's own time step, best first; the best one at more sizes."""

    def simulated(tries: Sequence[ValuedCandidate]) -> list[ValuedCandidate]:
        found = trials.fitness([t.apply(trials) for t in tries], fit)
        real = trials.table.fitness[fit]
        return [replace(t, delta=_delta(row, real, trials)) for t, row in zip(tries, found, strict=True)]

    first = _best(simulated(leaders))
    best = first[0]
    more = [ValuedCandidate(best.candidate, v) for v in _sizes(best.candidate, best.values, FINE_SIZE_FACTORS)]
    return _best([*first, *simulated(more)])


def _sizes(candidate: Candidate, values: Sequence[float] | np.ndarray, factors: Sequence[float]) -> list[tuple]:
    """Values at several sizes, within their bounds, without repetitions."""
    out: dict[tuple, None] = {}
    for factor in factors:
        own = list(map(float, values))
        for axis in size_parameters(candidate):
            p = candidate.parameters[axis]
            own[axis] = float(np.clip(p.null + factor * (own[axis] - p.null), p.low, p.high))
        out[tuple(own)] = None
    return list(out)


def _best(tries: Sequence[ValuedCandidate]) -> list[ValuedCandidate]:
    """The best values of each candidate, best first."""
    out: dict[str, ValuedCandidate] = {}
    for t in sorted(tries, key=lambda t: t.delta):
        out.setdefault(t.candidate.name, t)
    return list(out.values())


def _unrefined(found: Sequence[ScreenedCandidate], tried: set[str], before: float) -> list[ValuedCandidate]:
    """Candidates that were only screened, with the Delta_fitness that follows from their explained share."""
    return [
        ValuedCandidate(o.candidate, tuple(o.values), before * float(np.sqrt(max(0.0, 1.0 - o.explained))))
        for o in found
        if o.candidate.name not in tried
    ]
