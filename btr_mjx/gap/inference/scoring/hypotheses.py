"""Free numbers of hypotheses with their bounds, and the refit of the believed ones."""

from collections.abc import Collection

import numpy as np

from btr_mjx.gap.effects import Hypothesis, believed_steps
from btr_mjx.gap.inference.scoring.refine import Nuisance, Unknowns, refine
from btr_mjx.gap.windows import MakeWorld, Windows, typical_chi2

CONTACT_STEP = 0.15
"""Finite-difference steps of candidates that move contacts are smaller by this factor."""

_REFITS = 6
"""Gauss-Newton steps of a refit of the believed numbers."""


def unknowns(hypothesis: Hypothesis, with_believed: bool, contact_sensitive: Collection[str] = ()) -> Unknowns:
    """The free numbers of a hypothesis with their bounds.

    Args:
      hypothesis: its values are where a search starts.
      with_believed: whether the believed numbers move along.
      contact_sensitive: names of candidates that need smaller finite differences.
    """
    low, high, step = [], [], []
    if with_believed:
        for parameter in hypothesis.parameters:
            low.append(parameter.low)
            high.append(parameter.high)
        step += list(np.abs(believed_steps(hypothesis.parameters, hypothesis.believed)))
    for candidate, _ in hypothesis.effects:
        for own in candidate.parameters:
            low.append(own.low)
            high.append(own.high)
            step.append(abs(own.step) * (CONTACT_STEP if candidate.name in contact_sensitive else 1.0))

    def make(values: np.ndarray) -> MakeWorld:
        return hypothesis.replaced(values, with_believed)

    return Unknowns(np.array(low), np.array(high), np.array(step), make)


def refitted(windows: Windows, base: Hypothesis, cut: float) -> Hypothesis:
    """The believed model with its numbers at their best, by true simulation.

    Args:
      windows: linearised around it.
      base: the believed model.
      cut: chi^2 above which a window counts less, in units of what is typical.
    """
    nothing = Nuisance.nothing(*windows.residual.shape)
    most = cut * typical_chi2((windows.residual**2).sum(1), windows.freedom)
    found = refine(windows, nothing, most, [(unknowns(base, True), [base.values(True)])], _REFITS)[0]
    return base.replaced(found.values, True)
