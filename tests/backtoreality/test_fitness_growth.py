"""A missing effect by fitness alone: found where it is, not where nothing is missing, and seeds that repeat."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from btr_mjx.backtoreality import CoevolveConfig, build_problem
from btr_mjx.backtoreality.algorithm import run_in_memory
from btr_mjx.backtoreality.fitness_growth import FitnessSearch, seek_by_fitness
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import growth_sentence
from btr_mjx.backtoreality.run_state import Problem, State, Trials
from btr_mjx.evaluation import delta_fitness_of, evaluate

EXAMPLES = Path(__file__).parents[2] / "examples"
SETTINGS = CoevolveConfig(
    robot=EXAMPLES / "thrower", engine="native", reality_engine="native", optimiser="cma", grow=True, max_effects=1
)


def measured(hidden: str, count: int = 30) -> tuple[Problem, State]:
    """Trials of random controllers of a thrower whose other parameters are known."""
    problem = build_problem(replace(SETTINGS, grow_from="fitness"))
    text = problem.robot.template
    assert '"shoulder" damping="0.3"' in text
    real = replace(
        problem.robot, template=text.replace('"shoulder" damping="0.3"', f'"shoulder" damping="0.3" {hidden}')
    )
    controllers = problem.robot.controller_box.sample(np.random.default_rng(0), count)
    f_r = evaluate(real, problem.start, controllers, fitness=problem.fitness, engine="native").fitness[0]
    trials = Trials(controllers, f_r, np.zeros((count, 0)), f_r, np.ones(count, int))
    return problem, State("growth", 1, problem.start, problem.start[None], np.zeros(0, bool), trials)


@pytest.fixture(scope="module")
def worn() -> tuple[Problem, State, FitnessSearch]:
    problem, state = measured('frictionloss="1.0"')
    return problem, state, seek_by_fitness(problem, state)


@pytest.mark.slow
def test_a_hidden_friction_is_found(worn: tuple[Problem, State, FitnessSearch]) -> None:
    problem, state, search = worn
    assert search.verdict == "effect"
    first = search.ranking[0]
    assert (first["effect"], first["location"]) == ("dry_friction", "joint:shoulder")
    assert first["numbers"]["torque"]["value"] == pytest.approx(1.0, rel=0.15)
    assert first["gap_after"] < 0.25 * first["gap_before"]
    # What is added is what is missing: with the true friction nothing is left of Delta_fitness.
    larger = grown(problem, [first])
    simulation = np.append(problem.start, 1.0)
    f_s = evaluate(larger.robot, simulation, state.trials.controllers, fitness=problem.fitness, engine="native").fitness
    assert delta_fitness_of(f_s[0], state.trials.f_r) < 1e-6


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result(worn: tuple[Problem, State, FitnessSearch]) -> None:
    problem, state, search = worn
    assert seek_by_fitness(problem, state) == search


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_missing_or_known() -> None:
    """Random errors of measurements are no effect, and a handful of trials says nothing."""
    problem, state = measured("")
    noise = 1 + 0.2 * np.random.default_rng(1).normal(size=len(state.trials))
    noisy = replace(state, trials=replace(state.trials, f_r=state.trials.f_r * noise))
    assert seek_by_fitness(problem, noisy).verdict == "none"
    few = measured('frictionloss="1.0"', count=8)
    assert seek_by_fitness(*few) == FitnessSearch("none", ())


@pytest.mark.slow
def test_a_run_grows_without_recordings() -> None:
    """A reality that does not record, whose unknown parameters are identified as well."""
    made = build_problem(replace(SETTINGS, iterations=1, trials=10, controllers=12, controller_generations=2))
    text = made.robot.template.replace('"shoulder" damping="0.3"', '"shoulder" damping="0.3" frictionloss="1.0"')
    hidden = replace(made.reality, robot=replace(made.robot, template=text))

    class Silent:
        def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
            return hidden.measure(controllers, trial, times)

    state = run_in_memory(replace(made, reality=Silent()))
    (row,) = [row for row in state.sought if row["verdict"] != "within calibration"]
    assert row["from"] == "fitness"
    assert row["added"] == ["dry_friction@joint:shoulder"]
    assert "now part of the simulator" in growth_sentence(row)
    none = growth_sentence(row | {"added": [], "verdict": "none"})
    assert none.endswith("by fitness alone says none")
