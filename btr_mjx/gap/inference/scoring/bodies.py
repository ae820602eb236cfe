"""What a hypothesis leaves at bodies that float: forces and torques on a trunk together, on both sides of the split.

A load that swings in the trunk pulls it along one axis, weighs on it along another and turns it about a third. What a
fixed load leaves of that may be chance at each of them, and is not at all of them together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.inference.scoring.forces import ForceFit, excess, lack_of_fit, usual_excess
from btr_mjx.gap.inference.scoring.gains import without_wildest

_USUAL = 1.0
"""Excess, in a window's own standard deviations, that half of them have where touchdowns are rough. Of six quadrupeds
whose missing effect had been found the most was 0.7, of seven that were rightly "unexplained" the least was 1.9."""


@dataclass(frozen=True)
class AtBody:
    """What is left at one body.

    Attributes:
      body: the body; None where none floats.
      excess: standard deviations by which forces and torques on it explain more than noise.
      chi2: the same, in units of chi^2.
      usual: the excess of a window, in its own standard deviations, that half of them stay below: a load that swings
        does so in most windows, feet of a light leg that come down at another time throw the robot in a few.
    """

    body: int | None = None
    excess: float = 0.0
    chi2: float = 0.0
    usual: float = 0.0


def floating(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Bodies with a free joint, and the degrees of freedom of each."""
    joints = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    return {int(model.jnt_bodyid[j]): [int(model.jnt_dofadr[j]) + i for i in range(6)] for j in joints}


class Bodies:
    """Asks residuals of both sides of the split what they hold at bodies that float."""

    def __init__(self, model: mujoco.MjModel, fits: Sequence[ForceFit]) -> None:
        """Prepare what does not depend on residuals.

        Args:
          model: the believed model.
          fits: unknown forces of the windows of each side.
        """
        self._fits = {body: [fit.at(dofs) for fit in fits] for body, dofs in floating(model).items()}

    def __call__(self, residuals: Sequence[np.ndarray]) -> AtBody:
        """The body at which most is left of residuals (W, R), one for each side."""
        worst = AtBody()
        for body, fits in self._fits.items():
            forces = [fit(residual) for fit, residual in zip(fits, residuals, strict=True)]
            own = lack_of_fit(forces)
            if worst.body is None or own > worst.excess:
                chi2 = sum(float(without_wildest(excess(one))) for one in forces)
                worst = AtBody(body, own, chi2, usual_excess(forces))
        return worst


def usual_needed(rough: bool, nulls: Sequence[AtBody]) -> tuple[float, float]:
    """What half of the windows must show of a lack of fit at a joint, and at a body that floats.

    Args:
      rough: whether touchdowns are; nothing is needed where they are not.
      nulls: what simulated nulls leave at bodies.
    """
    return (_USUAL, max(_USUAL, *(one.usual for one in nulls))) if rough else (-np.inf, -np.inf)
