import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.gap.inference.scoring.gains import fall
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.windows import Fit, bounded_loss, fit, project, regularised, scan_candidates, window_weight
from btr_mjx.gap.windows.window_fits import column_space, evidence


def problem(seed, windows=6, rows=15, columns=5):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((windows, rows)), rng.standard_normal((columns, windows, rows))


@given(st.floats(0, 1e6), st.floats(1e-3, 1e3))
def test_bounded_loss_is_bounded_and_below_chi2(x, cut):
    value = float(bounded_loss(np.array(x), cut))
    assert value <= x + 1e-9
    assert value <= 2 * cut
    assert 0 <= float(window_weight(np.array(x), cut)) <= 1


def test_weight_is_derivative_of_loss():
    x, cut, step = np.array([0.5, 0.99, 1.5, 4.0]), 1.0, 1e-6
    slope = (bounded_loss(x + step, cut) - bounded_loss(x - step, cut)) / (2 * step)
    np.testing.assert_allclose(slope, window_weight(x, cut), rtol=1e-5)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_fit_without_a_bound_is_ridge_regression(seed):
    residual, columns = problem(seed)
    precision = np.array([0.0, 0.0, 1.0, 4.0, 9.0])
    found = fit(evidence(residual, columns), precision, 1e12)
    design = columns.reshape(5, -1).T
    normal = design.T @ design + np.diag(precision)
    values = -np.linalg.solve(normal, design.T @ residual.ravel())
    np.testing.assert_allclose(found.values, values, rtol=1e-6, atol=1e-9)
    left = residual.ravel() + design @ values
    assert found.loss == pytest.approx(left @ left + (precision * values**2).sum())


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.lists(st.floats(-9, 9), min_size=5, max_size=5))
def test_fit_is_independent_of_units(seed, powers):
    """Parameters of very different magnitudes are fitted as well as those of order one."""
    residual, columns = problem(seed)
    precision, unit = np.array([0.0, 0.0, 1.0, 4.0, 9.0]), 10.0 ** np.array(powers)
    plain = fit(evidence(residual, columns), precision, 20.0)
    scaled = fit(evidence(residual, columns / unit[:, None, None]), precision / unit**2, 20.0)
    np.testing.assert_allclose(scaled.values / unit, plain.values, rtol=1e-4, atol=1e-5)
    assert scaled.loss == pytest.approx(plain.loss, rel=1e-6)


def test_columns_without_effect_stay_zero():
    residual, columns = problem(3)
    columns[1] = 0.0
    assert fit(evidence(residual, columns), np.zeros(5), 1e12).values[1] == 0.0
    np.testing.assert_allclose(np.linalg.inv(regularised(np.diag([4.0, 0.0]))), np.diag([0.25, 1.0]), rtol=1e-6)


def test_outlier_window_does_not_move_the_fit():
    residual, columns = problem(1, windows=20, rows=30, columns=1)
    residual = 0.1 * residual - 3.0 * columns[0]
    residual[0] = 100.0
    found = fit(evidence(residual, columns), np.zeros(1), 30.0)
    assert found.values[0] == pytest.approx(3.0, abs=0.1)


def test_fit_respects_bounds_and_a_prior():
    residual, columns = problem(2)
    data = evidence(residual - 2 * columns[0], columns)
    low, high = np.full(5, -np.inf), np.full(5, np.inf)
    high[0] = 0.5
    assert fit(data, np.zeros(5), 1e12, low, high).values[0] == pytest.approx(0.5)
    stiff = np.array([1e9, 0, 0, 0, 0])
    assert fit(data, stiff, 1e12).values[0] == pytest.approx(0.0, abs=1e-3)


