"""Two versions compared case by case: McNemar's exact test, the ratio of their CPU time, and what changed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from btr_mjx.errors import InputError
from gates.rows import Row, by_suite, false_of, inside_of, nulls_of, right_of


@dataclass(frozen=True)
class McNemar:
    """Counts of cases that both versions, only the earlier, only the later, or neither had right, and the p-value."""

    both: int
    lost: int
    won: int
    neither: int
    p: float


def mcnemar(before: Sequence[bool], after: Sequence[bool]) -> McNemar:
    """McNemar's exact test of whether two versions are right equally often.

    Args:
      before: whether the earlier version was right, by case.
      after: the same of the later version.

    Returns:
      Counts, and the two-sided p-value.
    """
    counts = Counter(zip(before, after, strict=True))
    both, lost, won, neither = (counts[pair] for pair in ((True, True), (True, False), (False, True), (False, False)))
    return McNemar(both, lost, won, neither, float(binomtest(won, lost + won).pvalue) if lost + won else 1.0)


def cpu_ratio(before: Sequence[float | None], after: Sequence[float | None]) -> tuple[float, float]:
    """CPU time of the later version over that of the earlier one.

    Args:
      before: CPU-seconds by case; None where there is no answer, which leaves the case out.
      after: the same of the later version.

    Returns:
      Geometric mean of the ratios of all cases, and its standard error (by linearisation); NaN where there are too few.
    """
    logs = np.array([np.log(b / a) for a, b in zip(before, after, strict=True) if a and b])
    ratio = float(np.exp(logs.mean())) if len(logs) else float("nan")
    return ratio, ratio * float(logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else float("nan")


def paired(before: Sequence[Row], after: Sequence[Row]) -> list[tuple[Row, Row]]:
    """Rows of the cases that both versions have.

    Raises:
      InputError: there is no such case.
    """
    old = {row.case: row for row in before}
    pairs = [(old[row.case], row) for row in after if row.case in old]
    if not pairs:
        raise InputError("the two versions have no case in common; give --suites and --seed of the earlier one")
    return pairs


def show_pairs(pairs: Sequence[tuple[Row, Row]]) -> None:
    """Print counts of two versions by suite, their tests, and every answer that changed."""
    titles = ("cases", "right", "lost", "won", "p", "false names", "nulls named", "in intervals")
    widths = (6, 22, 6, 5, 9, 13, 19, 23)
    print(f"{'suite':20}" + "".join(f"{t:>{w}}" for t, w in zip(titles, widths, strict=True)) + "   CPU-s after/before")
    old = {row.case: row for row, _ in pairs}
    for suite, after in by_suite([row for _, row in pairs]).items():
        before = [old[row.case] for row in after]
        known = [(b.right, a.right) for b, a in zip(before, after, strict=True) if None not in (b.right, a.right)]
        test = mcnemar([bool(b) for b, _ in known], [bool(a) for _, a in known])
        counts = (f"{count(before)} -> {count(after)}" for count in (false_of, nulls_of, inside_of))
        right = f"{right_of(before)} -> {right_of(after)}"
        cells = (str(len(after)), right, str(test.lost), str(test.won), f"{test.p:.3g}", *counts)
        ratio, error = cpu_ratio([row.cpu_seconds for row in before], [row.cpu_seconds for row in after])
        line = "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))
        print(f"{suite:20}{line}   {ratio:.3f} ± {error:.3f}")
    changed = [(b, a) for b, a in pairs if (b.said, b.named, b.right) != (a.said, a.named, a.right)]
    print(f"\nchanged answers: {len(changed)}")
    for b, a in changed:
        print(f"{a.case}, hidden {a.hidden}: {b.words} -> {a.words}")
