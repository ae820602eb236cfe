"""Covariances of fitted numbers: those of least squares where what is left is white, larger where it is not."""

import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_forces import believed
from gap_models import one

from btr_mjx.gap.forces.evidence import CalibrationPrior
from btr_mjx.gap.forces.kalman_filter import Filtered
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, covariance
from btr_mjx.gap.forces.unknowns import Library
from btr_mjx.gap.simulate import Counter

STRETCHES, ROWS = 400, 30
TOLERANCE = np.array([0.02])


def fitted(columns: np.ndarray, residual: np.ndarray) -> tuple[ForceSide, Fitted]:
    """A fit of two numbers beside one of calibration, with whitened columns (S, N, 3) and residual (S, N)."""
    prior = CalibrationPrior(np.zeros((0, 1)), TOLERANCE, 9 * TOLERANCE, np.zeros(1))
    side = ForceSide(None, Library((), (), (), prior), Counter())  # type: ignore[arg-type]
    named = tuple(
        (one(arm(), name, LIBRARY), (0.1,)) for name in ("viscous_damping@joint:elbow", "armature@joint:elbow")
    )
    every = np.concatenate([residual[..., None], columns], -1)
    whitened = Filtered(np.swapaxes(every, 1, 2) @ every, np.zeros(len(every)), ROWS)
    return side, Fitted(Point(believed(), named, np.zeros(1)), None, 0.0, lambda: (None, None, whitened), ())  # type: ignore


@pytest.fixture(scope="module")
def columns():
    rng = np.random.default_rng(0)
    out = rng.standard_normal((STRETCHES, ROWS, 3)) * [3.0, 0.5, 1.0]
    out[..., 0] += 2 * out[..., 1]
    out[..., 2] += out[..., 1]
    return out


def information(columns: np.ndarray) -> np.ndarray:
    """Of least squares with a prior of the last number."""
    design = columns.reshape(-1, 3)
    return design.T @ design + np.diag([0, 0, 1 / TOLERANCE[0] ** 2])


def test_white_noise_has_the_covariance_of_least_squares(columns):
    rng = np.random.default_rng(1)
    found = covariance(*fitted(columns, rng.standard_normal((STRETCHES, ROWS))))
    expected = np.linalg.inv(information(columns))
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / size / size[:, None], expected / size / size[:, None], atol=0.15)
    assert (np.diag(found) >= 0.999 * np.diag(expected)).all()


def test_less_noise_than_the_model_says_does_not_make_intervals_shorter(columns):
    rng = np.random.default_rng(2)
    found = covariance(*fitted(columns, 0.1 * rng.standard_normal((STRETCHES, ROWS))))
    np.testing.assert_allclose(found, np.linalg.inv(information(columns)), rtol=1e-6)


def test_numbers_that_differ_between_stretches_are_as_uncertain_as_their_mean(columns):
    """Each stretch has a first number of its own; the standard error of the mean is known."""
    rng = np.random.default_rng(3)
    own = rng.standard_normal(STRETCHES)
    side, fit = fitted(columns[..., :], -columns[..., 0] * own[:, None] + 0.1 * rng.standard_normal((STRETCHES, ROWS)))
    expected = np.sqrt(1 / STRETCHES)
    assert np.sqrt(covariance(side, fit)[0, 0]) == pytest.approx(expected, rel=0.3)
    white = np.sqrt(np.linalg.inv(information(columns))[0, 0])
    assert expected > 10 * white


def test_ninety_percent_of_intervals_hold_the_truth(columns):
    rng = np.random.default_rng(4)
    few, inside = columns[:20], []
    inverse = np.linalg.inv(information(few))
    for _ in range(150):
        calibration = TOLERANCE[0] * rng.standard_normal()
        noise = rng.standard_normal((20, ROWS)) + few[..., 2] * calibration
        found = -(inverse @ np.einsum("snc,sn->c", few, noise))
        # At the fit, as it is after the last step: what is left is that of the fit.
        side, fit = fitted(few, noise + few @ found)
        inside.append(np.abs(found[:2]) < 1.645 * np.sqrt(np.diag(covariance(side, fit))[:2]))
    np.testing.assert_allclose(np.mean(inside, 0), 0.92, atol=0.05)
