"""Backward elimination of effects, and of members of groups, that do not pay beside the others."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.forces.evidence import CalibrationPrior, least_squares
from btr_mjx.gap.forces.points import Fitted, ForceSide, Named
from btr_mjx.gap.forces.predictions import RELATIVE_ERROR
from btr_mjx.gap.forces.scan import price
from btr_mjx.gap.forces.settling import settled

_DOUBT = 9.0
"""Evidence that a number needs beside calibration that may take its place: three standard errors."""

_PASSES = 3
"""Passes of backward elimination."""

_SINGLES = 2
"""Joints of a group that are named one by one, at most."""


def pruned(side: ForceSide, fit: Fitted, null: Fitted) -> Fitted:
    """Backward elimination: effects, and members of groups, that do not pay beside the others go.

    Args:
      side: the recordings to fit.
      fit: with named effects.
      null: without any.
    """
    choices = len({entry.candidate.name for entry in side.library.entries})
    count = fit.whitened.count * len(side.stretches)
    single = {entry.candidate.name: entry.candidate for entry in side.library.entries}
    least = max(price(1, count, choices), RELATIVE_ERROR**2 * (null.loss - fit.loss))
    for _ in range(_PASSES):
        named: Named = ()
        for i in range(len(fit.point.named)):
            named += _simpler(side, fit, i, single, least)
        if not named or named == fit.point.named:
            break
        found = settled(side, replace(fit.point, named=named), fit.variances, about=fit.stretches)
        if found.loss - fit.loss > least * max(1, fit.point.numbers - found.point.numbers):
            break
        fit = found
    return fit


def _simpler(side: ForceSide, fit: Fitted, index: int, single: Mapping[str, Candidate], least: float) -> Named:
    """One of the named effects, or what is left of it where a linear picture says that the rest does not pay."""
    candidate, values = fit.point.named[index]
    if not candidate.place.parts:
        pays = _pays(side, fit, index, list(range(len(values))), least * len(values))
        return (fit.point.named[index],) if pays else ()
    paying = [j for j in range(len(values)) if _pays(side, fit, index, [j], least)]
    if len(paying) > _SINGLES or len(paying) == len(values):
        return (fit.point.named[index],)
    members = candidate.place.members
    return tuple((single[f"{candidate.effect.name}@{members[j]}"], (values[j],)) for j in paying)


def _pays(side: ForceSide, fit: Fitted, index: int, members: Sequence[int], least: float) -> bool:
    """Whether numbers of an effect pay where nothing is badly calibrated, and in doubt where calibration may be."""
    beside, alone = (_lost(side, fit, index, members, calibrated) for calibrated in (True, False))
    return beside > _DOUBT and alone > least


def _lost(side: ForceSide, fit: Fitted, index: int, members: Sequence[int], calibrated: bool) -> float:
    """Rise of -2 ln p where some numbers of an effect go to their null, linearly.

    Args:
      side: the recordings to fit.
      fit: with named effects.
      index: of the effect.
      members: numbers that go.
      calibrated: whether calibration moves along; else it is zero.
    """
    first = sum(len(values) for _, values in fit.point.named[:index])
    candidate, values = fit.point.named[index]
    own = first + np.array(members)
    rest = np.setdiff1d(np.arange(fit.point.numbers), own)
    p, n = fit.point.numbers, len(side.library.calibrated)
    turn = np.eye(1 + p + n)
    if not calibrated:
        turn[1 + p :, 0] = -fit.point.calibration
    whole = turn.T @ fit.whitened.gram.sum(0) @ turn
    turn[1 + own, 0] = (candidate.null - np.array(values))[list(members)]
    without = turn.T @ fit.whitened.gram.sum(0) @ turn
    count = n if calibrated else 0
    design = np.zeros((p + n, count))
    design[p + np.arange(count), np.arange(count)] = 1.0
    if calibrated:
        prior = replace(side.library.calibration, design=design, at=fit.point.calibration)
    else:
        prior = CalibrationPrior(design, *np.zeros((3, 0)))
    every = np.eye(p + n, p)
    return least_squares(without, every[:, rest], prior).loss - least_squares(whole, every, prior).loss
