"""Propagation of perturbations through a window by its transition matrices."""

import numpy as np

from btr_mjx.gap.windows.window_fits import project
from btr_mjx.gap.windows.windows import Windows

_MAX_GROWTH = 3e3
"""Amplification of the noise of the starting state above which the product of transition matrices is not used: beyond
it, signatures by propagation do not agree with simulations."""


def linearisation_holds(jacobians: np.ndarray) -> np.ndarray:
    """Windows in which the linearisation holds: small amplification, or not above the median of all windows.

    The product of transition matrices over several touchdowns grows without bound, unlike the simulation.

    Args:
      jacobians: (W, R, 2 nv), see `jacobian`.

    Returns:
      (W,) bool.
    """
    growth = np.linalg.norm(jacobians, axis=(1, 2))
    return growth <= max(_MAX_GROWTH, float(np.median(growth)))


def jacobian(windows: Windows) -> np.ndarray:
    """Jacobian of the residual with respect to the starting state, by products of transition matrices.

    Args:
      windows: with their transitions.

    Returns:
      (W, R, 2 nv), both sides in units of the noise.
    """
    size = 2 * windows.nv
    carried = np.broadcast_to(np.diag(windows.data.sigma), (len(windows), size, size))
    out = [carried]
    for k in range(windows.k):
        carried = windows.transitions[:, k] @ carried
        out.append(carried)
    return np.swapaxes(windows.scaled(np.moveaxis(np.stack(out, 1), -1, 1)), 1, 2)


def propagate_additions(windows: Windows, injected: np.ndarray) -> np.ndarray:
    """Signatures of additions to the state in every sample interval.

    Args:
      windows: linearised.
      injected: (C, W, k, 2 nv) additions at the end of each interval, in the tangent space.

    Returns:
      (C, W, R) projected signatures in units of the noise, float32.
    """
    injected = np.moveaxis(injected, 0, 2)  # (W, k, C, 2 nv)
    size = 2 * windows.nv
    state = np.zeros((len(windows), injected.shape[2], size))
    rows = np.zeros((injected.shape[2], len(windows), windows.k + 1, size))
    for k in range(windows.k):
        state = state @ np.swapaxes(windows.transitions[:, k], 1, 2) + injected[:, k]
        rows[:, :, k + 1] = np.swapaxes(state, 0, 1)
    return project(windows.scaled(rows).astype(np.float32), windows.basis.astype(np.float32))
