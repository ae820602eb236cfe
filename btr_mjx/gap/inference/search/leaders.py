"""Which candidates of a linear scan are refined by true simulation, and from where."""

from collections.abc import Callable, Sequence

import numpy as np

from btr_mjx.gap.effects import Place
from btr_mjx.gap.inference.scoring.scanner import Lead
from btr_mjx.gap.inference.scoring.screening import Entry
from btr_mjx.gap.windows import Options

_CLAMP_SHARES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96)
"""Starts of a limit, as parts of the way from where it does nothing to its tightest."""


def pick(
    leads: Sequence[Lead],
    entries: Sequence[Entry],
    options: Options,
    price: float,
    far: bool = False,
) -> dict[str, list[Lead]]:
    """Leaders by name, each with one or more starts.

    Args:
      leads: of a scan.
      entries: of all candidates.
      options: how many.
      price: of one number.
      far: whether all of them leave simulation and data far apart, where the linear picture says little.
    """

    def entry(lead: Lead) -> Entry:
        return entries[lead.index]

    def merit(lead: Lead) -> float:
        return lead.gain - price * len(lead.values)

    by_name: dict[str, list[Lead]] = {}
    for lead in sorted(leads, key=merit, reverse=True):
        by_name.setdefault(entry(lead).candidate.name, []).append(lead)
    names = list(by_name)
    chosen = names[: options.leaders]
    # A limit looks like a weak motor from afar: where a motor leads, its limit is tried as well.
    limits = [name for name in names if any(entry(lead).probe for lead in by_name[name])]
    places = [entry(by_name[name][0]).candidate.place for name in names[:2]]
    same = [n for n in limits if any(_overlap(entry(by_name[n][0]).candidate.place, p) for p in places)][:1]
    if limits and merit(by_name[limits[0]][0]) > 0:
        # The limit of one motor hides that its neighbours have one as well: in the linear picture they cancel, or
        # those that never come near it speak against it.
        groups = _groups(by_name[limits[0]][0], entries)
        for lead in groups:
            by_name.setdefault(entry(lead).candidate.name, []).append(lead)
        same += [entry(lead).candidate.name for lead in groups]
    # Where nearly everything counts less because something is wrong with it, the linear picture sees an effect of all
    # joints at some of them only.
    for lead in _common([by_name[name][0] for name in chosen if merit(by_name[name][0]) > 0], entries):
        name = entry(lead).candidate.name
        by_name.setdefault(name, []).append(lead)
        same.append(name)
    if far:
        # A simulation that follows its commands where the robot could not never comes near the robot's limit.
        unseen = [
            Lead(i, 0.0, own.candidate.null + own.steps)
            for i, own in enumerate(entries)
            if own.probe and any(_overlap(own.candidate.place, p) for p in places)
        ]
        for lead in unseen:
            by_name.setdefault(entry(lead).candidate.name, [lead])
        same += [entry(lead).candidate.name for lead in unseen]
    picked = dict.fromkeys([*chosen, *limits[:1], *same])
    return {name: sorted(by_name[name], key=lambda lead: -entry(lead).probe)[:3] for name in picked}


def _groups(lead: Lead, entries: Sequence[Entry]) -> list[Lead]:
    """The same limit at groups that its motor belongs to, smaller ones first."""
    own = entries[lead.index].candidate
    found: dict[str, int] = {}
    for i, other in enumerate(entries):
        if other.probe and other.candidate.effect is own.effect and _within(own.place, other.candidate.place):
            found.setdefault(other.candidate.name, i)
    size = {i: len(entries[i].candidate.place.joints) for i in found.values()}
    return [Lead(i, 0.0, lead.values) for i in sorted(size, key=lambda i: size[i])][:2]


def _common(leads: Sequence[Lead], entries: Sequence[Entry]) -> list[Lead]:
    """The first effect that leads at several places, at the smallest group of all of them; none where that leads."""
    for lead in leads:
        own = entries[lead.index].candidate
        places = [e.candidate.place for e in (entries[o.index] for o in leads) if e.candidate.effect is own.effect]
        joints = {joint for place in places for joint in place.joints}
        there = [
            i
            for i, other in enumerate(entries)
            if not other.probe and other.candidate.effect is own.effect and joints <= set(other.candidate.place.joints)
        ]
        if len(places) < 2 or not joints or not there:
            continue
        smallest = min(there, key=lambda i: len(entries[i].candidate.place.joints))
        if all(set(entries[smallest].candidate.place.joints) != set(place.joints) for place in places):
            return [Lead(smallest, 0.0, lead.values)]
    return []


def starts(leads: Sequence[Lead], entry: Callable[[Lead], Entry], every: int = 1) -> list[np.ndarray]:
    """Values (p,) from which the refinement of one candidate may start: of a limit, all the way to its tightest.

    Args:
      leads: of the candidate.
      entry: of a lead.
      every: one of so many starts of a limit is taken.
    """
    own = [lead.values for lead in leads]
    if not any(entry(lead).probe for lead in leads):
        return own
    first = entry(leads[0]).candidate.parameters[0]
    tightest = first.low if first.step < 0 else first.high
    further = [first.null + share * (tightest - first.null) for share in _CLAMP_SHARES[::every]]
    return own + [np.array([value, *leads[0].values[1:]]) for value in further]


def _within(a: Place, b: Place) -> bool:
    """Whether the motors or joints of one place are some of another's."""
    return bool(a.joints) and set(a.joints) < set(b.joints)


def _overlap(a: Place, b: Place) -> bool:
    """Whether two places are the same motors or joints."""
    return bool(a.joints) and set(a.joints) == set(b.joints)
