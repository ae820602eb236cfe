"""A claim, its measured statistic and the verdict that follows from the statistic's interval."""

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
"""Sense of a claim -> whether a statistic is on the claimed side of the bound."""

Sense = Literal["at most", "at least", "less than", "more than"]


@dataclass(frozen=True)
class Claim:
    """A claim and its measured statistic.

    Attributes:
      claim: in words.
      measure: name of the statistic, with its unit.
      sense: side of the bound on which the statistic is if the claim holds.
      bound: the bound.
      statistic: over seeds.
      low: lower end of its interval.
      high: upper end.
      seeds: number of seeds that gave a number.
      p: p-value of the paired test, None where there is none.
      why: known reason if the claim does not hold.
      whole: whether searches and seeds are as many as the claim needs. Fewer can confirm it and not refute it.
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
    whole: bool = True

    @property
    def verdict(self) -> str:
        """The verdict of the interval: "holds", "does not", "undecided", "undecided at this size"; see `claims.py`."""
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            return "undecided"
        ends = [SENSES[self.sense](end, self.bound) for end in (self.low, self.high)]
        if all(ends):
            return "holds"
        return "undecided" if any(ends) else "does not" if self.whole else "undecided at this size"

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
