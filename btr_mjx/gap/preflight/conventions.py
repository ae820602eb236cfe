"""Conventions of positions and commands: does the believed model follow the data much better under another one?

Short predictions of the believed model are compared with the data as they are, and under every alternative of
`alternatives.Catalogue`. One that wins by a wide margin is a fault of the data or the model's frame: no physical effect
turns a sign, a unit or an axis. Alternatives are applied one after another, so that several faults are found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.preflight.alternatives.alternative import Alternative
from btr_mjx.gap.preflight.alternatives.catalogue import Catalogue
from btr_mjx.gap.preflight.alternatives.declared import declared_lines
from btr_mjx.gap.preflight.comparison import Comparison, compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Change, Predictor, typical_error

STRETCHES = 32
_SCREENED = 8
"""Stretches for the first look at all alternatives, and number of alternatives that are looked at again."""

_FEWEST = 5
"""Fewest stretches that can decide."""

_POOR = 0.02
"""A group whose error variance is below this share of its motion is predicted well: its columns are not questioned."""

_POOR_BASE = 5e-4
"""The same for gravity and for the base: in a short flight it moves nearly straight on, whatever its frame is."""

_RATIO = 9.0
"""An alternative must divide the error (rms) of some coordinate by three at least: where the columns of a joint are
wrong, its neighbours may show it more clearly than the joint itself."""

_NO_MOTION = 1.0
"""Error (rms) of a prediction that nothing moves: in a unit that fits, the model predicts better than that."""

_MAX_FAULTS = 8


@dataclass(frozen=True)
class _Fault:
    alternative: Alternative
    found: Comparison
    as_well: str


def position_conventions(dataset: Dataset, noise: Noise) -> list[Finding]:
    """Errors for columns of positions and commands that follow another convention than the documented one."""
    predictor = Predictor(dataset, noise, STRETCHES)
    if len(predictor) < _FEWEST:
        return []
    faults = _faults(dataset, predictor)
    lines, first = _lines(dataset, [fault for fault in faults if not fault.as_well])
    return [
        Finding(
            "error",
            "convention",
            f"{fault.alternative.words}: with that, the believed model predicts {predictor.seconds:.2g} s ahead with "
            f"{fault.found.words()}; {fault.alternative.remedy}{fault.as_well}",
            fault.alternative.remedy,
            fault.found.evidence(),
            lines if fault is first else (),
        )
        for fault in faults
    ]


def _lines(dataset: Dataset, faults: Sequence[_Fault]) -> tuple[tuple[str, ...], _Fault | None]:
    """What to write into dataset.toml for all faults that it can declare, and the first of them."""
    change, first = Change.none(dataset.model), None
    for fault in faults:
        if declared_lines(dataset, fault.alternative.change):
            change, first = fault.alternative.change.after(change), first or fault
    return declared_lines(dataset, change), first


def _faults(dataset: Dataset, predictor: Predictor) -> list[_Fault]:
    catalogue = Catalogue(dataset, predictor.groups)
    screen = predictor.few(_SCREENED)
    applied, out = Change.none(dataset.model), list[_Fault]()
    now = predictor.errors([applied])[0]
    while len(out) < _MAX_FAULTS:
        middle = np.median(now, axis=0)
        order = [int(g) for g in np.argsort(-middle, kind="stable")]
        joints, base = ([g for g in order if middle[g] > limit] for limit in (_POOR, _POOR_BASE))
        tried = catalogue.alternatives(joints, base)
        if not tried:
            break
        tried = _screened(screen, applied, tried)
        errors = predictor.errors([a.change.after(applied) for a in tried])
        best = _best(tried, now, errors)
        if best is None:
            break
        index, fault = best
        out.append(fault)
        applied, now = tried[index].change.after(applied), errors[index]
    return out


def _screened(screen: Predictor, applied: Change, tried: Sequence[Alternative]) -> list[Alternative]:
    """The alternatives with the largest gain in few stretches, and the nuisances of their groups."""
    errors = screen.errors([applied, *(a.change.after(applied) for a in tried)])
    every = range(errors.shape[2])
    gains = [_gain(errors[0], errors[i + 1], every if a.elsewhere else a.groups) for i, a in enumerate(tried)]
    ranked = [int(i) for i in np.argsort(gains, kind="stable")[::-1] if gains[i] > 0 and not tried[i].nuisance]
    orders = [i for i in ranked if tried[i].topic == "orders"]  # many may be nearly alike
    kept = [tried[i] for i in ranked if i not in orders][:_SCREENED]
    kept += [tried[i] for i in sorted(orders) if gains[i] > 0.5 * gains[orders[0]]]
    groups = {g for a in kept for g in a.groups}
    return kept + [a for a in tried if a.nuisance and set(a.groups) & groups]


def _gain(now: np.ndarray, other: np.ndarray, groups: Sequence[int]) -> float:
    """Median over stretches of the log ratio of the typical errors in some groups."""
    return float(np.median(np.log(typical_error(now, groups) / typical_error(other, groups))))


def _best(tried: Sequence[Alternative], now: np.ndarray, errors: np.ndarray) -> tuple[int, _Fault] | None:
    """The decisive alternative with the smallest error over all groups, and its index."""
    decisive: list[tuple[float, int, _Fault]] = []
    every = range(now.shape[1])
    for i, alternative in enumerate(tried):
        if alternative.nuisance:
            continue
        own = list(alternative.groups)
        found = compare(typical_error(now, own), typical_error(errors[i], own))
        if not (alternative.elsewhere or found.significant):
            continue
        judged = every if alternative.elsewhere else own
        rivals = [errors[k] for k, a in enumerate(tried) if a.nuisance and set(a.groups) & set(own)]
        if not all(_beats(typical_error(errors[i], judged), typical_error(rival, judged)) for rival in rivals):
            continue
        total = float(np.mean(np.log(errors[i])))
        if total > float(np.mean(np.log(now))):
            continue
        shown = max([found, *(compare(now[:, g], errors[i][:, g]) for g in range(now.shape[1]))], key=_strength)
        # Where the motion of one joint among others is larger, an error of the same size is a smaller part of it.
        larger = max(1.0, float(np.abs(alternative.change.qpos.scale).max())) if len(own) < now.shape[1] else 1.0
        needed = _RATIO * larger**2
        shown = found if found.decisive(needed) else shown
        # A smaller unit makes any motion small; an order may be right though the model predicts little.
        moves = alternative.topic != "units" or shown.after < _NO_MOTION
        if shown.decisive(needed) and moves:
            decisive.append((total, i, _Fault(alternative, shown, "")))
    if not decisive:
        return None
    decisive.sort(key=lambda entry: entry[0])
    _, index, fault = decisive[0]
    if fault.alternative.topic == "orders":  # of orders that predict equally well, the first, which is the simplest
        for _, k, simpler in sorted((d for d in decisive if d[2].alternative.topic == "orders"), key=lambda d: d[1]):
            if not compare(typical_error(errors[k], every), typical_error(errors[index], every)).significant:
                return k, simpler
    if len(decisive) > 1:
        other = decisive[1][2]
        if fault.found.after**2 > 0.5 * other.found.after**2 and other.alternative.groups == fault.alternative.groups:
            fault = replace(fault, as_well=f"; equally well: {other.alternative.words}")
    return index, fault


def _beats(after: np.ndarray, rival: np.ndarray) -> bool:
    """Whether errors of a convention are below those of a physical explanation, where the two differ.

    A wrong sign or a tiny unit of a force resembles a motor without force.
    """
    found = compare(rival, after)
    return found.stretches == 0 or found.significant


def _strength(found: Comparison) -> float:
    return found.ratio if found.decisive(_RATIO) else 0.0
