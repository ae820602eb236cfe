"""Metrics against plain loops and scipy, and the laws of a metric."""

import itertools

import numpy as np
import pytest
import scipy.spatial
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from btr_mjx.evaluation.metrics import (
    bootstrap_interval,
    euclidean_metric,
    monotonicity,
    rolling_mean_metric,
    roughness,
    sensor_scale,
    side_spearman,
    spearman,
)

# Reproducible examples, and no time limits on a busy machine.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")

METRICS = [lambda a, b, h: rolling_mean_metric(a, b, h, window=4), lambda a, b, h: euclidean_metric(a, b, h)]
numbers = st.integers(-1000, 1000).map(lambda i: i / 8)
series = hnp.arrays(np.float64, (9, 2), elements=numbers)
curves = hnp.arrays(np.float64, st.integers(2, 12), elements=numbers)


def loop_rolling_mean(x_r, x_s, header, window, scale):
    total, n_sensors = 0.0, x_r.shape[1]
    for j in range(header):
        steps = range(max(0, j - window + 1), j + 1)
        for sensor in range(n_sensors):
            mean_r = sum(x_r[i, sensor] / scale[sensor] for i in steps) / len(steps)
            mean_s = sum(x_s[i, sensor] / scale[sensor] for i in steps) / len(steps)
            total += abs(mean_r - mean_s)
    return total / (header * n_sensors)


def loop_euclidean(x_r, x_s, header, scale):
    total = 0.0
    for j in range(header):
        for sensor in range(x_r.shape[1]):
            total += ((x_r[j, sensor] - x_s[j, sensor]) / scale[sensor]) ** 2
    return (total / (header * x_r.shape[1])) ** 0.5


# ---- sensor series ----


@pytest.mark.parametrize("window", [1, 3, 25, 100])
def test_metrics_match_plain_loops(window):
    rng = np.random.default_rng(0)
    x_r, x_s, scale = rng.standard_normal((2, 25, 3)), rng.standard_normal((4, 2, 25, 3)), np.array([0.5, 2.0, 30.0])
    headers = [1, 2, 17, 25]
    rolling = rolling_mean_metric(x_r, x_s, headers, window, scale)
    euclidean = euclidean_metric(x_r, x_s, headers, scale)
    assert rolling.shape == euclidean.shape == (4, 2, 4)
    for index in np.ndindex(4, 2, 4):
        l, k, h = index
        pair = x_r[k], x_s[l, k]
        np.testing.assert_allclose(rolling[index], loop_rolling_mean(*pair, headers[h], window, scale), rtol=1e-12)
        np.testing.assert_allclose(euclidean[index], loop_euclidean(*pair, headers[h], scale), rtol=1e-12)
        np.testing.assert_allclose(rolling[index], rolling_mean_metric(*pair, headers[h], window, scale), rtol=1e-12)
    np.testing.assert_array_equal(euclidean_metric(x_r, x_s, scale=scale), euclidean[..., -1])


def test_euclidean_is_scipys_distance_per_entry():
    a, b = np.random.default_rng(1).standard_normal((2, 40, 5))
    np.testing.assert_allclose(
        euclidean_metric(a, b), scipy.spatial.distance.euclidean(a.ravel(), b.ravel()) / 200**0.5
    )


@given(series, series, series, st.integers(1, 9), st.sampled_from(METRICS))
def test_they_are_metrics_on_the_header(a, b, c, header, metric):
    ab = metric(a, b, header)
    assert (ab == 0) == np.array_equal(a[:header], b[:header])
    assert ab >= 0
    assert metric(b, a, header) == ab
    assert metric(a, a, header) == 0
    assert metric(a, c, header) <= ab + metric(b, c, header) + 1e-9


@given(series, series, st.integers(1, 8), st.sampled_from(METRICS))
def test_nothing_beyond_the_header_counts(a, b, header, metric):
    cut = a.copy()
    cut[header:] = 77.0
    np.testing.assert_allclose(metric(cut, b, header), metric(a, b, header), rtol=1e-12)


