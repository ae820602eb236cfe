"""The three steps of Back-to-Reality, one by one and together, on tiny sizes."""

import dataclasses
from typing import Literal

import numpy as np
import pytest

from btr_mjx.backtoreality import (
    BTRSettings,
    Problem,
    SearchSettings,
    SimulatedReality,
    State,
    select_transferable,
)
from btr_mjx.backtoreality import algorithm as btr
from btr_mjx.backtoreality.run_state import Trials, state_from_arrays, state_to_arrays
from btr_mjx.backtoreality.simulation_search import delta_of_simulations
from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS, evaluate, fitness_of, multiscale_fitness
from btr_mjx.robots import Robot

SETTINGS = BTRSettings(
    controllers=8,
    controller_generations=2,
    trials=3,
    simulations=6,
    simulation_generations=2,
    iterations=2,
    behaviours="latest",
)


class Counting:
    """A reality that remembers what was asked of it."""

    def __init__(self, inner: SimulatedReality) -> None:
        self.inner, self.calls = inner, []

    def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
        self.calls.append((trial, np.array(controllers)))
        return self.inner.measure(controllers, trial, times)


@pytest.fixture
def problem(robot: Robot) -> Problem:
    truth = robot.nominal_simulation
    truth[[2, 11]] = 0.88, 1.6
    reality = Counting(SimulatedReality(robot, tuple(truth.tolist()), "native"))
    start = robot.nominal_simulation
    return Problem(robot, reality, ("bl_5", "bl_14"), start, SETTINGS, fitness_of(robot), engine="native", seed=3)


def run(problem: Problem) -> tuple[State, dict[str, list[dict]]]:
    rows: dict[str, list[dict]] = {"generation": [], "iteration": [], "archive": [], "planned": []}
    return btr.run_in_memory(problem, lambda kind, row: rows[kind].append(row)), rows


def test_the_loop_counts_every_evaluation_in_reality(problem: Problem) -> None:
    state, rows = run(problem)
    assert state.phase == "done"
    assert state.stop == "iterations"
    tried = [len(controllers) for _, controllers in problem.reality.calls]
    assert tried == [1, 3, 3]
    assert len(state.trials) == 7
    assert [trial for trial, _ in problem.reality.calls] == [0, 1, 4]
    assert state.trials.iteration.tolist() == [0, 1, 1, 1, 2, 2, 2]
    assert [(r["phase"], r["generation"]) for r in rows["generation"]] == [
        (phase, g) for _ in range(2) for phase in ("controllers", "simulations") for g in (1, 2)
    ]
    assert [r["iteration"] for r in rows["iteration"]] == [1, 2]


@pytest.mark.parametrize("first", ["random", "mutants"])
def test_the_population_with_which_step_1_begins(problem: Problem, first: Literal["random", "mutants"]) -> None:
    settings = dataclasses.replace(SETTINGS, first_population=first)
    state, rows = run(dataclasses.replace(problem, settings=settings))
    populations = [row["genomes"][0] for row in rows["archive"] if row["phase"] == "controllers"]
    best = 1 + int(np.argmax(state.trials.f_r[1:4]))
    flipped = [(0.5, 0.05) if first == "random" else (settings.p_m, 0.015), (settings.p_m, 0.015)]
    for population, row, (share, error) in zip(populations, (0, best), flipped, strict=True):
        own = problem.controller_box.decode(population[0])
        np.testing.assert_array_equal(own, state.trials.controllers[row])
        assert (population[1:] != population[0]).mean() == pytest.approx(share, abs=error)


def test_step_1_takes_the_mean_over_simulations_that_are_possible(problem: Problem) -> None:
    problem = dataclasses.replace(problem, settings=dataclasses.replace(SETTINGS, ensemble=4, optimiser="cma"))
    first = btr.begin(problem)
    state, rows = run(problem)
    archive = rows["archive"][0]
    for genome, score in zip(archive["genomes"][1], archive["scores"][1], strict=True):
        controller = problem.controller_box.decode(genome[None])
        alone = [evaluate(problem.robot, [own], controller, engine="native").fitness[0, 0] for own in first.ensemble]
        assert score == pytest.approx(np.mean(alone), rel=1e-12)
    box, unknown = problem.robot.simulation_box, problem.robot.simulation_box.indices(problem.unknown)
    for now, best in ((first, problem.start), (state, state.simulation)):
        np.testing.assert_array_equal(now.ensemble[0], best)
        np.testing.assert_array_equal(np.delete(now.ensemble, unknown, 1), np.delete(np.tile(best, (4, 1)), unknown, 1))
        assert len(np.unique(box.validate(now.ensemble, "ensemble"), axis=0)) == 4


