"""Noise of the sensors, as recordings show it and as a model corrects it."""

import numpy as np
import pytest
from gap_recordings import MODEL, smooth_recording
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.gap.data import estimate_noise, quantisation_noise, reduced_noise
from btr_mjx.models import integrate


@settings(max_examples=8, deadline=None)
@given(st.floats(1e-4, 1e-2), st.floats(1e-3, 0.1), st.integers(0, 1000))
def test_noise_estimate_is_independent_of_motion(sigma_q: float, sigma_v: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = smooth_recording("one", rng, count=300)
    qpos = integrate(MODEL, clean.qpos, sigma_q * rng.normal(size=clean.qvel.shape))
    qvel = clean.qvel + sigma_v * rng.normal(size=clean.qvel.shape)
    noise = estimate_noise(MODEL, [(clean.time, qpos, qvel, clean.qvel_measured)])
    np.testing.assert_allclose(np.median(noise.qpos), sigma_q, rtol=0.2)
    np.testing.assert_allclose(np.median(noise.qvel), sigma_v, rtol=0.2)


def test_noise_of_coarse_encoder_is_quantisation_noise(rng: np.random.Generator) -> None:
    clean = smooth_recording("one", rng, count=400)
    qpos = clean.qpos.copy()
    step = 0.02
    qpos[:, 7] = np.round(qpos[:, 7] / step) * step
    noise = estimate_noise(MODEL, [(clean.time, qpos, clean.qvel, clean.qvel_measured)])
    assert 0.5 * step / np.sqrt(12) < noise.qpos[6] < 2 * step / np.sqrt(12)


def test_noise_is_reduced_to_model_residual(rng: np.random.Generator) -> None:
    """One channel has a tenth of the estimated noise; another has a larger residual, which may be a missing effect."""
    sigma, channels = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0, 2, 3])
    left = np.array([1.0, 0.1, 5.0]) * rng.standard_normal((30, 50, 3))
    unknown = np.zeros(len(channels), bool)
    found = reduced_noise(sigma, channels, left.reshape(30, -1), 150.0, unknown)
    assert found is not None
    np.testing.assert_allclose(found, [1.0, 2.0, 0.3, 4.0], rtol=0.05)
    assert reduced_noise(sigma, channels, left.reshape(30, -1), 150.0, ~unknown) is None
    again = reduced_noise(found, channels, (left * (sigma / found)[channels]).reshape(30, -1), 150.0, unknown)
    assert again is None
    projected = np.sqrt(0.4) * rng.standard_normal((30, 150))  # less is left where much was fitted, which is no noise
    assert reduced_noise(sigma, channels, projected, 60.0, unknown) is None


def test_no_sensor_is_quieter_than_its_digits(rng: np.random.Generator) -> None:
    """A robot that stands still shows no noise at all, and yet its encoder has a step."""
    clean = smooth_recording("one", rng, count=400)
    qpos = clean.qpos.copy()
    qpos[:, 7] = np.where(np.arange(400) < 350, 0.42, np.round(qpos[:, 7] / 0.02) * 0.02)
    floor = quantisation_noise(MODEL, [(clean.time, qpos, clean.qvel, clean.qvel_measured)])
    assert floor.shape == (2, MODEL.nv)
    assert floor[0, 6] == pytest.approx(0.02 / np.sqrt(12))
    assert (np.delete(floor, 6, 1) < 1e-8).all()