@given(series, series, st.floats(0.125, 8))
def test_units_do_not_matter_after_scaling(a, b, factor):
    unit = np.array([factor, 1 / factor])
    for call in (rolling_mean_metric, euclidean_metric):
        np.testing.assert_allclose(call(a * unit, b * unit, 9, scale=unit), call(a, b, 9), rtol=1e-9)


def test_smoothing_forgives_jitter_but_not_offset():
    time = np.arange(400)[:, None]
    clean = np.sin(time / 50)
    jitter, offset = clean + 0.1 * (-1.0) ** time, clean + 0.1
    assert rolling_mean_metric(clean, jitter, 400, 40) < 0.1 * rolling_mean_metric(clean, offset, 400, 40)
    np.testing.assert_allclose(euclidean_metric(clean, jitter), euclidean_metric(clean, offset))


@pytest.mark.parametrize("metric", [rolling_mean_metric, euclidean_metric])
def test_divergence_shows_from_its_step_on(metric):
    a, b = np.random.default_rng(0).standard_normal((2, 20, 3))
    for bad in (np.nan, np.inf):
        a[10, 1] = bad
        result = metric(a, b, [5, 10, 11, 20])
        assert np.isfinite(result[:2]).all()
        assert not np.isfinite(result[2:]).any()


def test_sensor_scale():
    rng = np.random.default_rng(0)
    reference = rng.standard_normal((6, 500, 3)) * [1.0, 10.0, 0.0] + [100.0, -5.0, 0.1]
    scale = sensor_scale(reference)
    np.testing.assert_allclose(scale[:2], [reference[..., 0].std(), reference[..., 1].std()])
    assert scale[2] == np.inf
    shared = sensor_scale(reference, ["force", "length", "force"])
    np.testing.assert_allclose(shared, [scale[0] / 2**0.5, scale[1], scale[0] / 2**0.5])
    moved = reference + np.array([0, 0, 50.0])
    assert (euclidean_metric(reference, moved, scale=scale) == 0).all()
    assert (rolling_mean_metric(reference, moved, 500, scale=shared) > 1).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"header": 0}, r"header: got 0, expected whole numbers of steps within 1 \.\. 20"),
        ({"header": 21}, "header: got 21"),
        ({"header": [3, 25]}, r"header: got \[3, 25\]"),
        ({"header": 2.5}, r"header: got 2\.5"),
        ({"header": []}, r"header: got \[\]"),
        ({"window": 0}, "window: got 0"),
        ({"scale": [1.0, 0.0, 1.0]}, r"scale: got .*, expected one positive number, or 3 of them"),
        ({"scale": [1.0, np.nan, 1.0]}, "scale: got"),
        ({"scale": [1.0, 1.0]}, "scale: got"),
        ({"x_s": np.zeros((20, 4))}, r"got shapes \(5, 20, 3\) and \(20, 4\), expected \(\.\.\., N_b, n_sensors\)"),
        ({"x_s": np.zeros((4, 20, 3))}, "expected leading axes that broadcast"),
        ({"x_s": np.zeros(20)}, "expected"),
    ],
)
def test_metric_errors(change, message):
    arguments = {"x_r": np.zeros((5, 20, 3)), "x_s": np.ones((20, 3)), "header": 5} | change
    with pytest.raises(ValueError, match=message):
        rolling_mean_metric(**arguments)


def test_scale_errors():
    with pytest.raises(ValueError, match="NaN or infinite"):
        sensor_scale(np.full((5, 2), np.nan))
    with pytest.raises(ValueError, match=r"got shape \(5,\)"):
        sensor_scale(np.zeros(5))
    with pytest.raises(ValueError, match="got 1 labels, expected 2"):
        sensor_scale(np.zeros((5, 2)), ["a"])


# ---- the shape of a curve ----


def test_spearman_matches_scipy_with_ties_and_gaps():
    rng = np.random.default_rng(0)
    delta, error = rng.integers(0, 8, (5, 6, 15)).astype(float), rng.integers(0, 8, 15).astype(float)
    delta[rng.random(delta.shape) < 0.2] = np.nan
    rho = spearman(delta, error)
    assert rho.shape == (5, 6)
    for index in np.ndindex(5, 6):
        known = np.isfinite(delta[index])
        expected = scipy.stats.spearmanr(delta[index][known], error[known]).statistic
        np.testing.assert_allclose(rho[index], expected, rtol=1e-12, atol=1e-12)