def test_step_2_tries_the_best_of_the_last_generation(problem: Problem) -> None:
    state, rows = run(problem)
    last = rows["archive"][0]
    assert last["phase"] == "controllers"
    order = np.argsort(-last["scores"][-1], kind="stable")
    distinct = list(dict.fromkeys(last["genomes"][-1][i].tobytes() for i in order))[:3]
    expected = problem.controller_box.decode([np.frombuffer(g, bool) for g in distinct])
    np.testing.assert_array_equal(state.trials.controllers[1:4], expected)
    # f_s is their fitness in s_0, f_r in the hidden simulation: both again, from scratch.
    tried = state.trials.controllers[1:4]
    s_0, s_r = problem.start, problem.reality.inner.truth
    np.testing.assert_array_equal(
        evaluate(problem.robot, s_0, tried, engine="native").fitness[0], state.trials.f_s[1:4]
    )
    np.testing.assert_array_equal(
        evaluate(problem.robot, [s_r], tried, engine="native").fitness[0], state.trials.f_r[1:4]
    )


def test_step_3_scores_are_delta_fitness(problem: Problem) -> None:
    state, rows = run(problem)
    archive = rows["archive"][1]
    assert archive["phase"] == "simulations"
    chosen = problem.embed(problem.simulation_box.decode(archive["genomes"][1]))
    tried, f_r = state.trials.controllers[1:4], state.trials.f_r[1:4]
    by_hand = []
    for simulation in chosen:
        differences = 0.0
        for controller, real in zip(tried, f_r, strict=True):
            alone = evaluate(problem.robot, [simulation], [controller], engine="native")
            differences += abs(alone.fitness[0, 0] - real)
        by_hand.append(differences / 3)
    np.testing.assert_allclose(archive["scores"][1], by_hand, rtol=1e-12)
    assert rows["iteration"][0]["delta_after"] == pytest.approx(archive["scores"].min())
    assert rows["iteration"][0]["delta_after"] <= rows["iteration"][0]["delta_before"]
    # Only the unknown lengths moved.
    known = [i for i in range(12) if i not in (2, 11)]
    np.testing.assert_array_equal(state.simulation[known], problem.start[known])


def test_the_truth_as_start_is_kept(problem: Problem) -> None:
    """With s_0 = s_r, Delta_fitness is exactly zero from the first iteration on (Theorem 2)."""
    knowing = dataclasses.replace(problem, start=np.array(problem.reality.inner.truth))
    state, rows = run(knowing)
    assert [r["delta_before"] for r in rows["iteration"]] == [0.0, 0.0]
    np.testing.assert_array_equal(state.simulation, problem.reality.inner.truth)


@pytest.mark.parametrize("optimiser", ["ga", "cma"])
def test_resuming_after_any_piece_gives_the_same_end(problem: Problem, optimiser: Literal["ga", "cma"]) -> None:
    problem = dataclasses.replace(problem, settings=dataclasses.replace(SETTINGS, optimiser=optimiser, ensemble=2))
    whole, rows = run(problem)
    state, again = btr.begin(problem), []
    while state.phase != "done":
        state = btr.advance(problem, state, lambda kind, row: again.append(row) if kind == "generation" else None)
        state = state_from_arrays(*state_to_arrays(state))
    for name, array in state_to_arrays(whole)[0].items():
        np.testing.assert_array_equal(array, state_to_arrays(state)[0][name])
    assert again == rows["generation"]


