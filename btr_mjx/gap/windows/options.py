"""How much a search may cost."""

from dataclasses import dataclass

import numpy as np

_MUCH = 1.5
"""Of the budget of a search, so many times may be spent before less is spent on what follows."""

_TOO_MUCH = 1.6
"""The same after which only what is likely to change the answer is done."""


@dataclass(frozen=True)
class Options:
    """How much is spent.

    Attributes:
      steps: simulated steps that one search may cost, roughly.
      leaders: candidates that are refined by true simulation.
      contact_leaders: candidates that move contacts that are refined beyond those, by a scan of true simulations.
      iterations: Gauss-Newton steps of a refinement.
      every: candidates that move contacts are scanned on one of so many windows.
      starts: limits are tried from one of so many starts.
    """

    steps: float = 4.4e5
    leaders: int = 6
    contact_leaders: int = 4
    iterations: int = 3
    every: int = 2
    starts: int = 1

    def fewer(self, costly: bool) -> "Options":
        """What is spent on one more effect: about half, and less where the first one was costly."""
        plain, contacts = (3, 4) if costly else (2, 2)
        iterations = max(1, self.iterations - 1) if costly else self.iterations
        leaders, moving = max(1, self.leaders // plain), self.contact_leaders // contacts
        every, starts = contacts * self.every, 2 * self.starts if costly else self.starts
        return Options(self.steps, leaders, moving, iterations, every, starts)

    def much(self, steps: int, nv: int) -> bool:
        """Whether a search has cost so many simulated steps that less is to be spent on what follows."""
        return steps > _MUCH * self.budget(nv)

    def too_much(self, steps: int, nv: int) -> bool:
        """Whether it has cost so many that hardly anything may follow."""
        return steps > _TOO_MUCH * self.budget(nv)

    def budget(self, nv: int) -> float:
        """Simulated steps that may go into a model of `nv` degrees of freedom: small ones step faster."""
        return self.steps * float(np.clip(20.0 / nv, 1.0, 3.2))
