"""Scan: what every candidate would explain beside a hypothesis, by least squares on its columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.forces.evidence import CalibrationPrior, LeastSquares, least_squares
from btr_mjx.gap.forces.unknowns import CandidateColumns


@dataclass(frozen=True, eq=False)
class Scanned:
    """A candidate and what a scan says of it.

    Attributes:
      candidate: the candidate.
      values: its values, where the scan would have them.
      changes: (g,) of the numbers that were named before.
      calibration: (n,) calibration beside it.
      gain: fall of -2 ln p.
      score: the gain less the price of its numbers.
    """

    candidate: Candidate
    values: tuple[float, ...]
    changes: np.ndarray
    calibration: np.ndarray
    gain: float
    score: float


def price(numbers: int, count: int, choices: int) -> float:
    """Price of a name in -2 ln p: Schwarz's for its numbers, and that of the choice among candidates.

    Args:
      numbers: of the effect.
      count: measured values.
      choices: candidates among which it was chosen.
    """
    return numbers * float(np.log(count)) + 2 * float(np.log(choices))


def scan_columns(
    gram: np.ndarray,
    entries: Sequence[CandidateColumns],
    given: np.ndarray,
    calibration: CalibrationPrior,
    count: int,
) -> tuple[LeastSquares, list[Scanned]]:
    """Rank candidates.

    Args:
      gram: (1 + C, 1 + C) of all columns, summed over stretches.
      entries: candidates.
      given: (C, g) columns of what was named before, whose numbers move along.
      calibration: beside them.
      count: measured values.

    Returns:
      The fit without any candidate, and the candidates, best first; a candidate that was tried at several steps once.
    """
    base = least_squares(gram, given, calibration)
    best: dict[str, Scanned] = {}
    choices = len({entry.candidate.name for entry in entries})
    for entry in entries:
        free = entry.design(len(gram) - 1)
        parameters = [p for p in entry.candidate.parameters if not p.shape]
        low, high = (np.array(end) for end in zip(*entry.near, strict=True))
        g = given.shape[1]
        bounds = np.full(g, np.inf)
        fit = least_squares(
            gram, np.concatenate([given, free], 1), calibration, np.r_[-bounds, low], np.r_[bounds, high]
        )
        gain = base.loss - fit.loss
        values = entry.candidate.null
        values[[i for i, p in enumerate(entry.candidate.parameters) if not p.shape]] += fit.values[g:]
        lead = Scanned(
            entry.candidate,
            tuple(float(v) for v in values),
            fit.values[:g],
            fit.calibration,
            gain,
            gain - price(len(parameters), count, choices),
        )
        name = entry.candidate.name
        if name not in best or lead.score > best[name].score:
            best[name] = lead
    return base, sorted(best.values(), key=lambda lead: -lead.score)