def test_stop_on_evaluations_and_on_delta(problem: Problem) -> None:
    few = dataclasses.replace(problem, settings=dataclasses.replace(SETTINGS, iterations=9, max_evaluations=8))
    state, _ = run(few)
    assert (state.stop, len(state.trials)) == ("max_evaluations", 7)
    easy = dataclasses.replace(problem, settings=dataclasses.replace(SETTINGS, iterations=9, target_delta=1e9))
    state, _ = run(easy)
    assert (state.stop, state.iteration) == ("target_delta", 1)


def test_all_behaviours_or_the_latest(problem: Problem) -> None:
    state, _ = run(problem)
    both = dataclasses.replace(problem, settings=dataclasses.replace(SETTINGS, behaviours="all"))
    s = problem.start[None]
    latest, everything = (delta_of_simulations(p, s, state.trials, 2)[0] for p in (problem, both))
    f = evaluate(problem.robot, s, state.trials.controllers, engine="native").fitness[0]
    differences = np.abs(f - state.trials.f_r)
    assert latest == pytest.approx(differences[4:].mean(), rel=1e-12)
    assert everything == pytest.approx(differences[1:].mean(), rel=1e-12)


def test_failed_trials_are_left_out_and_never_best(problem: Problem) -> None:
    class Breaks:
        def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
            values = problem.reality.inner.measure(controllers, trial, times)
            values[0] = np.nan
            return values

    broken = dataclasses.replace(problem, reality=Breaks())
    state, rows = run(broken)
    assert np.isnan(state.trials.f_r[[0, 1, 4]]).all()
    assert all(np.isfinite(r["delta_after"]) and np.isfinite(r["f_r_best"]) for r in rows["iteration"])

    class Dead:
        def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
            return np.full((len(controllers), len(times)), np.nan)

    with pytest.raises(InputError, match="all 3 trials in reality failed"):
        run(dataclasses.replace(problem, reality=Dead()))


def test_minimised_fitness(problem: Problem) -> None:
    cost = FITNESS_FUNCTIONS["energy_per_metre"]
    reality = dataclasses.replace(problem.reality.inner, fitness=cost)
    state, rows = run(dataclasses.replace(problem, fitness=cost, reality=reality))
    first = next(r for r in rows["generation"] if r["phase"] == "controllers")
    assert first["best"] <= first["mean"] <= first["worst"]
    assert rows["iteration"][-1]["f_r_best"] == np.nanmin(state.trials.f_r[state.trials.iteration == 2])


def genomes(*numbers: int) -> np.ndarray:
    return np.array([[bool(n >> i & 1) for i in range(6)] for n in numbers])


def test_fallback_to_earlier_generations() -> None:
    bits = np.stack([genomes(1, 2, 3, 4), genomes(5, 6, 7, 8), genomes(9, 10, 9, 11)])
    scores = np.array([[4.0, 3.0, 2.0, 1.0], [0.1, np.nan, 0.3, 0.2], [7.0, np.nan, 7.0, 5.0]])
    chosen, values = select_transferable(bits, scores, 4, maximise=True)
    # 9 and 11 of the last generation (10 diverged, the second 9 is the same controller), then 7 and 8.
    np.testing.assert_array_equal(chosen, genomes(9, 11, 7, 8))
    assert values.tolist() == [7.0, 5.0, 0.3, 0.2]
    chosen, values = select_transferable(bits, scores, 3, maximise=False)
    assert values.tolist() == [5.0, 7.0, 0.1]
    chosen, _ = select_transferable(bits[:1], np.full((1, 4), np.nan), 3, maximise=True)
    assert len(chosen) == 0


def test_nothing_transferable_is_said(problem: Problem) -> None:
    stuck = dataclasses.replace(problem, robot=dataclasses.replace(problem.robot, speed_limit=1e-9))
    with pytest.raises(InputError, match="every controller diverged"):
        run(stuck)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trials": 8}, "1 <= m < M"),
        ({"trials": 0}, "1 <= m < M"),
        ({"iterations": 0}, "iterations"),
        ({"max_evaluations": 3}, "at least 4"),
    ],
)
def test_bad_settings(change: dict, message: str, problem: Problem) -> None:
    settings = dataclasses.replace(SETTINGS, **change)
    with pytest.raises(InputError, match=message):
        dataclasses.replace(problem, settings=settings)


