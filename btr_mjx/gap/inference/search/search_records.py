"""Records of the search: the two sides of the split, a judged hypothesis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.refine import Nuisance, Refined
from btr_mjx.gap.windows import Fit, MakeWorld, Windows, relinearised, select_rows, with_fitted_states

MARGIN = 25.0
"""Candidates whose scores differ by less are called equivalent."""


@dataclass(frozen=True)
class Side:
    """Windows on one side of the split, with what is fitted along.

    Attributes:
      windows: linearised around the base.
      nuisance: tolerances, and on the side that is fitted what may be refitted.
    """

    windows: Windows
    nuisance: Nuisance

    def with_fitted_states(self, make: MakeWorld, exact: bool = True) -> "Side":
        """The same with starting states that suit another hypothesis, see `starting_states.with_fitted_states`."""
        return Side(with_fitted_states(self.windows, make, exact), self.nuisance)

    def with_own_directions(self, make: MakeWorld) -> "Side":
        """The same around a hypothesis whose starting states were fitted, with their directions in its own world."""
        windows = relinearised(self.windows, make)
        return Side(windows, self.nuisance.projected(windows.basis))

    def based(self, make: MakeWorld) -> "Side":
        """The same with another hypothesis as base of its windows, see `Windows.based`."""
        return Side(self.windows.based(make), self.nuisance)

    def mixed(self, others: Sequence["Side"], chosen: np.ndarray) -> "Side":
        """The same with some windows as others have them, see `Windows.mixed`."""
        windows = self.windows.mixed([side.windows for side in others], chosen)
        if windows.basis is self.windows.basis:
            return Side(windows, self.nuisance)
        columns, gram = (
            select_rows(getattr(self.nuisance, name), [getattr(side.nuisance, name) for side in others], chosen)
            for name in ("columns", "gram")
        )
        return Side(windows, Nuisance(columns, self.nuisance.precision, gram))

    def some(self, index: np.ndarray) -> "Side":
        """Some of the windows."""
        return Side(self.windows.some(index), self.nuisance.some(index))


def nearest(sides: Sequence[Side]) -> Side:
    """Every window as that side has it from which the simulation comes nearest to the data.

    What the starting state could still explain is left out of this comparison: where a foot touches at another time,
    the linear picture of it promises what it cannot keep.

    Args:
      sides: with the same base and the same windows, from different starting states.
    """
    raw = [(side.windows.raw**2).sum(1) for side in sides]
    return sides[0].mixed(sides[1:], np.argmin(raw, 0))


Started = tuple[Hypothesis, list[np.ndarray]]
"""A hypothesis, and the free numbers from which its refinement may start."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A refined hypothesis and what the data say of it.

    Attributes:
      hypothesis: with its refined values.
      refined: on the recordings to fit.
      gain: fall of the loss there against the reference, in units of the dispersion.
      held_out: fall of the loss on the held-out recordings.
      score: gain on both, less what its numbers cost.
      residual: (W, R) on the held-out windows.
      fits: of both sides, with the tolerances at their best.
      sides: of the split, with the starting states that it was judged with.
      references: fits of the believed model on both sides, with starting states found in the same way.
    """

    hypothesis: Hypothesis
    refined: Refined
    gain: float
    held_out: float
    score: float
    residual: np.ndarray
    fits: tuple[Fit, Fit]
    sides: tuple[Side, Side]
    references: tuple[Fit, Fit]

    @property
    def name(self) -> str:
        """The hypothesis' name."""
        return self.hypothesis.name
