"""Least squares of numbers and calibration against SciPy's bounded solver and against its own optimality conditions."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from btr_mjx.gap.forces.evidence import CalibrationPrior, LeastSquares, least_squares, penalty

ROWS, FREE, CALIBRATED = 40, 3, 4


def problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, CalibrationPrior]:
    """Residual, columns, free numbers and calibration, whose columns were taken away from 0."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((ROWS, 9)) * rng.uniform(0.3, 3, 9)
    residual = 3 * rng.standard_normal(ROWS)
    free = np.zeros((9, FREE))
    free[[0, 1, 2], [0, 1, 2]], free[3, 2] = 1.0, 1.0  # the last number is shared by two places
    design = np.zeros((9, CALIBRATED))
    design[5 + np.arange(CALIBRATED), np.arange(CALIBRATED)] = 1.0
    design[0, 0] = 1.0  # what a name explains, calibration may explain too
    tolerance = rng.uniform(0.05, 1.0, CALIBRATED)
    reach = tolerance * rng.uniform(0.5, 4, CALIBRATED)
    prior = CalibrationPrior(design, tolerance, reach, rng.uniform(-1, 1, CALIBRATED) * reach)
    return residual, columns, free, prior


def gram(residual: np.ndarray, columns: np.ndarray) -> np.ndarray:
    every = np.concatenate([residual[:, None], columns], 1)
    return every.T @ every


def loss(residual, columns, free, prior, values, calibration) -> float:
    """-2 ln p, written out."""
    left = residual + columns @ (free @ values + prior.design @ (calibration - prior.at))
    return float(left @ left + ((calibration / prior.tolerance) ** 2).sum())


def by_scipy(residual, columns, free, prior, low, high) -> tuple[np.ndarray, np.ndarray]:
    """The prior is one more row for every number of calibration."""
    design = np.concatenate([columns @ free, columns @ prior.design], 1)
    rows = np.concatenate([np.zeros((CALIBRATED, FREE)), np.diag(1 / prior.tolerance)], 1)
    target = np.concatenate([-(residual - columns @ prior.design @ prior.at), np.zeros(CALIBRATED)])
    bounds = (np.r_[low, -prior.reach], np.r_[high, prior.reach] + 1e-15)
    found = lsq_linear(np.concatenate([design, rows]), target, bounds, tol=1e-14).x
    return found[:FREE], found[FREE:]


def of(problem_, low=None, high=None) -> LeastSquares:
    residual, columns, free, prior = problem_
    return least_squares(gram(residual, columns), free, prior, low, high)


@pytest.mark.parametrize("seed", range(12))
def test_fits_within_bounds_equal_those_of_scipy(seed):
    own = problem(seed)
    rng = np.random.default_rng(100 + seed)
    low, high = -rng.uniform(0, 0.5, FREE), rng.uniform(0, 0.5, FREE)
    found = of(own, low, high)
    values, calibration = by_scipy(*own, low, high)
    assert found.loss == pytest.approx(loss(*own, found.values, found.calibration), rel=1e-9)
    assert found.loss == pytest.approx(loss(*own, values, calibration), rel=1e-6)
    np.testing.assert_allclose(found.values, values, atol=1e-4)
    np.testing.assert_allclose(found.calibration, calibration, atol=1e-4)
    assert (found.values >= low).all()
    assert (found.values <= high).all()
    assert (np.abs(found.calibration) <= prior_reach(own)).all()


def prior_reach(own) -> np.ndarray:
    return own[3].reach * (1 + 1e-12)


def test_a_bound_costs_evidence():
    own = problem(3)
    wide = of(own)
    tight = of(own, np.full(FREE, -1e-3), np.full(FREE, 1e-3))
    assert np.abs(wide.values).max() > 1e-2
    assert tight.loss > wide.loss + 0.1


def test_where_columns_were_taken_does_not_matter():
    """A fit of calibration that starts elsewhere ends in the same place, if the residual is that of its start."""
    residual, columns, free, prior = problem(5)
    other = CalibrationPrior(prior.design, prior.tolerance, prior.reach, 0.3 * prior.reach)
    moved = residual + columns @ prior.design @ (other.at - prior.at)
    a, b = of((residual, columns, free, prior)), of((moved, columns, free, other))
    np.testing.assert_allclose(a.calibration, b.calibration, atol=1e-8)
    np.testing.assert_allclose(a.values, b.values, atol=1e-8)
    assert a.loss == pytest.approx(b.loss, rel=1e-9)


def test_what_calibration_explains_costs_its_size_in_tolerances():
    """One number of calibration without noise: it takes its part, and the loss is that of both."""
    columns, residual = np.array([[2.0], [0.0]]), np.array([3.0, 0.0])
    prior = CalibrationPrior(np.eye(1), np.array([0.5]), np.array([10.0]), np.zeros(1))
    found = least_squares(gram(residual, columns), np.zeros((1, 0)), prior)
    # minimum of (3 + 2 x)^2 + (2 x)^2
    assert found.calibration[0] == pytest.approx(-0.75)
    assert found.loss == pytest.approx(1.5**2 + 1.5**2)
    assert penalty(found.calibration, prior) == pytest.approx(1.5**2)


def test_a_column_without_effect_changes_nothing():
    residual, columns, free, prior = problem(7)
    columns[:, 1] = 0.0
    found = of((residual, columns, free, prior))
    assert found.values[1] == 0
    assert found.loss == pytest.approx(of((residual, columns, free[:, [0, 2]], prior)).loss, rel=1e-9)
