"""Least squares over the samples of a recording, each coupled to the next, with a border of common unknowns."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from btr_mjx.gap.data.base.motion import COMMON, N

_RIDGE = 1e-6
"""Added to the diagonal: what nothing measures keeps its value."""


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Residuals in units of their noise, with derivatives.

    Attributes:
      residual: (n, d).
      sample: (n,) sample on which they depend.
      slope: (n, d, 9) derivatives with respect to the state of this sample.
      border: (n, d, 10) with respect to the common unknowns.
      ahead: (n, d, 9) with respect to the state of the next sample; None where they do not depend on it.
    """

    residual: np.ndarray
    sample: np.ndarray
    slope: np.ndarray
    border: np.ndarray
    ahead: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class BlockSystem:
    """Normal equations whose samples were eliminated: H x = -g for samples x and border y.

    Attributes:
      factor: banded Cholesky factor of the samples' part of H.
      gradient: (9 K,) solution of the samples' part for the gradient; across: (9 K, 10) for the border.
      information: (10, 10) of the border after the samples were eliminated; pull: (10,) its gradient.
    """

    factor: np.ndarray
    gradient: np.ndarray
    across: np.ndarray
    information: np.ndarray
    pull: np.ndarray

    def step(self, border: np.ndarray) -> np.ndarray:
        """(K, 9) changes of the samples for a change (10,) of the border."""
        return -(self.gradient + self.across @ border).reshape(-1, N)

    def covariances(self, samples: np.ndarray, lag: int, border: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Variances (n, 9) of the states at samples, and of their changes after `lag` more.

        Args:
          samples: (n,) of which `lag` more follow.
          lag: number of samples.
          border: (10, 10) covariance of the border.
        """
        own = N * samples[:, None] + np.arange(N)
        later = own + N * lag
        units = np.zeros((len(self.gradient), 2 * own.size))
        columns = np.arange(own.size).reshape(own.shape)
        units[own, columns], units[later, columns + own.size] = 1.0, 1.0
        solved = cho_solve_banded((self.factor, True), units)

        def variance(rows: np.ndarray, columns: np.ndarray, other: np.ndarray) -> np.ndarray:
            return solved[rows, columns] + np.einsum("nia,ab,nib->ni", self.across[rows], border, self.across[other])

        at, after = variance(own, columns, own), variance(later, columns + own.size, later)
        return at, at + after - 2 * variance(own, columns + own.size, later)


def eliminated(
    count: int, rows: Iterable[BlockRows], fixed: np.ndarray, information: np.ndarray, pull: np.ndarray
) -> BlockSystem:
    """Add up rows, and eliminate the states of all samples.

    Args:
      count: number of samples K.
      rows: all residuals.
      fixed: (9,) weights that hold the first sample where it is.
      information: (10, 10) of what is known of the border before.
      pull: (10,) gradient of what is known of the border.

    Raises:
      LinAlgError: residuals are not finite.
    """
    own, next_, across = np.zeros((count, N, N)), np.zeros((count, N, N)), np.zeros((count, N, COMMON))
    gradient, information, pull = np.zeros((count, N)), information.copy(), pull.copy()
    own += _RIDGE * np.eye(N)
    own[0] += np.diag(fixed)
    for part in rows:
        for slope, at in ((part.slope, part.sample), (part.ahead, part.sample + 1)):
            if slope is not None:
                np.add.at(own, at, np.swapaxes(slope, 1, 2) @ slope)
                np.add.at(gradient, at, np.einsum("nda,nd->na", slope, part.residual))
                np.add.at(across, at, np.swapaxes(slope, 1, 2) @ part.border)
        if part.ahead is not None:
            np.add.at(next_, part.sample, np.swapaxes(part.slope, 1, 2) @ part.ahead)
        information += np.einsum("nda,ndb->ab", part.border, part.border)
        pull += np.einsum("nda,nd->a", part.border, part.residual)
    if not np.isfinite(gradient).all():
        raise np.linalg.LinAlgError("residuals are not finite")
    banded = np.zeros((2 * N, N * count))  # lower form: row i - j, column j
    for j in range(N):
        for i in range(j, N):
            banded[i - j, j::N] = own[:, i, j]
        for i in range(N):
            banded[N + i - j, j::N] = next_[:, j, i]
    factor = cholesky_banded(banded, lower=True, check_finite=False)
    flat = across.reshape(-1, COMMON)
    solved = cho_solve_banded((factor, True), np.concatenate([gradient.reshape(-1, 1), flat], 1), check_finite=False)
    return BlockSystem(
        factor,
        solved[:, 0],
        solved[:, 1:],
        information - flat.T @ solved[:, 1:],
        pull - flat.T @ solved[:, 0],
    )
