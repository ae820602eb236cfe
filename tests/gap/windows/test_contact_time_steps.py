"""A quadruped with light legs: division of the time step for contacts, and Jacobians of nonlinear windows."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gap_arm import SIGMA, arm_windows, recording
from hidden_cases import CaseSettings, case_robot, make_case
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.gap.data import load
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.inference.scoring.nulls import null_residual
from btr_mjx.gap.simulate import Counter, World, simulate
from btr_mjx.gap.windows import (
    Options,
    Span,
    Windows,
    choose_windows,
    fine_step,
    linearise,
    prepare,
    signatures,
    survey,
    time_step_notes,
)
from btr_mjx.gap.windows.propagation import jacobian, linearisation_holds
from btr_mjx.gap.windows.time_steps import refinement, step_error
from btr_mjx.gap.windows.transitions import simulated_jacobians, state_jacobians
from btr_mjx.models import integrate


@pytest.fixture(scope="module")
def quadruped(tmp_path_factory):
    """Data of the believed quadruped with sensor noise, and windows that do not overlap."""
    folder = tmp_path_factory.mktemp("quadruped")
    make_case(folder, 906, "quadruped", CaseSettings(verdict="none", background=0.0, recordings=(1, 1), duration=1.0))
    data = load(folder)
    sigma = np.concatenate(case_robot("quadruped").sigma(data.fit[0].model))
    k = round(0.04 / float(np.median(np.diff(data.fit[0].time))))
    first = np.arange(k, len(data.fit[0].time) - k - 6, k)
    return prepare(data.fit, sigma, Span(5, 4)), first, k


def windows_of(quadruped, step_divisor=1, noise=1.0):
    data, first, k = quadruped
    data = replace(data, step_divisor=step_divisor, refined_for_contact=step_divisor > 1, sigma=noise * data.sigma)
    return Windows(data, np.zeros(len(first), int), first, k)


@pytest.fixture(scope="module")
def fine(quadruped):
    windows = windows_of(quadruped, 4)
    windows = linearise(windows, World.of)
    return windows


@pytest.mark.parametrize(
    ("noise", "expected"),
    [(100.0, [1]), (1.0, [2]), (0.15, [4]), (0.01, [16])],
    ids=["unseen", "seen", "more", "most"],
)
def test_step_is_divided_if_its_error_exceeds_noise(quadruped, noise, expected) -> None:
    assert refinement(windows_of(quadruped, noise=noise), World.of) in expected


def test_divided_step_reduces_remaining_error(quadruped) -> None:
    """The correction is computed at one starting state; half a standard deviation away an error remains."""
    off = []
    for finer in (1, 4):
        windows = windows_of(quadruped, finer)
        taken = step_error(windows, World.of, windows.states([World.of])[0])
        sign = np.random.default_rng(0).choice([-1.0, 1.0], windows.qvel.shape)
        start = windows.qpos, windows.qvel + 0.5 * sign * windows.data.sigma[windows.nv :]
        near, exact = (windows.whiten(windows.states([World.of], start=start, timestep=t)[0]) for t in (None, 2e-5))
        off.append(np.linalg.norm(near + taken - exact))
    assert off[1] < 0.75 * off[0]


def test_number_of_windows_with_divided_step(quadruped) -> None:
    data = quadruped[0]
    found, base = survey(data, Counter()), Hypothesis((), ())
    assert found.contact
    few = Options(steps=2e4)
    chosen = choose_windows(data, data, base, found, 100, few, Counter())
    fit, test = chosen.windows
    own = float(fit.models[0].opt.timestep)
    assert fit.dt == test.dt == own / 2 == fit.step
    assert chosen.options.steps == 2 * few.steps
    assert "steps of 0.5 ms: steps of 1 ms" in time_step_notes(fit)[0]
    noisy = replace(data, sigma=100 * data.sigma)
    rough = choose_windows(noisy, noisy, base, found, 100, few, Counter())
    assert rough.windows[0].dt == own
    assert rough.options is few
    assert time_step_notes(rough.windows[0]) == ()
    assert len(fit) >= len(rough.windows[0])


def test_step_is_not_divided_without_contact() -> None:
    """Without contact the error is corrected, however large it is relative to the noise."""
    data = prepare([recording("r", seed=3)], 0.01 * SIGMA, Span(5, 6))
    windows = Windows(data, np.zeros(2, int), np.array([10, 150]), 30)
    assert refinement(windows, World.of) >= 4
    found = survey(data, Counter())
    assert not found.contact
    chosen = choose_windows(data, data, Hypothesis((), ()), found, 100, Options(), Counter())
    assert chosen.windows[0].dt == windows.dt


def test_simulated_jacobians_equal_differences_of_simulations(fine) -> None:
    own = np.array([0, 3])
    found = simulated_jacobians(fine, World.of, own)
    nv, sigma = fine.nv, fine.data.sigma

    def end(w, away):
        start = fine.segments(
            np.array([w]),
            integrate(fine.models[0], fine.qpos[[w]], away[None, :nv]),
            fine.qvel[[w]] + away[nv:],
            fine.since[[w]],
        )
        return simulate([(World.of(fine.models[0]), start)], timestep=fine.stride * fine.dt)[0]

    for i, w in enumerate(own):
        unmoved = end(w, np.zeros(2 * nv))
        for j in range(2 * nv):
            moved = end(w, np.where(np.arange(2 * nv) == j, 0.5 * sigma, 0.0))
            np.testing.assert_allclose(found[i, :, j], 2.0 * fine.scaled(fine.minus(moved, unmoved))[0], atol=1e-6)


def test_simulated_jacobians_equal_products_without_contact() -> None:
    windows = arm_windows()
    found, product = simulated_jacobians(windows, World.of, np.arange(len(windows))), jacobian(windows)
    assert np.linalg.norm(found - product) < 0.02 * np.linalg.norm(product)


def test_windows_in_which_the_linearisation_fails_are_left_out(quadruped, fine) -> None:
    """Several touchdowns: the product of transition matrices differs from the simulation."""
    every = windows_of(quadruped, 4)
    assert len(every) // 2 <= len(fine) < len(every)
    assert set(fine.first) < set(every.first)
    np.testing.assert_array_equal(fine.jacobians, jacobian(fine))

    def damped(model):
        world = World.of(model)
        world.model.dof_damping[8] += 0.02
        return world

    for single in (False, True):
        (found,) = signatures(fine, World.of, [damped], single)
        true = fine.residuals([damped])[0] - fine.residual
        calm = np.flatnonzero(np.linalg.norm(fine.jacobians, axis=(1, 2)) < 300.0)
        assert len(calm) > 3
        off = np.linalg.norm(found[calm] - true[calm], axis=1) / np.linalg.norm(true[calm], axis=1)
        assert np.median(off) < 0.2


def test_windows_of_another_hypothesis_have_simulated_jacobians_where_the_product_fails(fine) -> None:
    off = copy.copy(fine)
    off.transitions = fine.transitions.copy()
    off.transitions[:2] *= 30.0
    found, product = state_jacobians(off, World.of), jacobian(off)
    size = np.linalg.norm(product, axis=(1, 2))
    assert (np.linalg.norm(found, axis=(1, 2)) < 0.5 * size)[:2].all()
    np.testing.assert_array_equal(found[2:], product[2:])


@given(st.lists(st.floats(0.0, 1e12), min_size=1, max_size=30))
def test_linearisation_holds_in_at_least_half_of_the_windows(sizes) -> None:
    found = linearisation_holds(np.array(sizes)[:, None, None])
    assert 2 * found.sum() >= len(sizes)
    assert found[np.array(sizes) <= 3e4].all()
    order = np.argsort(sizes)
    assert (np.diff(found[order].astype(int)) <= 0).all()  # monotone in the amplification


def test_nulls_include_remaining_step_error(quadruped, fine) -> None:
    """Simulated null data take fine steps if the step is divided; those of an arm leave noise only."""
    arm = arm_windows()
    data = replace(arm.data, step_divisor=4, refined_for_contact=True)
    windows = Windows(data, arm.recording, arm.first, arm.k)
    windows = linearise(windows, World.of)
    rng = np.random.default_rng(1)
    chi2 = np.stack([(null_residual(windows, World.of, World.of, rng) ** 2).sum(1) for _ in range(20)])
    assert chi2.mean() / windows.freedom == pytest.approx(1.0, abs=0.03)
    asked = []
    states = fine.states

    class Spied(type(fine)):
        def states(self, makes, *, timestep=None, **kwargs):
            asked.append(timestep)
            return states(makes, timestep=timestep, **kwargs)

    spied = fine.copied()
    spied.__class__ = Spied
    assert np.isfinite(null_residual(spied, World.of, World.of, rng)).all()
    assert asked[0] == fine_step(fine) < fine.step
