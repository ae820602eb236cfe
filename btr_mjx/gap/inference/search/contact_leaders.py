"""Which candidates that move contacts are refined, found by true simulation: linear pictures mislead there."""

from collections.abc import Mapping, Sequence
from functools import partial

import mujoco
import numpy as np

from btr_mjx.gap.effects import WORLD, Candidate, on_same_chain
from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.inference.search.walks import Walks
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

_BEST = 6
"""So many of them are judged anew, and whatever acts on the world as a whole."""

_SHARE = 0.1
"""Part of the gain of the strongest other candidate that they need, less the following."""

_WORSE = 60.0
"""By so much the truth may fit worse than nothing with the directions of the believed model."""

_ALL_WORSE = 600.0
"""The same of what acts on the world: all feet slip or touch at other times."""


_HOPEFUL = 3.0
"""Of `hopes`, beyond which a larger size is tried even where a small one is worse than nothing: a quarter of the
windows are few, and one foot may touch at another time. A true softness had -175 there, 10 in the linear picture."""

_KIN = 100.0
"""Gain of the best of a scan from which on all others on its limb are judged anew, and a smaller size is tried of what
does not keep what the scan promised."""

_SURE = 1000.0
"""Gain in the scan from which on fewer are judged anew, and no larger size is tried of a candidate."""


def contact_scan(
    side: Side, start: Hypothesis, delicate: Sequence[Candidate], cut: float, residual: np.ndarray, every: int
) -> list[_Try]:
    """Scan candidates that move contacts by true simulation, as linear signatures mislead there.

    Args:
      side: windows, and what is fitted along.
      start: what is there already.
      delicate: the candidates.
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

    firsts = {candidate.name: candidate.parameters[0] for candidate in delicate}
    sides = [(c, firsts[c.name].null + sign * firsts[c.name].step) for c in delicate for sign in _EITHER_SIDE]
    best = {row[1].name: row for row in attempt(sides)}
    nulls = {name: first.null for name, first in firsts.items()}
    leading = list(best.values())
    for _ in range(_FURTHER):
        further = [(c, nulls[c.name] + _AGAIN * (values[0] - nulls[c.name])) for _, c, values in leading]
        leading = []
        for row in attempt(further):
            name, before = row[1].name, best[row[1].name][0]
            best[name] = max(best[name], row, key=lambda r: r[0])
            if row[0] > max(before, _KIN):  # a large one gains more the farther it goes
                leading.append(row)
        if not leading:
            break
    return sorted(best.values(), key=lambda row: -row[0])


def judged_anew(
    model: mujoco.MjModel,
    found: Sequence[_Try],
    start: Hypothesis,
    walks: Walks,
    strongest: float,
    hopes: Mapping[str, float] | None = None,
) -> list[_Try]:
    """The best of a scan of contacts, judged with directions of their own, at two sizes.

    Args:
      model: the believed model.
      found: of the scan.
      start: the believed model.
      walks: of the search.
      strongest: gain of the best other candidate.
      hopes: gain of candidates in a linear scan, less their price, in prices of a number, by name; None for none.

    Returns:
      The same as `contact_scan`, with the better of both gains.
    """
    needed = _SHARE * strongest
    sure = bool(found) and found[0][0] > _SURE
    worth = [row for row in found[: _BEST // 2 if sure else _BEST] if row[0] > needed - _WORSE]
    worth += [
        row
        for row in found
        if row[1].place == WORLD and row[0] > needed - _ALL_WORSE and all(row is not own for own in worth)
    ]
    # A strong effect lets a foot touch at another time and hides itself; others on its limb, which do less, show it.
    kin = _kin(model, found, found[:1], strongest)
    worth += [row for row in kin if all(row is not own for own in worth)]
    best = {candidate.name: (gain, candidate, values) for gain, candidate, values in found}

    def judged(candidate: Candidate, values: np.ndarray, near: bool) -> list[_Try]:
        first, rows = candidate.parameters[0], list[_Try]()
        related = near or (hopes or {}).get(candidate.name, 0.0) > _HOPEFUL
        for factor in (1.0, _AGAIN, 1.0 / _AGAIN):
            most = max((row[0] for row in rows), default=-np.inf)
            if factor > 1.0 and most < -_WORSE and not related:
                continue  # with directions of its own a small part of the truth is no worse than nothing
            if factor > 1.0 and best[candidate.name][0] > _SURE:
                continue  # the scan has been there
            if factor < 1.0 and not _KIN < best[candidate.name][0] >= most:
                break  # where it says less than a scan that shows much, that may have gone too far
            value = float(np.clip(first.null + factor * (values[0] - first.null), first.low, first.high))
            small = factor < 1.0 and abs(value - first.null) < 0.99 * abs(first.step)
            if small or any(value == row[2][0] for row in rows):
                continue
            tried = np.array([value, *values[1:]])
            rows.append((walks.gain(start.with_effect(candidate, tried)), candidate, tried))
        return rows

    def judge(tries: Sequence[_Try]) -> None:
        tasks = [partial(judged, c, values, any(c is row[1] for row in kin)) for _, c, values in tries]
        for rows in run_in_threads(tasks):
            name = rows[0][1].name
            best[name] = max(best[name], *rows, key=lambda row: row[0])

    judge(worth)
    # What leads now may not have led the scan.
    first = sorted((best[row[1].name] for row in worth), key=lambda row: -row[0])[:1]
    kin = [row for row in _kin(model, found, first, strongest) if all(row is not own for own in worth)]
    judge(kin)
    return sorted(best.values(), key=lambda row: -row[0])


def _kin(model: mujoco.MjModel, found: Sequence[_Try], leads: Sequence[_Try], strongest: float) -> list[_Try]:
    """All others of a scan on the limb of what leads, where that leads by much."""
    return [
        row
        for gain, leader, _ in leads
        for row in found
        if gain > max(_KIN, strongest) and row[1] is not leader and on_same_chain(model, leader.place, row[1].place)
    ]


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
