"""The missing effect by fitness alone, where reality gives no recordings: which one lets Delta_fitness fall most?

Every candidate is simulated on all trials, once or twice, at a size that shows; so is a change of every unknown
parameter. With w (M,) the measured less the simulated fitness, d (M, p) the changes by the candidate and e (M, n) those
by the parameters, the candidate's promise is the residual of

    min over a >= 0, b of  |w - d a - e b|^2

The most promising candidates, and the simulator without any, then compete: a short step 3 each in the space with its
numbers, half of them leaving after every round. Every third trial is held out, and an effect is named if Delta_fitness
falls on both parts, on the second by more than two standard errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from btr_mjx.backtoreality.grown import grown, number_name
from btr_mjx.backtoreality.run_state import Problem, State
from btr_mjx.evaluation import evaluate
from btr_mjx.gap.effects import EFFECTS, Candidate, Scales, candidates
from btr_mjx.gap.results import FoundEffect
from btr_mjx.models import general_model
from btr_mjx.optimise import cma_es

LEAST_FALL = 0.25
"""Relative fall of Delta_fitness that a name needs on either part of the trials, against the simulator without it."""

_SHOWING = 8.0
"""Size at which a candidate is simulated, in steps of its parameter (`gap.effects.Parameter.step`)."""

_PARAMETER_STEP = 0.04
"""Change of an unknown parameter, as a share of its range."""

_LEADERS, _PER_EFFECT = 8, 2
"""Candidates that compete, and how many of them may be the same effect at different places."""

_ROUNDS = ((1.0, 6), (0.5, 6), (0.25, 12))
"""Share of the candidates that take part in a round, and its generations."""

_POPULATION, _SIGMA = 10, 0.1
"""Simulations of a generation, and the step size of CMA-ES, as a share of each range."""

_LEAST_TRIALS = 9
"""Trials without which nothing is sought."""


@dataclass(frozen=True)
class FitnessSearch:
    """Result of a search by fitness.

    Attributes:
      verdict: "effect" or "none".
      ranking: entries of `State.grown`, best first; their `gap_before` and `gap_after` are Delta_fitness of held-out
        trials.
    """

    verdict: str
    ranking: tuple[dict[str, Any], ...]


@dataclass(eq=False)
class _Competitor:
    """The simulator with one more effect, or as it is, and its own step 3."""

    entry: dict[str, Any] | None
    problem: Problem
    start: np.ndarray
    members: list[np.ndarray] = field(default_factory=list)
    scores: list[np.ndarray] = field(default_factory=list)
    delta: float = np.inf


def seek_by_fitness(problem: Problem, state: State, proposed: Sequence[FoundEffect] = ()) -> FitnessSearch:
    """Find the effect with which Delta_fitness falls most; nothing is sought in fewer than nine trials.

    Proposed effects compete with their values; without any, the most promising ones of the library do.
    """
    rows = np.flatnonzero(np.isfinite(state.trials.f_r))
    if len(rows) < _LEAST_TRIALS:
        return FitnessSearch("none", ())
    controllers, real = state.trials.controllers[rows], state.trials.f_r[rows]
    test = np.arange(len(rows)) % 3 == 2
    competitors = [_Competitor(None, problem, state.simulation)]
    leaders = _resolved(problem, state.simulation, controllers[~test], proposed)
    leaders = leaders or _promising(problem, state.simulation, controllers[~test], real[~test])
    competitors += [_competitor(problem, state.simulation, *leader) for leader in leaders]
    for number, (share, generations) in enumerate(_ROUNDS):
        plain, *others = competitors
        others = sorted(others, key=lambda c: c.delta)[: max(1, round(share * len(others)))]
        for place, competitor in enumerate([plain, *others]):
            for _ in range(generations):
                seed = [problem.seed, state.iteration, 5, number, place, len(competitor.scores)]
                _generation(competitor, controllers[~test], real[~test], seed)
        competitors = [plain, *others, *[c for c in competitors[1:] if c not in others]]
    plain, *others = competitors
    others.sort(key=lambda c: c.delta)
    competitors = [plain, *others]
    held_out = [np.abs(_fitness(c.problem, _best(c)[None], controllers[test])[0] - real[test]) for c in competitors]
    before = held_out[0]
    ranking = [
        _entry(c, state.iteration, float(before.mean()), float(own.mean()))
        for c, own in zip(others, held_out[1:], strict=True)
    ]
    named = bool(others) and others[0].delta <= (1 - LEAST_FALL) * plain.delta and _falls(before, held_out[1])
    return FitnessSearch("effect" if named else "none", tuple(ranking))


def _falls(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether delta_k of held-out trials (M,) falls enough in the mean, by more than two standard errors."""
    fall = before - after
    error = fall.std(ddof=1) / np.sqrt(len(fall))
    return bool(fall.mean() >= max(LEAST_FALL * before.mean(), 2 * error))