@given(st.lists(numbers, min_size=2, max_size=12, unique=True), st.floats(0.1, 10))
def test_rho_is_the_sign_of_a_monotonic_relation(values, power):
    x = np.array(values)
    y = np.sign(x) * np.abs(x) ** 3 * power
    np.testing.assert_allclose(spearman(y, x), 1.0)
    np.testing.assert_allclose(spearman(-y, x), -1.0)


@given(curves)
def test_rho_is_bounded_and_antisymmetric(delta):
    x = np.arange(len(delta))
    rho = spearman(delta, x)
    if np.ptp(delta) == 0:
        assert np.isnan(rho)
    else:
        assert -1 <= rho <= 1
        np.testing.assert_allclose(spearman(-delta, x), -rho, atol=1e-12)


def test_undefined_rho_is_nan():
    assert np.isnan(spearman([1.0, np.nan, np.nan], [1, 2, 3]))
    assert np.isnan(spearman([np.nan] * 3, [1, 2, 3]))
    assert np.isnan(spearman([1.0], [1.0]))
    np.testing.assert_array_equal(spearman([[1, 1, 1], [1, 2, 3]], [1, 2, 3]), [np.nan, 1.0])


def test_each_side_of_the_truth():
    grid = np.linspace(0.4, 1.6, 13)
    truth = grid[4]
    lopsided = np.where(grid < truth, 10 * (truth - grid), grid - truth)
    np.testing.assert_allclose(side_spearman(lopsided, grid, truth), [1, 1])
    assert spearman(lopsided, np.abs(grid - truth)) < 1
    wrong_above = np.stack([lopsided, truth - grid])
    shuffled = np.random.default_rng(0).permutation(13)
    sides = side_spearman(wrong_above[:, shuffled], grid[shuffled], truth)
    np.testing.assert_allclose(sides, [[1, 1], [1, -1]])
    for truth_at, expected in ((-1, np.nan), (-2, np.nan), (-3, 1.0)):  # one, two, three points on that side
        np.testing.assert_array_equal(side_spearman(lopsided, grid, grid[truth_at])[1], expected)
    between = side_spearman(np.abs(grid - 0.85), grid, 0.85)
    np.testing.assert_allclose(between, [1, 1])


def test_monotonicity():
    grid = np.linspace(0.4, 1.6, 7)
    error = np.abs(grid - 1.0)
    assert monotonicity(error**2, error) == 1
    assert monotonicity(-error, error) == 0
    np.testing.assert_allclose(monotonicity(np.array([3, 3, 1, 0, 2, 1, 4.0]), error), 4 / 6)
    # The middle pair straddles the truth at equal errors: it has no order.
    mirror = np.abs(np.linspace(0.4, 1.6, 4) - 1.0)
    np.testing.assert_array_equal(monotonicity([[3, 1, 2, 3], [3, 2, 1, 3], [1, 1, 1, 1]], mirror), [1, 1, 0])
    np.testing.assert_allclose(monotonicity([3, np.nan, 1, 0, 1, 2, 1], error), 3 / 4)
    assert np.isnan(monotonicity([np.nan, 1, np.nan], [2, 1, 0]))
    assert np.isnan(monotonicity([1.0], [1.0]))


@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 3), st.integers(2, 9)), elements=numbers))
def test_monotonicity_matches_a_plain_loop(delta):
    error = np.abs(np.arange(delta.shape[1]) - 2.0)
    for row, share in zip(delta, monotonicity(delta, error), strict=True):
        ordered = [
            (row[i] < row[i + 1]) == (error[i] < error[i + 1]) and row[i] != row[i + 1] for i in range(len(row) - 1)
        ]
        np.testing.assert_allclose(share, np.mean(ordered))


