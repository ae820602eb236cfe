"""What trials tell of unknown numbers: closed forms where fitness is linear, and true values within intervals."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from btr_mjx.backtoreality import CoevolveConfig, Problem, build_problem
from btr_mjx.backtoreality.run_state import Trials
from btr_mjx.backtoreality.told_words import told_by_plan, told_record, told_sentence
from btr_mjx.backtoreality.trial_information import fitness_slopes, informative, told_by, told_by_trials
from btr_mjx.evaluation import FitnessFunction, Outcome
from btr_mjx.robots import Pairs, Robot

THROWER = Path(__file__).parents[2] / "examples" / "thrower"
LOW, SPAN = np.array([0.05, 0.0]), np.array([0.55, 1.0])


@dataclass(frozen=True)
class Parabola:
    """The first joint's position is a parabola in the numbers: `slope` of the first two controller parameters."""

    bend: float = 0.0
    same: bool = False

    def __call__(self, robot: Robot, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        s, c = pairs.simulations[pairs.index], pairs.controllers[:, :2]
        weight = c[:, :1] * [1.0, 0.5] if self.same else c
        value = (weight * s).sum(1) + self.bend * s[:, 0] ** 2
        qpos = np.tile(value[:, None, None], (1, len(pairs.times), pairs.models[0].nq))
        return qpos, np.zeros((*qpos.shape[:2], pairs.models[0].nv))


def first_joint(outcome: Outcome) -> np.ndarray:
    assert outcome.qpos is not None
    return outcome.qpos[..., -1, 0]


def problem(simulator: Parabola) -> Problem:
    made = build_problem(CoevolveConfig(robot=THROWER, engine="native", reality_engine="native"))
    fitness = FitnessFunction("first joint", "rad", True, first_joint, needs_states=True)
    return replace(made, robot=replace(made.robot, simulator=simulator), fitness=fitness, engine=None)


def trials_of(made: Problem, truth: np.ndarray, count: int, noise: float = 0.0) -> Trials:
    rng = np.random.default_rng(1)
    controllers = made.controller_box.sample(rng, count)
    f_r = made.simulate(truth[None], controllers)[0] + noise * rng.standard_normal(count)
    return Trials(controllers, f_r, np.zeros((count, 0)), f_r, np.ones(count, int))


@dataclass(frozen=True)
class Measured:
    """A reality that is a simulation, and knows the scatter of its measurements."""

    problem: Problem
    simulation: np.ndarray
    noise: float

    def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
        rng = np.random.default_rng(trial)
        exact = self.problem.simulate(self.simulation[None], controllers)[0]
        return (exact + self.noise * rng.standard_normal(len(exact)))[:, None]


@pytest.mark.parametrize("at", [[0.3, 0.4], [0.05, 1.0], [0.6, 0.02]])
def test_slopes_of_a_straight_line(at: list[float]) -> None:
    """At bounds as well, where draws are mirrored."""
    made = problem(Parabola())
    shares, controllers = (np.array(at) - LOW) / SPAN, trials_of(made, np.array(at), 5).controllers
    found = fitness_slopes(made, shares, np.array([[0.08, 0.02], [0.02, 0.01]]), controllers, np.ones(5), 0)
    np.testing.assert_allclose(found.slopes, controllers[:, :2] * SPAN, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.rough, 0.0, atol=1e-20)


def test_slopes_of_a_parabola() -> None:
    """Those at its centre: draws come in pairs. Their covariance is that of least squares with the wanted one."""
    made, at, covariance = problem(Parabola(bend=2.0)), np.array([0.3, 0.4]), np.diag([4e-4, 9e-4])
    controllers, weight = trials_of(made, at, 5).controllers, np.linspace(1, 2, 5)
    found = fitness_slopes(made, (at - LOW) / SPAN, covariance, controllers, weight, 0)
    expected = (controllers[:, :2] + [4.0 * at[0], 0.0]) * SPAN * weight[:, None]
    np.testing.assert_allclose(found.slopes, expected, rtol=1e-8)
    assert found.rough > 0
    np.testing.assert_allclose(found.gain, np.linalg.inv(6 * covariance), rtol=1e-8, atol=1e-9)


def test_intervals_of_linear_fitness_are_the_closed_form() -> None:
    """The posterior of a linear model with known noise, and a prior of the variance of the range."""
    truth, at, noise = np.array([0.2, 0.3]), np.array([0.25, 0.35]), 0.02
    made = problem(Parabola())
    made = replace(made, reality=Measured(made, truth, noise))
    trials = trials_of(made, truth, 12, noise)
    design = trials.controllers[:, :2]
    covariance = np.linalg.inv(design.T @ design / noise**2 + np.diag(12 / SPAN**2))
    mean = covariance @ (design.T @ trials.f_r / noise**2 + 12 / SPAN**2 * (LOW + SPAN / 2))
    reach = 1.6448536 * np.sqrt(np.diag(covariance))
    # A simulation as good as the best: one that residuals tell to be wrong counts as one that lacks something.
    found = told_by_trials(made, mean, trials, 1)
    told = told_record(found, made.simulation_box)
    for name, low, high in zip(made.unknown, mean - reach, mean + reach, strict=True):
        np.testing.assert_allclose(told["intervals"][name], [low, high], rtol=1e-6)
    assert told["told"] == list(made.unknown)
    possible = LOW + SPAN * found.possible(np.random.default_rng(0), 20000)
    np.testing.assert_allclose(possible.mean(0), mean, atol=0.05 * noise)
    np.testing.assert_allclose(np.cov(possible.T), covariance, rtol=0.1)
    beside = told_record(told_by_trials(made, at, trials, 1), made.simulation_box)
    lows, highs = np.array(list(beside["intervals"].values())).T
    assert (lows <= np.minimum(at, truth)).all()
    assert (highs >= np.maximum(at, truth)).all()


def test_only_the_sum_of_two_numbers_is_told() -> None:
    made, at = problem(Parabola(same=True)), np.array([0.3, 0.5])
    told = told_record(told_by_trials(made, at, trials_of(made, at, 8), 1), made.simulation_box)
    assert told["told"] == []
    assert told["combinations"] == ["only ball mass + 0.5 × elbow damping is told"]
    for name, low, span in zip(made.unknown, LOW, SPAN, strict=True):
        np.testing.assert_allclose(told["intervals"][name], [low, low + span])
    text = told_sentence(told, made.simulation_box)
    assert text.startswith("told by the trials (90 %): nothing; not told: ball mass, elbow damping; only")
    controllers = trials_of(made, at, 8).controllers
    assert "can tell no unknown number; only ball mass + 0.5 ×" in told_by_plan(made, at, controllers)
    assert "can tell ball mass and elbow damping" in told_by_plan(problem(Parabola()), at, controllers)


def test_bent_fitness_is_told_as_its_slope_at_the_truth_tells_it() -> None:
    """Over the whole range the fitness is no straight line; near the truth it is, and residuals are small there."""
    made, truth = problem(Parabola(bend=-2.0)), np.array([0.2, 0.3])
    trials = trials_of(made, truth, 12)
    at = truth + np.array([2e-4, -1e-4])
    error = made.simulate(at[None], trials.controllers)[0] - trials.f_r
    design = (trials.controllers[:, :2] + [-4.0 * truth[0], 0.0]) * SPAN
    variance = 12 * (error @ error) / (12 - 2)  # of an error that all trials share
    reach = 1.6448536 * np.sqrt(np.diag(np.linalg.inv(design.T @ design / variance + 12 * np.eye(2))))
    found = told_by_trials(made, at, trials, 1)
    np.testing.assert_allclose(found.reach, reach, rtol=0.02)
    np.testing.assert_allclose(found.estimate, (truth - LOW) / SPAN, atol=0.05 * reach.min())


def test_another_valley_is_possible() -> None:
    """A simulation far away that fits as well is within the interval, one that fits four times worse is not."""
    made, at = problem(Parabola()), np.array([0.3, 0.5])
    trials = trials_of(made, at, 12)
    measured = trials.f_r + 0.01 * np.random.default_rng(0).standard_normal(12)
    found = told_by(made, at, trials.controllers, measured)
    assert found.told.all()
    others = found.at + np.array([[0.3, 0.2], [-0.3, -0.2], [0.0, 0.45]])
    beside = found.beside(others, np.array([0.011, 0.04, np.nan]), 0.01)
    np.testing.assert_allclose(beside.interval[0], found.interval[0])
    np.testing.assert_allclose(beside.interval[1], others[0])


def test_a_combination_that_another_valley_changes_is_not_told() -> None:
    """Only the sum is told; of a simulation that fits as well, it is the same, of another one it is not."""
    made, at = problem(Parabola(same=True)), np.array([0.3, 0.5])
    found = replace(told_by_trials(made, at, trials_of(made, at, 8), 1), scatter=1.0)
    along = np.array([0.5, -SPAN[0]]) / np.hypot(0.5, SPAN[0])
    for step, count in ((along, 1), (along[::-1] * [-1, 1], 0)):
        other = found.beside(found.at + 0.45 * np.array([step, -step]), np.array([0.1, 0.1]), 0.1)
        assert not other.told.all()
        assert len(other.combinations()) == count


@pytest.mark.parametrize("shared", [False, True])
def test_true_numbers_are_within_their_intervals(shared: bool) -> None:
    """Linear fitness with noise, or with an error that all trials share as they share their controller's habits."""
    rng, made, within = np.random.default_rng(5), problem(Parabola()), []
    for _ in range(100):
        truth = LOW + SPAN * rng.uniform(0.2, 0.8, 2)
        at = truth + 0.01 * SPAN * rng.uniform(-1, 1, 2)
        controllers = made.controller_box.sample(rng, 15)
        controllers[:, :2] = rng.uniform(-1.2, 1.2, 2) + rng.uniform(-0.5, 0.5, (15, 2))
        error = 0.02 * (np.full(15, rng.standard_normal()) if shared else rng.standard_normal(15))
        measured = controllers[:, :2] @ truth + error
        low, high = LOW + SPAN * told_by(made, at, controllers, measured, 0.0 if shared else 0.02).interval
        within.append((low <= truth) & (truth <= high))
    assert np.mean(within) > 0.87


@dataclass(frozen=True)
class Rough(Parabola):
    """Fitness that depends on no number, but jumps with each."""

    def __call__(self, robot: Robot, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        qpos, qvel = super().__call__(robot, pairs)
        return np.sin(1e6 * qpos), qvel


def test_roughness_tells_nothing() -> None:
    """Its slopes are large, and not believed: for that it tells nothing, even of measurements without noise."""
    made, at = problem(Rough()), np.array([0.3, 0.5])
    trials, smooth = trials_of(made, at, 20), problem(Parabola())
    assert not told_by_trials(made, at, trials, 1).told.any()
    assert told_by_trials(smooth, at, trials_of(smooth, at, 20), 1).told.all()


def test_no_trials_tell_nothing() -> None:
    """The prior: its mean, and the variance of a number that may be anywhere."""
    made = problem(Parabola())
    found = told_by(made, np.array([0.3, 0.5]), trials_of(made, LOW, 1).controllers[:0])
    assert not found.told.any()
    np.testing.assert_allclose(found.covariance, np.eye(2) / 12)


def test_informative_trials_tell_what_the_best_do_not() -> None:
    """The best controllers excite one number; the first other one that is chosen excites the other number most."""
    made, at = problem(Parabola()), np.array([0.3, 0.5])
    candidates = np.tile(made.controller_box.low, (6, 1)) * 0.0
    candidates[:, 0] = [0.5, 0.49, 0.48, 0.47, 0.0, 0.1]
    candidates[:, 1] = [0.0, 0.0, 0.0, 0.0, 0.2, 0.4]
    candidates = np.clip(candidates, made.controller_box.low, made.controller_box.high)
    order = informative(made, told_by(made, at, candidates[:0]), candidates)
    assert order[:3] == [0, 1, 5]
    tried = np.tile(candidates[5], (30, 1))  # known from other trials: now the first number is worth more
    told = told_by(made, at, tried, tried[:, :2] @ at, 0.005)
    assert informative(made, told, candidates)[2] == 2
