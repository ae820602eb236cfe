"""A table of the force that is missing at a joint and that nothing explains: smooth, and valid where it was measured.

The force is a sum of bumps over position, velocity, load, and over position and velocity together, with these held at
the ends of what was recorded. It says nothing of a cause.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.effect import Candidate, Effect
from btr_mjx.gap.effects.places import Place
from btr_mjx.gap.simulate import Rows, StateLaw, World
from btr_mjx.models import nearest_names, part_names

RESIDUAL = "residual"
"""Name of a table among the terms of a mended model."""


@dataclass(frozen=True, eq=False)
class ResidualTable:
    """A smooth force at a joint.

    Attributes:
      joint: name of the joint.
      low, high: (3,) recorded ranges of position, velocity and load, beyond which nothing is known.
      centres: (n, 3) of the bumps, between 0 and 1 of these ranges; NaN in what a bump does not depend on.
      widths: (n,) of the bumps, in the same unit.
      weights: (n,) [N or N m].
    """

    joint: str
    low: np.ndarray
    high: np.ndarray
    centres: np.ndarray
    widths: np.ndarray
    weights: np.ndarray

    def features(self, q: ArrayLike, v: ArrayLike, load: ArrayLike) -> np.ndarray:
        """Bumps (..., n) at positions, velocities and forces of the actuators."""
        state = np.stack([q, v, load], -1)
        part = np.clip((state - self.low) / np.maximum(self.high - self.low, 1e-12), 0.0, 1.0)
        square = np.nan_to_num((part[..., None, :] - self.centres) ** 2).sum(-1)
        return np.exp(-square / (2 * self.widths**2))

    def as_json(self) -> dict[str, Any]:
        """Its content for mended.json."""
        return {
            "joint": self.joint,
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "centres": [[None if np.isnan(x) else float(x) for x in row] for row in self.centres],
            "widths": self.widths.tolist(),
            "weights": self.weights.tolist(),
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "ResidualTable":
        """A table of mended.json."""
        names = ("low", "high", "centres", "widths", "weights")
        return cls(str(content["joint"]), *(np.array(content[name], float) for name in names))

    def candidate(self, model: mujoco.MjModel) -> Candidate:
        """The table as an effect without free numbers; refuses a model without its joint."""
        names = part_names(model, "joint")
        if self.joint not in names:
            nearest = nearest_names(self.joint, names)
            raise InputError(f"residual: the model has no joint {self.joint!r}; nearest: {nearest}")
        joint = names.index(self.joint)

        def apply(world: World, place: Place, values: np.ndarray) -> None:
            world.laws.append(StateLaw(_add_table, (self, joint)))

        place = Place(f"joint:{self.joint}", joints=(joint,))
        return Candidate(Effect(RESIDUAL, lambda _: [place], lambda *_: (), apply), place, ())


def _add_table(rows: Rows, table: ResidualTable, joint: int) -> None:
    q, v = int(rows.model.jnt_qposadr[joint]), int(rows.model.jnt_dofadr[joint])
    found = table.features(rows.qpos[:, q], rows.qvel[:, v], rows.qfrc_actuator[:, v])
    rows.qfrc_applied[:, v] += found @ table.weights