@given(curves)
def test_roughness_matches_a_plain_loop_and_bounds(delta):
    variation = sum(abs(b - a) for a, b in itertools.pairwise(delta))
    if max(delta) == min(delta):
        assert np.isnan(roughness(delta))
        return
    value = roughness(delta)
    np.testing.assert_allclose(value, variation / (max(delta) - min(delta)))
    assert 1 - 1e-12 <= value <= len(delta) - 1 + 1e-12
    np.testing.assert_allclose(roughness(3 * delta[::-1] - 1), value)
    np.testing.assert_allclose(roughness(np.sort(delta)), 1)
    gaps = np.insert(delta, [0, 1, 1, len(delta)], np.nan)
    np.testing.assert_allclose(roughness([gaps, gaps]), [value, value])


def test_roughness_of_known_curves():
    grid = np.linspace(-1, 1, 21)
    np.testing.assert_allclose(roughness([np.exp(grid), np.abs(grid), (-1.0) ** np.arange(21)]), [1, 2, 20])
    np.testing.assert_array_equal(roughness([[np.nan, 1, np.nan], [np.nan] * 3, [2, 2, 2]]), np.nan)


def test_curve_errors():
    for call in (spearman, monotonicity):
        with pytest.raises(ValueError, match=r"got delta of shape \(3,\) and error of shape \(4,\)"):
            call(np.zeros(3), np.zeros(4))
        with pytest.raises(ValueError, match="leading axes that broadcast"):
            call(np.zeros((2, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="values: got shape"):
        side_spearman(np.zeros(3), np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match="single number"):
        roughness(1.0)


# ---- intervals ----


def test_bootstrap_is_scipys_bca():
    samples = np.random.default_rng(0).gamma(2.0, size=12)
    ours = bootstrap_interval(samples, np.mean, 0.9, seed=5)
    scipys = scipy.stats.bootstrap(
        (samples,), np.mean, confidence_level=0.9, method="BCa", n_resamples=9999, rng=np.random.default_rng(5)
    ).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], scipys, rtol=1e-12)
    assert ours.estimate == samples.mean()
    assert not ours.percentile
    assert ours.low < ours.estimate < ours.high


def test_bootstrap_rows_are_alike_and_repeatable():
    samples = np.random.default_rng(0).standard_normal((3, 8))
    samples[1] = 0.5  # BCa is undefined here
    table = bootstrap_interval(samples, np.median, seed=1, n_resamples=999)
    again = bootstrap_interval(samples, np.median, seed=1, n_resamples=999)
    np.testing.assert_array_equal(table.low, again.low)
    np.testing.assert_array_equal(table.percentile, [False, True, False])
    assert (table.low[1], table.high[1]) == (0.5, 0.5)
    assert (table.low <= table.estimate).all()
    assert (table.estimate <= table.high).all()
    plain = bootstrap_interval(samples, lambda x: float(np.median(x)), seed=1, n_resamples=999)
    np.testing.assert_allclose(plain.low, table.low)


@given(st.floats(-1e6, 1e6), st.integers(2, 6))
def test_equal_samples_give_a_point(value, n):
    interval = bootstrap_interval([value] * n, n_resamples=99)
    np.testing.assert_allclose([interval.low, interval.high], value)


def test_bootstrap_coverage():
    samples = np.random.default_rng(0).standard_normal((400, 15))
    interval = bootstrap_interval(samples, n_resamples=999)
    assert 0.88 <= ((interval.low <= 0) & (interval.high >= 0)).mean() <= 0.98


def test_one_sample_bounds_nothing():
    interval = bootstrap_interval([[0.9], [0.8]])
    np.testing.assert_array_equal(interval.estimate, [0.9, 0.8])
    assert np.isnan(interval.low).all()
    assert np.isnan(interval.high).all()


def test_bootstrap_errors():
    with pytest.raises(ValueError, match="NaN or infinite"):
        bootstrap_interval([1.0, np.nan])
    with pytest.raises(ValueError, match="at least one sample"):
        bootstrap_interval([])
    with pytest.raises(ValueError, match=r"level: got 95, expected a confidence level within \(0, 1\)"):
        bootstrap_interval([1.0, 2.0], level=95)