def test_bad_search_settings() -> None:
    with pytest.raises(InputError, match=r"p_m.*1\.5"):
        SearchSettings(8, 2, p_m=1.5)
    with pytest.raises(InputError, match="at least 2 and 1"):
        SearchSettings(1, 2)


def test_trials_grow() -> None:
    trials = Trials(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 1)), np.zeros(0), np.zeros(0, int))
    grown = trials.add(np.ones((3, 2)), np.arange(6.0).reshape(3, 2), np.zeros(3), 4)
    assert (grown.f_r.tolist(), grown.f_marks.tolist()) == ([1, 3, 5], [[0], [2], [4]])
    assert len(trials) == 0
    assert (len(grown), grown.iteration.tolist()) == (3, [4, 4, 4])


def test_noise_is_repeatable_and_per_trial(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    c = robot.controller_box.sample(rng, 4)
    clean = SimulatedReality(robot, robot.nominal, "native")
    noisy = dataclasses.replace(clean, noise=0.1, seed=5)
    together = noisy.measure(c, 10)
    apart = np.concatenate([noisy.measure(c[i : i + 1], 10 + i) for i in range(4)])
    np.testing.assert_array_equal(together, apart)
    np.testing.assert_array_equal(noisy.measure(c, 10, (0.01, 0.02, 0.03))[:, -1], together[:, 0])
    relative = together / clean.measure(c) - 1
    assert 0 < np.abs(relative).max() < 0.5
    assert not np.array_equal(noisy.measure(c, 11), together)


def test_multiscale_distance_in_step_3(problem: Problem) -> None:
    """The scores are multiscale_fitness of both sides measured from scratch; the truth has distance zero."""
    settings = dataclasses.replace(SETTINGS, distance="multiscale", marks=(0.01, 0.02))
    multiscale = dataclasses.replace(problem, settings=settings)
    state, rows = run(multiscale)
    archive = rows["archive"][1]
    tried = state.trials.controllers[1:4]
    s_r = np.array(problem.reality.inner.truth)

    def at(time: float, simulations: np.ndarray) -> np.ndarray:
        return evaluate(problem.robot, simulations, tried, engine="native", times=[time]).fitness

    simulations = problem.embed(problem.simulation_box.decode(archive["genomes"][0]))
    f_s = np.stack([at(0.01, simulations), at(0.02, simulations)], axis=-1)
    f_r = np.stack([at(0.01, s_r[None])[0], at(0.02, s_r[None])[0]], axis=-1)
    np.testing.assert_array_equal(state.trials.f_marks[1:4], f_r)
    np.testing.assert_array_equal(archive["scores"][0], multiscale_fitness(f_s, f_r))
    assert delta_of_simulations(multiscale, s_r[None], state.trials, 2) == 0.0


def test_cma_es_in_step_3(problem: Problem) -> None:
    """It finds both lengths from the behaviours of one iteration, and stops once it has converged."""
    settings = dataclasses.replace(
        SETTINGS, simulations=12, simulation_generations=80, iterations=1, optimiser="cma", distance="multiscale",
        marks=(0.01, 0.015, 0.02),
    )  # fmt: skip
    state, rows = run(dataclasses.replace(problem, settings=settings))
    found = rows["archive"][1]
    assert len(found["scores"]) < 80
    assert np.abs(state.simulation - problem.reality.inner.truth).max() < 1e-3
    few = dataclasses.replace(settings, simulation_generations=5)
    _, short = run(dataclasses.replace(problem, settings=few))
    np.testing.assert_array_equal(short["archive"][1]["genomes"], found["genomes"][:5])
    with pytest.raises(InputError, match="at least 4"):
        dataclasses.replace(problem, settings=dataclasses.replace(settings, simulations=3))


def test_marks_must_lie_within_the_trial(problem: Problem) -> None:
    for marks in ((0.01, 0.2), (0.02, 0.01), (0.0, 0.01)):
        settings = dataclasses.replace(SETTINGS, distance="multiscale", marks=marks)
        with pytest.raises(InputError, match="marks"):
            btr.begin(dataclasses.replace(problem, settings=settings))
