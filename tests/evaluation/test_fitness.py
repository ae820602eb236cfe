from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from btr_mjx.errors import InputError
from btr_mjx.evaluation import (
    FITNESS_FUNCTIONS,
    Outcome,
    delta_fitness_of,
    delta_of,
    evaluate,
    fitness_function,
    learning_performance,
)
from btr_mjx.robots import Robot

finite = st.floats(-100, 100)


def outcome(end: list[float], energy: float = 10.0, times: tuple[float, ...] = (0.5, 2.0)) -> Outcome:
    start = np.array([1.0, -1.0, 0.5])
    position = np.stack([start + 100.0, start + end])  # only the last sample counts
    return Outcome(np.array(times), start, position, np.array([1.0, energy]))


def test_built_in_fitness_functions_by_hand() -> None:
    o = outcome([3.0, 4.0, 7.0])
    assert FITNESS_FUNCTIONS["distance"](o) == pytest.approx(5.0 / 2.0)
    assert FITNESS_FUNCTIONS["forward_speed"](o) == pytest.approx(1.5)
    assert FITNESS_FUNCTIONS["energy_per_metre"](o) == pytest.approx(2.0)
    assert np.isnan(FITNESS_FUNCTIONS["energy_per_metre"](outcome([1e-4, 0.0, 1.0])))
    assert not FITNESS_FUNCTIONS["energy_per_metre"].maximise


def test_unknown_fitness_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"speed.*distance, forward_speed, energy_per_metre"):
        fitness_function("speed")


def test_a_fitness_by_name_or_function(robot: Robot, rng: np.random.Generator) -> None:
    """`evaluate` takes what a robot.toml does, and a function of an outcome."""
    short = replace(robot, duration=0.02, target=(1.0, 0.0, 0.5))
    pairs = short.nominal, short.controller_box.sample(rng, 2)
    outcome = evaluate(short, *pairs, engine="native").outcome
    moved = outcome.position[..., -1, :] - outcome.start

    def height(o: Outcome) -> np.ndarray:
        return o.qpos[..., -1, 2]

    by_name = evaluate(short, *pairs, engine="native", fitness="forward_speed").fitness
    np.testing.assert_array_equal(by_name, moved[..., 0] / 0.02)
    own = evaluate(short, *pairs, engine="native", fitness=height).fitness
    np.testing.assert_array_equal(own, outcome.position[..., -1, 2])
    to_target = evaluate(short, *pairs, engine="native", fitness="target_distance").fitness
    np.testing.assert_allclose(to_target, np.linalg.norm(outcome.position[..., -1, :] - short.target, axis=-1))
    for wrong, message in (
        ("spee", "got 'spee', expected one of"),
        (3.0, "got float, expected a name"),
        (lambda o: o.qpos[..., 2], r"gave shape \(1, 2, 1\) for trials of shape \(1, 2\)"),
        (lambda o: o.qpos[:, -1, -1, 2], r"gave shape \(1,\) for trials"),
        (lambda o: 3.0, r"gave shape \(\) for trials"),
    ):
        with pytest.raises(InputError, match=message):
            evaluate(short, *pairs, fitness=wrong)


@given(hnp.arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 6)), elements=finite), st.data())
def test_delta_fitness_is_the_mean_of_absolute_differences(f_s: np.ndarray, data: st.DataObject) -> None:
    f_r = data.draw(hnp.arrays(float, f_s.shape[1], elements=finite))
    expected = [sum(abs(a - b) for a, b in zip(row, f_r, strict=True)) / len(f_r) for row in f_s]
    np.testing.assert_allclose(delta_fitness_of(f_s, f_r), expected, rtol=1e-12, atol=1e-12)
    assert (delta_fitness_of(f_s, f_r) >= 0).all()
    assert (delta_of(f_r, f_r) == 0.0).all()


def test_a_diverged_behaviour_spoils_its_simulation_only() -> None:
    values = delta_fitness_of([[1.0, np.nan], [1.0, 2.0]], [1.0, 1.0])
    assert np.isnan(values[0])
    assert values[1] == 0.5


def test_wrong_number_of_measurements() -> None:
    with pytest.raises(InputError, match=r"f_r: got shape \(3,\)"):
        delta_of([[1.0, 2.0]], [1.0, 2.0, 3.0])


def test_learning_performance_by_hand() -> None:
    # The footnote: IF = (f_end - f_0) / f_max, LP = IF d / e.
    assert learning_performance(2.0, 5.0, 6.0, dimension=36, evaluations=54) == pytest.approx(0.5 * 36 / 54)
    assert learning_performance(0.0, 0.0, 0.0, 36, 1) == 0.0
    # From a distance of 0.9 m to one of 0.3 m.
    assert learning_performance(0.9, 0.3, 0.9, 10, 20, maximise=False) == pytest.approx(2 / 3 * 10 / 20)
    with pytest.raises(InputError, match="evaluations"):
        learning_performance(0.0, 1.0, 1.0, 36, 0)
