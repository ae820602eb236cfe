"""Budget of a search."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Options:
    """Budget of a search.

    Attributes:
      steps: approximate number of simulated steps of a search.
      leaders: number of candidates that are refined by simulation.
      contact_leaders: number of further, contact-sensitive candidates that are refined after a scan by simulation.
      iterations: Gauss-Newton steps of a refinement.
      every: contact-sensitive candidates are scanned on every n-th window.
    """

    steps: float = 4.4e5
    leaders: int = 6
    contact_leaders: int = 4
    iterations: int = 3
    every: int = 2

    def fewer(self) -> "Options":
        """Options for the search of a further effect: about half the budget."""
        leaders, moving = max(1, self.leaders // 2), self.contact_leaders // 2
        return replace(self, leaders=leaders, contact_leaders=moving, every=2 * self.every)

    def budget(self, nv: int) -> float:
        """Budget in simulated steps for a model of `nv` degrees of freedom; larger for small models."""
        return self.steps * float(np.clip(20.0 / nv, 1.0, 3.2))
