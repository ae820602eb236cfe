import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS, evaluate, fitness_at_marks, multiscale_fitness
from btr_mjx.robots import Robot


@given(st.integers(1, 3), st.integers(2, 6), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_against_a_plain_loop(n: int, m: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    f_r, f_s = rng.normal(size=(m, k)), rng.normal(size=(n, m, k)) * 5
    for row, value in zip(f_s, multiscale_fitness(f_s, f_r, clip=2.0), strict=True):
        total = 0.0
        for mark in range(k):
            column = [f_r[i, mark] for i in range(m)]
            mean = sum(column) / m
            spread = (sum((x - mean) ** 2 for x in column) / m) ** 0.5
            total += sum(min(abs(row[i, mark] - f_r[i, mark]) / spread, 2.0) for i in range(m))
        assert value == pytest.approx(total / (m * k), rel=1e-9)
    assert multiscale_fitness(f_r, f_r) == 0.0


def test_marks_that_all_share_must_be_met() -> None:
    f_r = np.array([[1.0, 2.0], [1.0, 3.0]])
    assert multiscale_fitness(f_r, f_r) == 0.0
    assert multiscale_fitness(f_r + np.array([[1e-6, 0], [0, 0]]), f_r, clip=3.0) == pytest.approx(3.0 / 4)


def test_diverged_and_failed() -> None:
    f_r = np.array([[1.0], [2.0], [np.nan], [4.0]])
    f_s = np.array([[[1.0], [2.0], [7.0], [4.0]], [[np.nan], [2.0], [7.0], [4.0]]])
    values = multiscale_fitness(f_s, f_r)
    assert values[0] == 0.0
    assert np.isnan(values[1])
    with pytest.raises(InputError, match="1 finite"):
        multiscale_fitness(f_s[:, :2], [[1.0], [np.nan]])
    with pytest.raises(InputError, match=r"\(3, 1\)"):
        multiscale_fitness(f_s, f_r[:3])
    with pytest.raises(InputError, match="clip"):
        multiscale_fitness(f_s, f_r, clip=0.0)


def test_fitness_at_marks_is_that_of_shorter_trials(robot: Robot, rng: np.random.Generator) -> None:
    c = robot.controller_box.sample(rng, 3)
    times = [0.01, 0.02, 0.03]
    whole = evaluate(robot, [robot.nominal], c, engine="native", times=times)
    marks = fitness_at_marks(whole.outcome, FITNESS_FUNCTIONS["distance"])
    for k, time in enumerate(times):
        alone = evaluate(robot, [robot.nominal], c, engine="native", times=[time])
        np.testing.assert_array_equal(marks[..., k], alone.fitness)
