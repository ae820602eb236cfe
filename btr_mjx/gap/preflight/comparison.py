"""Paired comparison of two conventions over stretches of recordings.

Both conventions leave an error in each stretch. If they were equally good, each would win a stretch with probability
1/2 (sign test, whatever the distribution of the errors), and the log ratios of the errors would have mean 0 (t test,
which decides with fewer stretches where the ratio is large in all of them). The median ratio says how large the
difference is.
"""

from dataclasses import dataclass

import numpy as np

CHANCE = 1e-5
"""Largest probability of the gain of an alternative by chance: about a hundred alternatives are tried for a dataset, so
that one dataset in a thousand would be accused if stretches were independent and the ratio below did not count."""

_MIN_VALUES = 5
"""Fewest stretches for a t test: the standard deviation of fewer is hardly known."""


@dataclass(frozen=True)
class Comparison:
    """How an alternative compares with the data as they are.

    Attributes:
      ratio: median over stretches of error now / error under the alternative (variances).
      wins: stretches in which the alternative has the smaller error.
      stretches: number of stretches that distinguish the two.
      before, after: median relative error (rms) now and under the alternative.
      chance: probability of such a gain if both were equally good: twice the smaller one of a sign test and a t test.
    """

    ratio: float
    wins: int
    stretches: int
    before: float
    after: float
    chance: float

    @property
    def significant(self) -> bool:
        """Whether the alternative wins, and not by chance."""
        return self.chance < CHANCE

    def decisive(self, ratio: float) -> bool:
        """Whether the alternative wins by this ratio of variances, and not by chance."""
        return self.ratio >= ratio and self.significant

    def evidence(self) -> dict[str, float]:
        """The numbers by name."""
        return {
            "error_now": round(self.before, 6),
            "error_with_remedy": round(self.after, 6),
            "stretches_won": self.wins,
            "stretches": self.stretches,
        }

    def words(self) -> str:
        """The numbers as text."""
        return (
            f"error {_percent(self.after)} of the motion instead of {_percent(self.before)}, smaller in {self.wins} of "
            f"{self.stretches} stretches"
        )


def compare(now: np.ndarray, other: np.ndarray) -> Comparison:
    """Compare relative error variances (W,) of the same stretches; stretches in which they are equal do not count."""
    own = now != other
    if not own.any():
        return Comparison(1.0, 0, 0, float("nan"), float("nan"), 1.0)
    now, other = now[own], other[own]
    return Comparison(
        float(np.median(now / other)),
        int(np.count_nonzero(other < now)),
        len(now),
        float(np.sqrt(np.median(now))),
        float(np.sqrt(np.median(other))),
        min(1.0, 2 * min(_sign_test(now / other), _t_test(np.log(now / other)))),
    )


def _sign_test(ratios: np.ndarray) -> float:
    """Probability of so many ratios above 1 or more, if half of them were to be expected."""
    from scipy.special import betainc

    wins = int(np.count_nonzero(ratios > 1))
    return 1.0 if not wins else float(betainc(wins, len(ratios) - wins + 1, 0.5))


def _t_test(values: np.ndarray) -> float:
    """Probability of so large a mean or a larger one, if values were normal with mean 0."""
    from scipy.special import stdtr

    if len(values) < _MIN_VALUES:
        return 1.0
    spread = float(np.std(values, ddof=1)) / np.sqrt(len(values))
    return float(stdtr(len(values) - 1, -np.mean(values) / max(spread, 1e-300)))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if share < 10 else "more than 1000 %"