def _resolved(
    problem: Problem, simulation: np.ndarray, controllers: np.ndarray, proposed: Sequence[FoundEffect]
) -> list[tuple[Candidate, np.ndarray]]:
    """Candidates and sizes of proposed effects."""
    if not proposed:
        return []
    model, scales = general_model(problem.robot, simulation), _scales(problem, simulation, controllers[:4])
    known = {(c.effect.name, c.place.label): c for c in candidates(model, scales, EFFECTS)}
    chosen = [(known[item.effect, item.location], item) for item in proposed if (item.effect, item.location) in known]
    return [(one, np.array([item.values[p.name] for p in one.parameters]) - one.null) for one, item in chosen]


def _competitor(problem: Problem, simulation: np.ndarray, candidate: Candidate, size: np.ndarray) -> _Competitor:
    entry = _as_entry(candidate, size)
    start = np.concatenate([simulation, [number["value"] for number in entry["numbers"].values()]])
    return _Competitor(entry, grown(problem, [entry]), start)


def _promising(
    problem: Problem, simulation: np.ndarray, controllers: np.ndarray, real: np.ndarray
) -> list[tuple[Candidate, np.ndarray]]:
    """The most promising candidates, best first, with their fitted sizes."""
    robot, box = problem.robot, problem.robot.simulation_box
    own = _fitness(problem, simulation[None], controllers)[0]
    wanted = np.nan_to_num(real - own)
    beside = np.tile(simulation, (len(problem.unknown), 1))
    for row, i in enumerate(box.indices(problem.unknown)):
        step = _PARAMETER_STEP * (box.high[i] - box.low[i])
        beside[row, i] += step if simulation[i] + step <= box.high[i] else -step
    by_parameters = np.nan_to_num(_fitness(problem, beside, controllers) - own)
    model, found = general_model(robot, simulation), []
    for candidate in candidates(model, _scales(problem, simulation, controllers[:4]), EFFECTS):
        # One fitness a trial does not tell the members of a group apart.
        if candidate.place.parts or _named(candidate) & set(box.names):
            continue
        tried = _sizes(candidate)
        larger = grown(problem, [_as_entry(candidate, tried[0])])
        rows = np.concatenate([np.tile(simulation, (len(tried), 1)), candidate.null + tried], axis=1)
        change = np.nan_to_num(_fitness(larger, rows, controllers) - own)
        share, left = scipy.optimize.nnls(np.concatenate([change, by_parameters, -by_parameters]).T, wanted)
        size = share[: len(tried)] @ tried
        if size.any():
            found.append((left, candidate, size))
    found.sort(key=lambda item: item[0])
    leaders, kinds = list[tuple[Candidate, np.ndarray]](), dict[str, int]()
    for _, candidate, size in found:
        name = candidate.effect.name
        kinds[name] = kinds.get(name, 0) + 1
        if kinds[name] <= _PER_EFFECT and len(leaders) < _LEADERS:
            leaders.append((candidate, size))
    return leaders


def _named(candidate: Candidate) -> set[str]:
    """Names of its numbers in S, see `grown`."""
    return {number_name(candidate.effect.name, candidate.place.label, p.name) for p in candidate.parameters}


def _sizes(candidate: Candidate) -> np.ndarray:
    """Differences (q, p) from the null at which a candidate is simulated: both ways where both are possible."""
    out = []
    for axis, parameter in enumerate(candidate.parameters):
        for size in (_SHOWING, -_SHOWING):
            value = float(np.clip(parameter.null + size * parameter.step, parameter.low, parameter.high))
            if value != parameter.null and not (axis and parameter.shape):
                row = np.zeros(len(candidate.parameters))
                row[axis] = value - parameter.null
                out.append(row)
    return np.array(out)


