"""Budget of a search."""

from dataclasses import dataclass

import numpy as np

_BUDGET_FACTOR = 1.5
"""Multiple of the budget above which further stages of the search are reduced."""

_FAR_BUDGET_FACTOR = 1.6
"""Multiple of the budget above which only stages that are likely to change the result are run."""


@dataclass(frozen=True)
class Options:
    """Budget of a search.

    Attributes:
      steps: approximate number of simulated steps of a search.
      leaders: number of candidates that are refined by simulation.
      contact_leaders: number of further, contact-sensitive candidates that are refined after a scan by simulation.
      iterations: Gauss-Newton steps of a refinement.
      every: contact-sensitive candidates are scanned on every n-th window.
      starts: limits are fitted from every n-th starting value.
    """

    steps: float = 4.4e5
    leaders: int = 6
    contact_leaders: int = 4
    iterations: int = 3
    every: int = 2
    starts: int = 1

    def fewer(self, costly: bool) -> "Options":
        """Options for the search of a further effect: about half the budget, less if the first one was costly."""
        plain, contacts = (3, 4) if costly else (2, 2)
        iterations = max(1, self.iterations - 1) if costly else self.iterations
        leaders, moving = max(1, self.leaders // plain), self.contact_leaders // contacts
        every, starts = contacts * self.every, 2 * self.starts if costly else self.starts
        return Options(self.steps, leaders, moving, iterations, every, starts)

    def over_budget(self, steps: int, nv: int) -> bool:
        """Whether so many simulated steps exceed the budget, so that further stages are to be reduced."""
        return steps > _BUDGET_FACTOR * self.budget(nv)

    def far_over_budget(self, steps: int, nv: int) -> bool:
        """Whether so many simulated steps exceed the budget far, so that only essential stages may follow."""
        return steps > _FAR_BUDGET_FACTOR * self.budget(nv)

    def budget(self, nv: int) -> float:
        """Budget in simulated steps for a model of `nv` degrees of freedom; larger for small models."""
        return self.steps * float(np.clip(20.0 / nv, 1.0, 3.2))
