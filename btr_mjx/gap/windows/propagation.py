"""How what happens in one sample interval carries on to the end of its window, by the windows' transitions."""

import numpy as np

from btr_mjx.gap.windows.likelihood import project
from btr_mjx.gap.windows.windows import Windows

_WILD = 3e3
"""Growth of the starting states' noise from which on transitions of a window may not be multiplied. Of signatures of a
quadruped's joints and motors half agreed with true simulation by 0.98 or better (correlation) in windows in which it
grows less than a thousandfold, by 0.65 from thirty thousandfold on and by 0.2 beyond a millionfold, where they were up
to two thousand times too large. A hexapod's windows hardly ever come near it."""


def tame(jacobians: np.ndarray) -> np.ndarray:
    """Windows (W,) bool in which the linear picture holds, or at least as well as in half of them.

    Every touchdown multiplies what is off at that moment. Where several follow each other the product grows without
    bounds, which a true simulation does not.

    Args:
      jacobians: (W, R, 2 nv), see `jacobian`.
    """
    growth = np.linalg.norm(jacobians, axis=(1, 2))
    return growth <= max(_WILD, float(np.median(growth)))


def jacobian(windows: Windows) -> np.ndarray:
    """How the residual answers to the starting state in units of the noise.

    Args:
      windows: with their transitions.

    Returns:
      (W, R, 2 nv), scaled by the noise of the starting state.
    """
    size = 2 * windows.nv
    carried = np.broadcast_to(np.diag(windows.data.sigma), (len(windows), size, size))
    out = [carried]
    for k in range(windows.k):
        carried = windows.transitions[:, k] @ carried
        out.append(carried)
    answer = np.stack(out, 1) / windows.data.sigma[:, None]  # (W, k + 1, 2 nv, size)
    return answer[:, :, windows.channels].reshape(len(windows), -1, size)


def carry(windows: Windows, injected: np.ndarray) -> np.ndarray:
    """Signatures of what is added to the state over every sample interval.

    Args:
      windows: linearised.
      injected: (C, W, k, 2 nv) additions at the end of each interval.

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
