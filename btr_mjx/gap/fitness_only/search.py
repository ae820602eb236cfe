"""The missing effect from fitness alone: which candidate makes Delta_fitness fall, on trials that were held out, too.

Nothing but one number a trial is known, and every number costs a whole simulation. So candidates are screened on some
trials with a coarse time step, each at one size; the leaders are tried at other sizes there; the best of these are
simulated as the model says, on all trials. What comes out is a ranking and the fall of Delta_fitness; that something
outside the library is missing cannot be told from nothing by these data.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from btr_mjx.gap.effects import EFFECTS, Candidate, Effect, candidates
from btr_mjx.gap.fitness_only.diagnosis import ValuedCandidate, as_diagnosis
from btr_mjx.gap.fitness_only.screen import (
    COARSER,
    Answers,
    ScreenedCandidate,
    axes,
    coarse_step,
    leads,
    simulate_candidates,
)
from btr_mjx.gap.fitness_only.table import FitnessTable
from btr_mjx.gap.fitness_only.trials import TrialSimulator
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import Counter, World

SCREENED = 16
"""Trials on which all candidates are tried."""
NARROWED, AT_MOST = 10, 3
"""Leaders that are tried at other sizes, and how many of them may be of one kind."""
REFINED = 3
"""Leaders that are simulated as the model says, on all trials."""
FACTORS, FINE_FACTORS = (0.5, 1.0, 1.6), (0.8, 1.25)
"""Sizes that are tried, as factors on the one before: of leaders, and of the best one in the end."""


def identify_fitness(
    table: FitnessTable,
    effects: Sequence[Effect] = EFFECTS,
    progress: Callable[[str], None] | None = None,
    counter: Counter | None = None,
    known: Answers | None = None,
) -> Diagnosis:
    """Rank effects by how far they make Delta_fitness fall.

    Args:
      table: the trials.
      effects: the library.
      progress: called with a word on what is being done.
      counter: adds up the simulated steps; a `journal.Journal` remembers them for a search that goes on.
      known: what the candidates do, where it is known from another reality tried with the same controllers.

    Returns:
      A diagnosis; its verdict is "effect" or "none". Its gap is Delta_fitness on the held-out trials [m/s], its noise
      floor what half the time step alone changes.
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
    if known is None:
        rows = fit[:SCREENED]
        step = coarse_step(trials, rows, own[rows], wanted[rows])
        known = simulate_candidates(trials, candidates(model, trials.scales(fit[:3]), effects), rows, step, note)
    found = leads(known, wanted[known.rows])
    note("leaders at other sizes")
    narrowed = _narrow(trials, known, _pick(found), wanted)
    note("leaders on all trials")
    refined = _refine(trials, narrowed[:REFINED], fit)
    held_out = trials.fitness([t.apply(trials) for t in refined], test)
    ends = [_delta(row, table.fitness[test], trials) for row in held_out]
    half = trials.fitness([World.of(model)], test, 0.5 * float(model.opt.timestep))[0]
    floor = float(np.nanmean(np.abs(half - own[test])))
    tried = {t.candidate.name for t in narrowed}
    rest = [*narrowed[REFINED:], *_unrefined(found, tried, before[0])]
    return as_diagnosis(refined, ends, rest, before, floor, trials, time.monotonic() - begun)


def expected_steps(table: FitnessTable, effects: Sequence[Effect] = EFFECTS) -> float:
    """How many steps a search takes, roughly."""
    trials = TrialSimulator(table)
    model, fit = table.head.model, np.flatnonzero(~table.test)
    worlds = sum(2 * len(axes(c)) - 1 for c in candidates(model, trials.scales(fit[:3]), effects))
    per_trial = table.duration / float(model.opt.timestep)
    screened = min(SCREENED, len(fit)) / COARSER[0] * (worlds + NARROWED * len(FACTORS))
    return per_trial * (screened + len(fit) * (REFINED + len(FINE_FACTORS)) + 3 * len(table.fitness))


def _delta(fitness: np.ndarray, real: np.ndarray, trials: TrialSimulator) -> float:
    """Delta_fitness; a diverged trial counts as the whole spread of fitness."""
    worst = float(np.ptp(trials.table.fitness)) + 1e-12
    return float(np.nan_to_num(np.abs(fitness - real), nan=worst).mean())


def _pick(found: Sequence[ScreenedCandidate]) -> list[ScreenedCandidate]:
    """The best leads, not too many of one kind: where it sits is harder to tell than what it is."""
    out: list[ScreenedCandidate] = []
    for lead in found:
        same = sum(lead.candidate.effect.name == other.candidate.effect.name for other in out)
        if same < AT_MOST and len(out) < NARROWED and not np.array_equal(lead.values, lead.candidate.null):
            out.append(lead)
    return out


def _narrow(
    trials: TrialSimulator, known: Answers, chosen: Sequence[ScreenedCandidate], wanted: np.ndarray
) -> list[ValuedCandidate]:
    """Leads at the best of some sizes, best first, with the time step and the trials of the screening.

    What the coarser time step does to the believed model is taken out of what it does to a candidate.
    """
    tries = [
        ValuedCandidate(lead.candidate, v) for lead in chosen for v in _sizes(lead.candidate, lead.values, FACTORS)
    ]
    worlds = [t.apply(trials) for t in tries]
    change = trials.fitness(worlds, known.rows, known.timestep) - known.believed
    return _best([t.judged(_delta(row, wanted[known.rows], trials)) for t, row in zip(tries, change, strict=True)])


def _refine(trials: TrialSimulator, leaders: Sequence[ValuedCandidate], fit: np.ndarray) -> list[ValuedCandidate]:
    """Leaders, best first, simulated as the model says on all trials to fit; the best one at more sizes."""

    def judged(tries: Sequence[ValuedCandidate]) -> list[ValuedCandidate]:
        found = trials.fitness([t.apply(trials) for t in tries], fit)
        real = trials.table.fitness[fit]
        return [t.judged(_delta(row, real, trials)) for t, row in zip(tries, found, strict=True)]

    first = _best(judged(leaders))
    more = [ValuedCandidate(first[0].candidate, v) for v in _sizes(first[0].candidate, first[0].values, FINE_FACTORS)]
    return _best([*first, *judged(more)])


def _sizes(candidate: Candidate, values: Sequence[float] | np.ndarray, factors: Sequence[float]) -> list[tuple]:
    """Values with other sizes, within their bounds, each once."""
    out: dict[tuple, None] = {}
    for factor in factors:
        own = list(map(float, values))
        for axis in axes(candidate):
            p = candidate.parameters[axis]
            own[axis] = float(np.clip(p.null + factor * (own[axis] - p.null), p.low, p.high))
        out[tuple(own)] = None
    return list(out)


def _best(tries: Sequence[ValuedCandidate]) -> list[ValuedCandidate]:
    """The best try of each candidate, best first."""
    out: dict[str, ValuedCandidate] = {}
    for t in sorted(tries, key=lambda t: t.delta):
        out.setdefault(t.candidate.name, t)
    return list(out.values())


def _unrefined(found: Sequence[ScreenedCandidate], tried: set[str], before: float) -> list[ValuedCandidate]:
    """Candidates that were screened only, with the Delta_fitness that the screening makes one expect."""
    return [
        ValuedCandidate(o.candidate, tuple(o.values), before * float(np.sqrt(max(0.0, 1.0 - o.explained))))
        for o in found
        if o.candidate.name not in tried
    ]
