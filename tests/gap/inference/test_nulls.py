"""Simulated nulls: their starting states, what they leave of noise, and that a missed touchdown shows in them."""

import numpy as np
import pytest
from gap_arm import SIGMA, arm_windows
from hidden_cases import CaseSettings, case_robot, make_case

from btr_mjx.gap.data import load
from btr_mjx.gap.inference.scoring.forces import ForceFit, Forces, circumstances, lack_of_fit
from btr_mjx.gap.inference.scoring.gains import without_wildest
from btr_mjx.gap.inference.scoring.nulls import doubtful, null_residual
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Span, Windows, linearise, prepare, project
from btr_mjx.gap.windows.propagation import jacobian


@pytest.fixture(scope="module")
def windows():
    return arm_windows()


def test_starting_states_are_drawn_as_far_as_they_are_unknown(windows):
    """Against the covariance of a least-squares fit with a prior, in units of the noise."""
    here = np.concatenate([windows.qpos, windows.qvel], -1)
    rng = np.random.default_rng(0)
    draws = np.stack([np.concatenate(doubtful(windows, rng), -1) for _ in range(4000)])
    away = (draws - here) / SIGMA
    for w, answer in enumerate(jacobian(windows)):
        expected = np.linalg.inv(answer.T @ answer + np.diag(SIGMA / windows.reach[w]) ** 2)
        found = np.cov(away[:, w].T)
        np.testing.assert_allclose(found, expected, atol=0.08 * np.diag(expected).max())
        np.testing.assert_allclose(away[:, w].mean(0), 0, atol=0.1 * np.sqrt(np.diag(expected)).max())


def test_nulls_of_a_smooth_robot_leave_noise(windows):
    rng = np.random.default_rng(1)
    chi2 = np.stack([(null_residual(windows, World.of, World.of, rng) ** 2).sum(1) for _ in range(20)])
    assert chi2.mean() / windows.freedom == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(chi2.std() / np.sqrt(2 * windows.freedom), 1.0, atol=0.25)


def test_what_the_truth_has_beyond_the_believed_world_is_left(windows):
    """A null of another world leaves what that world's own residual is, with the sign of data instead of model."""

    def damped(model):
        world = World.of(model)
        world.model.dof_damping[1] += 0.01
        return world

    found = np.mean([null_residual(windows, World.of, damped, np.random.default_rng(i)) for i in range(60)], axis=0)
    expected = windows.residual - windows.residuals([damped])[0]
    assert np.linalg.norm(expected) > 10
    assert np.linalg.norm(found - expected) < 0.35 * np.linalg.norm(expected)


def test_touchdowns_that_small_steps_miss_show_in_nulls(tmp_path):
    """A quadruped as it is believed to be: its light legs strike the ground at times that noise leaves open."""
    make_case(
        tmp_path,
        906,
        "quadruped",
        CaseSettings(verdict="none", background=0.0, recordings=(1, 1), duration=1.0, noise=2.4),
    )
    data = load(tmp_path)
    sigma = 2.4 * np.concatenate(case_robot("quadruped").sigma(data.fit[0].model))
    prepared = prepare(data.fit, sigma, Span(5, 4))
    k = round(0.04 / float(np.median(np.diff(data.fit[0].time))))
    first = np.arange(k, len(data.fit[0].time) - k - 6, k)
    windows = Windows(prepared, np.zeros(len(first), int), first, k)
    windows = linearise(windows, World.of)
    rng = np.random.default_rng(0)
    nulls = np.stack([(null_residual(windows, World.of, World.of, rng) ** 2).sum(1) for _ in range(2)])
    share = nulls / windows.freedom  # of noise alone 1 +- 0.05
    assert np.median(share) < 1.1
    assert (share > 1.3).any()


def test_one_window_makes_no_unknown_effect():
    excess = np.array([[1.0, -2.0], [400.0, -3.0], [2.0, -1.0], *[[0.0, 0.0]] * 6])
    np.testing.assert_allclose(without_wildest(excess), [3.0, -6.0])
    np.testing.assert_allclose(without_wildest(np.array([[40.0]])), [40.0])  # one of one is all that there is
    np.testing.assert_allclose(without_wildest(np.array([[40.0], [8.0]])), [48.0 - 40.0 / 8])


def test_the_lack_of_fit_forgets_the_wildest_window(windows):
    fit = ForceFit(windows, circumstances(windows, World.of))
    rng = np.random.default_rng(2)
    forces = fit(project(rng.standard_normal(windows.residual.shape), windows.basis))
    many = [np.concatenate([x] * 5) for x in (forces.value, forces.sigma, forces.explained, forces.rank)]
    calm = lack_of_fit([Forces(*many)])
    wild = many[2].copy()
    wild[7] = 1e5
    assert lack_of_fit([Forces(many[0], many[1], wild, many[3])]) - calm < 0.5
    wild[:10] = 1e5
    assert lack_of_fit([Forces(many[0], many[1], wild, many[3])]) - calm > 10
