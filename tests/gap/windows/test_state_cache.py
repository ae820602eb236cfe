"""The cache of simulated states: bit-identical results, without repeated simulation."""

import mujoco
import numpy as np
import pytest
from gap_arm import SIGMA, arm_windows
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Windows
from btr_mjx.gap.windows.state_cache import StateCache


def damped(model: mujoco.MjModel) -> World:
    world = World.of(model)
    world.model.dof_damping[:] += 0.05
    return world


def heavy(model: mujoco.MjModel) -> World:
    world = World.of(model)
    world.model.body_mass[-1] *= 1.2
    return world


@pytest.fixture
def windows() -> Windows:
    return arm_windows()


def without_cache(windows: Windows, makes, **options) -> list[np.ndarray]:
    """The states without a cache."""
    windows.cache, kept = StateCache(most=0), windows.cache
    states = windows.states(makes, **options)
    windows.cache = kept
    return states


@given(
    asked=st.lists(st.tuples(st.lists(st.integers(0, 3), min_size=1, max_size=3), st.lists(st.integers(0, 5)))),
    most=st.sampled_from([0, 100, 2**20]),
)
def test_cached_states_are_correct_and_simulated_once(asked, most: int) -> None:
    memory, simulated = StateCache(most), []
    for questions, rows in asked:

        def find(wanted, questions=questions, rows=rows):
            simulated.extend((questions[i], rows[r]) for i, own in wanted for r in own)
            return [np.array([[questions[i], rows[r]] for r in own], float) for i, own in wanted]

        if not rows:
            continue
        before, so_far = set(simulated), len(simulated)
        for question, states in zip(questions, memory(questions, [bytes([r]) for r in rows], find), strict=True):
            np.testing.assert_array_equal(states, [[question, row] for row in rows])
        if most > 1000:
            assert not before & set(simulated[so_far:])
        assert memory.bytes <= most


def test_only_changed_starting_states_are_simulated(windows: Windows) -> None:
    windows.states([damped])
    start = windows.qpos.copy(), windows.qvel.copy()
    start[1][::2] += SIGMA[2:]
    moved = len(start[1][::2])
    assert 0 < moved < len(windows)
    counted = windows.counter.steps
    states = windows.states([damped], start=start)[0]
    assert windows.counter.steps - counted == moved * round(windows.since[0, -1] / windows.step)
    np.testing.assert_array_equal(states, without_cache(windows, [damped], start=start)[0])
    counted = windows.counter.steps
    np.testing.assert_array_equal(windows.states([damped], start=start)[0], states)
    assert windows.counter.steps == counted


def test_hypothesis_and_time_step_are_part_of_the_key(windows: Windows) -> None:
    windows.states([damped])
    for makes, options in (([heavy, damped], {"timestep": windows.step / 2}), ([heavy], {})):
        counted = windows.counter.steps
        found = windows.states(makes, **options)
        assert windows.counter.steps > counted
        for states, expected in zip(found, without_cache(windows, makes, **options), strict=True):
            np.testing.assert_array_equal(states, expected)


def test_subsets_of_windows_share_the_cache(windows: Windows) -> None:
    """Windows in subsets and unions are identified by recording and first sample."""
    whole = windows.states([damped])[0]
    counted = windows.counter.steps
    few = windows.some(np.array([3, 0, 2]))
    np.testing.assert_array_equal(few.states([damped])[0], whole[[3, 0, 2]])
    np.testing.assert_array_equal(windows.states([damped], own=np.array([1, 3]))[0], whole[[1, 3]])
    assert windows.counter.steps == counted


def test_returned_states_are_copies(windows: Windows) -> None:
    states = windows.states([damped])[0]
    kept = states.copy()
    states[:] = 0.0
    again = windows.states([damped])[0]
    np.testing.assert_array_equal(again, kept)
    again[:] = 1.0
    np.testing.assert_array_equal(windows.states([damped])[0], kept)
