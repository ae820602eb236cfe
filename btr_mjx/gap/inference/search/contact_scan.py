"""Which candidates that move contacts are refined, found by true simulation: linear pictures mislead there."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from btr_mjx.gap.effects import WORLD, Candidate, Hypothesis
from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.inference.search.line_search import LineSearch
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import project

_Try = tuple[float, Candidate, np.ndarray]
"""Gain, candidate and values (p,)."""

_EITHER_SIDE = (1.0, -1.0)
"""Where candidates that move contacts are tried, in steps of their first number: a small one helps a little wherever
the truth lies beyond half of it, a large one is worse than nothing where the truth is small."""

_AGAIN = 3.0
"""Factor on that, on the better side: near a touchdown a third of the truth may look like nothing."""

_FURTHER = 3
"""Times that this is done with those that still gain by it, at most: a length may be off by a tenth."""

_LONGEST = 2
"""Time steps of the model that one step of the scan takes, at most."""

_WHOLE_RANGE = (-9.0, -3.0, -1.0, 1.0, 3.0, 6.0, 9.0)
"""Factors on a candidate's value where it is tried over its whole range, on either side of its null."""

_BEST = 6
"""So many of them are judged anew, and whatever acts on the world as a whole."""

_SHARE = 0.1
"""Part of the gain of the strongest other candidate that they need, less the following."""

_WORSE = 60.0
"""By so much the truth may fit worse than nothing with the directions of the believed model."""

_ALL_WORSE = 600.0
"""The same of what acts on the world: all feet slip or touch at other times."""

_CLEAR = 100.0
"""Gain beyond which a candidate is tried farther away as long as it gains by it."""


def contact_scan(
    side: Side, start: Hypothesis, contact_sensitive: Sequence[Candidate], cut: float, residual: np.ndarray, every: int
) -> list[_Try]:
    """Scan candidates that move contacts by true simulation, as linear signatures mislead there.

    Args:
      side: windows, and what is fitted along.
      start: what is there already.
      contact_sensitive: the candidates.
      cut: chi^2 above which a window counts less.
      residual: (W, R) of what is there already.
      every: candidates are tried on one of so many windows.

    Returns:
      Gain as if of all windows, candidate and its best starting values (p,), best first.
    """
    own = np.arange(0, len(side.windows), every)
    some = side.some(own)
    reference = some.nuisance.profile(residual[own], cut)
    share = len(own) / len(side.windows)

    def attempt(tries: Sequence[tuple[Candidate, float]]) -> list[_Try]:
        """Simulate candidates at values of their first number, and keep each one's best."""
        rows = []
        for candidate, value in tries:
            values = candidate.null
            values[0] = np.clip(value, candidate.parameters[0].low, candidate.parameters[0].high)
            rows.append((candidate, values))
        windows = some.windows
        step = min(windows.stride, _LONGEST) * windows.dt
        makes = [start, *(start.with_effect(candidate, values) for candidate, values in rows)]
        unmoved, *found = windows.states(makes, timestep=step)
        unmoved = windows.whiten(unmoved)

        def gained(states: np.ndarray) -> float:
            moved = residual[own] + project(windows.whiten(states) - unmoved, windows.basis)
            return robust_gain(reference, some.nuisance.profile(moved, cut), cut) / share

        gains = run_in_threads([partial(gained, states) for states in found])
        best: dict[str, _Try] = {}
        for (candidate, values), gain in zip(rows, gains, strict=True):
            if candidate.name not in best or gain > best[candidate.name][0]:
                best[candidate.name] = gain, candidate, values
        return sorted(best.values(), key=lambda row: -row[0])

    firsts = {candidate.name: candidate.parameters[0] for candidate in contact_sensitive}
    sides = [(c, firsts[c.name].null + sign * firsts[c.name].step) for c in contact_sensitive for sign in _EITHER_SIDE]
    best = {row[1].name: row for row in attempt(sides)}
    nulls = {name: first.null for name, first in firsts.items()}
    leading = list(best.values())
    for _ in range(_FURTHER):
        further = [(c, nulls[c.name] + _AGAIN * (values[0] - nulls[c.name])) for _, c, values in leading]
        leading = []
        for row in attempt(further):
            name, before = row[1].name, best[row[1].name][0]
            best[name] = max(best[name], row, key=lambda r: r[0])
            if row[0] > max(before, _CLEAR):  # a large one gains more the farther it goes
                leading.append(row)
        if not leading:
            break
    return sorted(best.values(), key=lambda row: -row[0])


def with_line_search(
    found: Sequence[_Try], start: Hypothesis, line_search: LineSearch, strongest: float, wide: bool = False
) -> list[_Try]:
    """The best of a scan of contacts, judged with directions of their own, at two sizes.

    Args:
      found: of the scan.
      start: the believed model.
      line_search: of the search.
      strongest: gain of the best other candidate.
      wide: whether what acts on the world is tried over its whole range, whatever the scan says of it.

    Returns:
      The same as `contact_scan`, with the better of both gains.
    """
    needed = _SHARE * strongest
    worth = [row for row in found[:_BEST] if row[0] > needed - _WORSE]
    worth += [row for row in found[_BEST:] if row[1].place == WORLD and row[0] > needed - _ALL_WORSE]
    if wide:
        known = {row[1].name for row in worth}
        worth += [row for row in found if row[1].place == WORLD and row[1].name not in known]

    def judged(candidate: Candidate, values: np.ndarray) -> list[_Try]:
        first, rows = candidate.parameters[0], list[_Try]()
        factors = _WHOLE_RANGE if wide and candidate.place == WORLD else (1.0, _AGAIN)
        for factor in factors:
            value = float(np.clip(first.null + factor * (values[0] - first.null), first.low, first.high))
            tried = np.array([value, *values[1:]])
            rows.append((line_search.gain(start.with_effect(candidate, tried)), candidate, tried))
        return rows

    best = {candidate.name: (gain, candidate, values) for gain, candidate, values in found}
    for rows in run_in_threads([partial(judged, c, values) for _, c, values in worth]):
        name = rows[0][1].name
        best[name] = max(best[name], *rows, key=lambda row: row[0])
    return sorted(best.values(), key=lambda row: -row[0])


def with_contacts(
    tries: Sequence[tuple[Candidate, list[np.ndarray]]], found: Sequence[_Try], most: int
) -> list[tuple[Candidate, list[np.ndarray]]]:
    """Candidates with their starting values, and those that a scan of contacts adds.

    Args:
      tries: of the linear scan.
      found: of the scan of contacts, best first.
      most: so many more, at most.
    """
    out = {candidate.name: (candidate, list(values)) for candidate, values in tries}
    added = 0
    for gain, candidate, values in found:
        known = candidate.name in out
        if gain <= 0 or (added >= most and not known):
            continue
        added += not known
        out.setdefault(candidate.name, (candidate, []))[1].append(values)
    return list(out.values())
