"""Covariance of fitted numbers, which does not assume that what is left is white noise."""

import numpy as np

from btr_mjx.gap.forces.points import Fitted, ForceSide


def covariance(side: ForceSide, fit: Fitted, recording: np.ndarray | None = None) -> np.ndarray:
    """Covariance (p + n, p + n) of the numbers of a fit and of its calibration.

    For every number the larger one of the inverse information and of the sandwich estimate
    H^-1 (sum_s g_s g_s^T) H^-1 with the gradients g_s of the stretches, which holds where stretches differ by more than
    the model says. Given the recording of each stretch, gradients of whole recordings are a third one: stretches of one
    recording err alike.

    Args:
      side: the recordings that were fitted.
      fit: at its numbers.
      recording: (S,) of each stretch; None where only stretches are compared.
    """
    p, cal = fit.point.numbers, side.library.calibration
    gram = fit.whitened.gram[:, 1:, 1:]
    gradient = fit.whitened.gram[:, 1:, 0]
    normal = gram.sum(0)
    normal = normal + np.diag(1e-10 * np.diag(normal) + 1e-300)
    normal[p:, p:] += cal.precision
    inverse = np.linalg.inv(normal)
    variance = np.maximum(_sandwich(inverse, gradient), np.diag(inverse))
    if recording is not None:
        whole = np.stack([gradient[recording == r].sum(0) for r in np.unique(recording)])
        variance = np.maximum(variance, _sandwich(inverse, whole))
    scale = np.sqrt(variance / np.diag(inverse))
    return inverse * scale[:, None] * scale[None, :]


def _sandwich(inverse: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Diagonal of the sandwich estimate with gradients (N, C) of independent parts."""
    count = len(gradient)
    centred = gradient - gradient.mean(0)
    meat = centred.T @ centred * count / max(count - 1, 1)
    return np.diag(inverse @ meat @ inverse)
