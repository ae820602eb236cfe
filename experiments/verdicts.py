"""A claim, what was measured about it, and the verdict that follows from the interval."""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from curves import interval
from fig3_behaviours import paired

SENSES: dict[str, Callable[[float, float], bool]] = {
    "at most": operator.le,
    "at least": operator.ge,
    "less than": operator.lt,
    "more than": operator.gt,
}
"""What a claim may say about its statistic."""

Sense = Literal["at most", "at least", "less than", "more than"]


@dataclass(frozen=True)
class Claim:
    """A claim and what was measured about it.

    Attributes:
      claim: in words.
      measure: what the statistic is, with its unit.
      sense: how the statistic lies to the bound if the claim holds.
      bound: the bound.
      statistic: over seeds.
      low: lower end of its interval.
      high: upper end.
      seeds: number of seeds that gave a number.
      p: p-value of the paired test, None where there is none.
      why: where the claim does not hold here, what is known of the reason.
    """

    claim: str
    measure: str
    sense: Sense
    bound: float
    statistic: float
    low: float
    high: float
    seeds: int
    p: float | None = None
    why: str = ""

    @property
    def verdict(self) -> str:
        """See the module's docstring."""
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            return "undecided"
        ends = [SENSES[self.sense](end, self.bound) for end in (self.low, self.high)]
        return "holds" if all(ends) else "undecided" if any(ends) else "does not"

    @property
    def row(self) -> dict[str, Any]:
        """For claims.json."""
        first = {name: getattr(self, name) for name in ("claim", "statistic", "low", "high", "verdict")}
        return first | {name: getattr(self, name) for name in ("measure", "sense", "bound", "seeds", "p", "why")}


def claimed(
    claim: str, measure: str, sense: Sense, bound: float, values: Sequence[float], statistic: Any = np.mean
) -> Claim:
    """A claim about a number per seed."""
    found = interval(values, statistic)
    return Claim(claim, measure, sense, bound, found["estimate"], found["low"], found["high"], int(found["seeds"]))


def tested(claim: str, measure: str, sense: Sense, bound: float, differences: Sequence[float]) -> Claim:
    """A claim about paired differences, or trends, within each seed."""
    found = paired(differences)
    numbers = (found["estimate"], found["low"], found["high"], int(found["seeds"]))
    return Claim(claim, measure, sense, bound, *numbers, p=None if np.isnan(found["p"]) else found["p"])
