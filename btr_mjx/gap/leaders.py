"""Which candidates of a linear scan are refined by true simulation, and from where."""

from collections.abc import Callable, Sequence

import numpy as np

from btr_mjx.gap.effect import Candidate
from btr_mjx.gap.hypotheses import Hypothesis
from btr_mjx.gap.places import Place
from btr_mjx.gap.refine import Nuisance
from btr_mjx.gap.scanner import Lead
from btr_mjx.gap.score import Fit, robust_gain
from btr_mjx.gap.screening import Entry
from btr_mjx.gap.search_records import Options
from btr_mjx.gap.windows import Windows

_CLAMP_SHARES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
"""Starts of a limit, as parts of the way from where it does nothing to its tightest."""

_EITHER_SIDE = (3.0, -3.0)
"""Where candidates that move contacts are tried, in steps of their first number."""


def pick(
    leads: Sequence[Lead],
    entry: Callable[[Lead], Entry],
    options: Options,
    price: float,
) -> dict[str, list[Lead]]:
    """Leaders by name, each with one or more starts.

    Args:
      leads: of a scan.
      entry: the entry of a lead.
      options: how many.
      price: of one number.
    """

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
    same = [n for n in limits if any(_overlap(entry(by_name[n][0]).candidate.place, p) for p in places)]
    picked = dict.fromkeys([*chosen, *limits[:1], *same[:1]])
    return {name: sorted(by_name[name], key=lambda lead: -entry(lead).probe)[:3] for name in picked}


def starts(leads: Sequence[Lead], entry: Callable[[Lead], Entry]) -> list[np.ndarray]:
    """Values (p,) from which the refinement of one candidate may start: of a limit, all the way to its tightest."""
    own = [lead.values for lead in leads]
    if not any(entry(lead).probe for lead in leads):
        return own
    first = entry(leads[0]).candidate.parameters[0]
    tightest = first.low if first.step < 0 else first.high
    further = [first.null + share * (tightest - first.null) for share in _CLAMP_SHARES]
    return own + [np.array([value, *leads[0].values[1:]]) for value in further]


def contact_scan(
    windows: Windows,
    nuisance: Nuisance,
    start: Hypothesis,
    delicate: Sequence[Candidate],
    cut: float,
    reference: Fit,
) -> list[tuple[float, Candidate, np.ndarray]]:
    """Scan candidates that move contacts by true simulation, as linear signatures mislead there.

    Args:
      windows: where.
      nuisance: what is fitted along there.
      start: what is there already.
      delicate: the candidates.
      cut: chi^2 above which a window counts less.
      reference: fit of what is there already.

    Returns:
      Gain, candidate and its best starting values (p,), best first.
    """
    tries = []
    for candidate in delicate:
        first = candidate.parameters[0]
        for factor in _EITHER_SIDE:
            values = candidate.null
            values[0] = np.clip(first.null + factor * first.step, first.low, first.high)
            tries.append((candidate, values))
    found = windows.residuals([start.with_effect(candidate, values) for candidate, values in tries])
    best: dict[str, tuple[float, Candidate, np.ndarray]] = {}
    for (candidate, values), residual in zip(tries, found, strict=True):
        gain = robust_gain(reference, nuisance.profile(residual, cut), cut)
        if candidate.name not in best or gain > best[candidate.name][0]:
            best[candidate.name] = gain, candidate, values
    return sorted(best.values(), key=lambda row: -row[0])


def _overlap(a: Place, b: Place) -> bool:
    """Whether two places are the same motors or joints."""
    return bool(a.joints) and set(a.joints) == set(b.joints)