def test_scan_gain_equals_marginal_likelihood():
    """Against the dense covariance of noise plus tolerances, for each candidate."""
    residual, columns = problem(3)
    precision = np.array([1.0, 0.25])
    gains, values = scan_candidates(
        evidence(residual, columns), [np.array([0]), np.array([1, 2])], np.array([3, 4]), precision, np.ones(6)
    )
    tolerances = columns[3:].reshape(2, -1).T
    covariance = np.eye(90) + tolerances @ np.diag(1 / precision) @ tolerances.T
    inverse, e = np.linalg.inv(covariance), residual.ravel()
    for gain, value, index in zip(gains, values, ([0], [1, 2]), strict=True):
        design = columns[index].reshape(len(index), -1).T
        normal = design.T @ inverse @ design
        best = -np.linalg.solve(normal, design.T @ inverse @ e)
        np.testing.assert_allclose(value, best, rtol=1e-6)
        assert gain == pytest.approx(best @ normal @ best, rel=1e-6)


def test_projection_removes_directions_and_nothing_else():
    rng = np.random.default_rng(4)
    jacobian = rng.standard_normal((3, 12, 4))
    jacobian[:, :, 3] = jacobian[:, :, 0]  # dependent columns do no harm
    basis = column_space(jacobian)[0]
    inside = np.einsum("wrd,d->wr", jacobian, rng.standard_normal(4))
    np.testing.assert_allclose(project(inside, basis), 0, atol=1e-10)
    once = project(rng.standard_normal((3, 12)), basis)
    np.testing.assert_allclose(project(once, basis), once, atol=1e-12)


def test_nuisances_absorb_what_they_can_explain():
    residual, columns = problem(5, columns=2)
    nuisance = Nuisance.of(columns, np.array([1e-6, 1e-6]))
    left = nuisance.absorbed(3 * columns[0] - 2 * columns[1], 1e12)
    np.testing.assert_allclose(left, 0, atol=1e-3)
    data = nuisance.evidence(residual, columns[:1])
    assert data.n == 3
    np.testing.assert_allclose(data.gram[:, 0, 1], (columns[0] ** 2).sum(1), rtol=1e-6)


def test_scaled_misfit_does_not_move_tolerances_further():
    """With a misfit that is ten times larger in all directions, tolerances are the same."""
    residual, columns = problem(6, columns=2)
    small = Nuisance.of(columns, np.array([4.0, 9.0])).profile(residual, 1e12)
    large = Nuisance.of(10 * columns, np.array([4.0, 9.0])).against(100.0).profile(10 * residual, 1e14)
    np.testing.assert_allclose(large.values, small.values, rtol=1e-8)
    assert np.abs(small.values).min() > 1e-3


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_chi2_from_inner_products_equals_chi2_of_vectors(seed):
    residual, columns = problem(seed)
    data, values = evidence(residual, columns), np.array([0.3, -1.0])
    there = residual + 0.3 * columns[1] - columns[4]
    np.testing.assert_allclose(data.chi2(np.array([1, 4]), values), (there**2).sum(1), rtol=1e-8, atol=1e-8)
    part = data.windows(np.array([2, 2]))
    np.testing.assert_allclose(part.energy[0], part.energy[1])


@settings(max_examples=50)
@given(st.lists(st.floats(-40.0, 40.0), min_size=9, max_size=30))
def test_an_even_fall_favours_neither_of_two_fits(changes):
    """Without the windows that gain and lose most it is the same both ways; a gain alone is never worth more."""
    change = np.array(changes)
    before, none = np.full(len(change), 100.0), np.zeros((0, 0))
    fits = [Fit(np.zeros(0), float(c.sum()) + prior, c, none) for c, prior in ((before, 3.0), (before - change, 1.0))]
    found = fall(*fits, 1e3, even=True)
    assert found == pytest.approx(-fall(*fits[::-1], 1e3, even=True))
    assert found >= fall(*fits, 1e3) - 1e-9
    most = 15.0 + 3.0 * np.quantile(np.abs(change), 0.8)
    steady = np.clip(change, -most, most)
    middle = steady.sum() - max(steady.max(), 0.0) - min(steady.min(), 0.0)
    assert found == pytest.approx(middle + 2.0)
