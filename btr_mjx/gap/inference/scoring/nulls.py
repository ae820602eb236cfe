"""Simulated nulls: data in which nothing is missing, taken through the same state estimate as the recordings.

A foot that touches a moment earlier is worth many times the sensors' noise of a light leg, and which of several moments
it was cannot always be found by small steps from a smoothed state. What a null seems to leave holds that, too.
"""

import copy

import numpy as np

from btr_mjx.gap.windows import MakeWorld, Windows, fine_step, fit_starting_states, project
from btr_mjx.models import integrate

_KNOWN = 0.1
"""No direction is less known than this, in units of the noise to the power of -2."""

_STEPS = 3
"""Gauss-Newton steps of the starting states."""


def doubtful(windows: Windows, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Starting states as far from the estimated ones as the true ones may be by the linear picture.

    Args:
      windows: linearised.
      rng: for the draw.

    Returns:
      qpos (W, nq), qvel (W, nv).
    """
    sigma, nv, jacobians = windows.data.sigma, windows.nv, windows.jacobians
    known = np.swapaxes(jacobians, 1, 2) @ jacobians
    axis = np.arange(2 * nv)
    known[:, axis, axis] += (sigma / windows.reach) ** 2
    size, axes = np.linalg.eigh(known)
    draw = rng.standard_normal((len(windows), 2 * nv)) / np.sqrt(np.maximum(size, _KNOWN))
    away = (axes @ draw[..., None])[..., 0] * sigma
    return integrate(windows.models[0], windows.qpos, away[:, :nv]), windows.qvel + away[:, nv:]


def null_residual(windows: Windows, base: MakeWorld, truth: MakeWorld, rng: np.random.Generator) -> np.ndarray:
    """What the believed world leaves of data from another world.

    Args:
      windows: linearised around the believed world; they lend their times, commands and starting states.
      base: the believed world.
      truth: the world that the data come from.
      rng: for starting states and the sensors' noise.

    Returns:
      (W, R) residual in units of the noise, as `Windows.residual`.
    """
    nq, nv, sigma = windows.nq, windows.nv, windows.data.sigma
    # Where steps had to be divided, what is left of their error is part of what a null leaves.
    shows = windows.data.refined_for_contact
    own = fine_step(windows) if shows else windows.step
    states = windows.states([truth], timestep=own, start=doubtful(windows, rng))[0]
    noise = rng.standard_normal((*states.shape[:2], 2 * nv)) * sigma
    other = copy.copy(windows)
    other.target_q = integrate(windows.models[0], states[..., :nq], noise[..., :nv])
    other.target_v = states[..., nq:] + noise[..., nv:]
    correction = windows.correction if shows else np.zeros_like(windows.correction)
    found = other.whiten(fit_starting_states(other, base, _STEPS, windows.base, correction)[2])
    return project(found + correction, windows.basis)
