"""Which candidates of a linear scan are refined by true simulation, and from where."""

from collections.abc import Callable, Sequence

import numpy as np

from btr_mjx.gap.inference.scoring.scanner import Lead
from btr_mjx.gap.inference.scoring.screening import Entry
from btr_mjx.gap.windows import Options

_LIMIT_SHARES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96)
"""Starts of a limit, as parts of the way from where it does nothing to its tightest."""


def pick(
    leads: Sequence[Lead],
    entries: Sequence[Entry],
    options: Options,
    price: float,
) -> dict[str, list[Lead]]:
    """Leaders by name, each with one or more starts.

    Args:
      leads: of a scan.
      entries: of all candidates.
      options: how many.
      price: of one number.
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
    limits = [name for name in names if any(entry(lead).probe for lead in by_name[name])]
    # A limit looks like a weak motor from afar.
    picked = dict.fromkeys([*chosen, *limits[:1]])
    return {name: sorted(by_name[name], key=lambda lead: -entry(lead).probe)[:3] for name in picked}


def starts(leads: Sequence[Lead], entry: Callable[[Lead], Entry]) -> list[np.ndarray]:
    """Values (p,) from which the refinement of one candidate may start: of a limit, all the way to its tightest.

    Args:
      leads: of the candidate.
      entry: of a lead.
    """
    own = [lead.values for lead in leads]
    if not any(entry(lead).probe for lead in leads):
        return own
    first = entry(leads[0]).candidate.parameters[0]
    tightest = first.low if first.step < 0 else first.high
    further = [first.null + share * (tightest - first.null) for share in _LIMIT_SHARES]
    return own + [np.array([value, *leads[0].values[1:]]) for value in further]
