"""What a search in forces found."""

from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.forces.held_out import HeldOut
from btr_mjx.gap.forces.missing_force import MissingForce
from btr_mjx.gap.forces.points import Fitted, ForceSide, Named
from btr_mjx.gap.forces.scan import Scanned
from btr_mjx.gap.forces.search import SearchRound


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What a search found.

    Attributes:
      rounds: of the search.
      chain: the believed model, and what was named, one after another, all beside calibration.
      calibration: effects with values that the mended model has beside what was named.
      held_out: what held-out recordings say of the first and the last of them.
      errors: (W, nv) mean square errors of predictions of the believed model, the mended one and constant velocity.
      missing: force that the believed model lacks.
      large: (nv,) bool: the random force that is left is no calibration.
      base: the believed model with what was refitted, and with the timing of the commands of these recordings.
      mended: with what was named, in the same way.
      side, test: of the split.
      contradicted: whether more was found than held-out recordings bear out.
      law: that a force which is left follows; None where nothing is.
      forces: the last of the chain, with numbers that do not yet follow recordings.
      law_score: of the best law that is left, told or not.
    """

    rounds: tuple[SearchRound, ...]
    chain: tuple[Fitted, ...]
    calibration: Named
    held_out: tuple[HeldOut, HeldOut]
    errors: tuple[np.ndarray, np.ndarray, np.ndarray]
    missing: MissingForce
    large: np.ndarray
    base: Hypothesis
    mended: Hypothesis
    side: ForceSide
    test: ForceSide
    contradicted: bool
    law: Scanned | None
    forces: Fitted
    law_score: float