def _as_entry(candidate: Candidate, size: np.ndarray) -> dict[str, Any]:
    """A candidate at its null plus a size (p,) as an entry of `State.grown`; bounds include what is simulated."""
    numbers = {}
    for parameter, difference in zip(candidate.parameters, size.tolist(), strict=True):
        value = float(np.clip(parameter.null + difference, parameter.low, parameter.high))
        reach = np.inf if parameter.shape else max(3 * abs(difference), 1.001 * _SHOWING * abs(parameter.step))
        numbers[parameter.name] = {
            "value": value,
            "low": max(parameter.low, parameter.null - reach),
            "high": min(parameter.high, parameter.null + reach),
            "null": parameter.null,
            "unit": parameter.unit,
        }
    return {"effect": candidate.effect.name, "location": candidate.place.label, "numbers": numbers}


def _generation(competitor: _Competitor, controllers: np.ndarray, real: np.ndarray, seed: Sequence[int]) -> None:
    """One generation of a competitor's step 3."""
    box = competitor.problem.simulation_box
    start = competitor.start[competitor.problem.robot.simulation_box.indices(competitor.problem.unknown)]
    told = np.array(competitor.members).reshape(-1, _POPULATION, box.n)
    strategy = cma_es.restored(
        np.clip((start - box.low) / box.span, 0, 1),
        told,
        np.array(competitor.scores).reshape(-1, _POPULATION),
        population=_POPULATION,
        sigma=_SIGMA,
    )
    asked = np.clip(cma_es.ask(strategy, list(seed)), 0, 1)
    if not len(told):
        asked[0] = (start - box.low) / box.span
    found = _fitness(competitor.problem, _embedded(competitor, asked), controllers)
    scores = np.abs(found - real).mean(axis=1)
    competitor.members.append(asked)
    competitor.scores.append(scores)
    competitor.delta = min(competitor.delta, float(np.nanmin(np.append(scores, np.inf))))


def _embedded(competitor: _Competitor, members: np.ndarray) -> np.ndarray:
    """Simulations (L, n_s) of members of the unit cube."""
    problem = competitor.problem
    values = problem.simulation_box.low + problem.simulation_box.span * members
    return problem.robot.simulation_box.embed(competitor.start, problem.unknown, values)


def _best(competitor: _Competitor) -> np.ndarray:
    """The best simulation (n_s,) so far."""
    scores = np.concatenate(competitor.scores)
    row = int(np.argmin(np.where(np.isfinite(scores), scores, np.inf)))
    return _embedded(competitor, np.concatenate(competitor.members)[row])


def _entry(competitor: _Competitor, iteration: int, before: float, after: float) -> dict[str, Any]:
    """A competitor as an entry of `State.grown`. Fitness gives no intervals: bounds are those of the competition."""
    assert competitor.entry is not None
    values = _best(competitor)[-len(competitor.entry["numbers"]) :].tolist()
    numbers = {
        name: number | {"value": value}
        for (name, number), value in zip(competitor.entry["numbers"].items(), values, strict=True)
    }
    about = {"iteration": iteration, "gap_before": before, "gap_after": after}
    return competitor.entry | {"numbers": numbers} | about


def _fitness(problem: Problem, simulations: np.ndarray, controllers: np.ndarray) -> np.ndarray:
    """Fitness (L, M); in native MuJoCo, since every candidate would be another program to compile."""
    return evaluate(
        problem.robot,
        simulations,
        controllers,
        fitness=problem.fitness,
        engine="native",
        progress=problem.progress,
    ).fitness


def _scales(problem: Problem, simulation: np.ndarray, controllers: np.ndarray) -> Scales:
    """Scales of torques, speeds and travel in some trials of the simulation."""
    robot = problem.robot
    times = np.linspace(0, robot.duration, 101)[1:]
    how: dict[str, Any] = {"engine": "native", "fitness": problem.fitness, "times": times, "states": True}
    out = evaluate(robot, simulation, controllers, **how).outcome
    assert out.qpos is not None
    assert out.qvel is not None
    columns = np.ascontiguousarray(controllers.T)
    control = np.stack([robot.signal(columns, t, np).T for t in times], axis=1)  # (M, K, nu)
    flat = [values.reshape(-1, values.shape[-1]) for values in (out.qpos[0], out.qvel[0], control)]
    good = np.isfinite(flat[0]).all(axis=1)
    return Scales.measured(general_model(robot, simulation), *(values[good] for values in flat))
