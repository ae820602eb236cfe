"""What calibration leaves, beyond the linear picture.

Tolerances are marginalised as signatures, linearly. Where the robot touches the world that is not enough: a length
that is wrong by half a millimetre decides whether a foot touches at all. Draws of all tolerances are therefore truly
simulated, and the directions in which they leave the linear picture count less, window by window.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.scoring.screening import Screen, nuisances
from btr_mjx.gap.windows import Windows, project


def tolerance_draws(
    base: Hypothesis,
    candidates: Sequence[Candidate],
    tolerances: Mapping[str, float],
    rng: np.random.Generator,
    count: int,
) -> list[Hypothesis]:
    """Worlds in which nothing is missing but what calibration leaves.

    Args:
      base: the believed world.
      candidates: all candidates; those with a tolerance are drawn.
      tolerances: of `screening.tolerances_of`.
      rng: for the draws.
      count: number of worlds.
    """
    loose = [c for c in candidates if c.name in tolerances]
    out = []
    for _ in range(count):
        hypothesis = base
        for candidate in loose:
            values, first = candidate.null, candidate.parameters[0]
            values[0] += tolerances[candidate.name] * float(np.clip(rng.standard_normal(), -2.5, 2.5))
            values[0] = np.clip(values[0], first.low, first.high)
            hypothesis = hypothesis.with_effect(candidate, values)
        out.append(hypothesis)
    return out


def nonlinear_directions(windows: Windows, nuisance: Nuisance, draws: Sequence[Hypothesis], cut: float) -> np.ndarray:
    """Directions in which tolerances leave the linear picture, scaled for a soft projection.

    Args:
      windows: the data.
      nuisance: the tolerances' signatures, which absorb the linear part.
      draws: worlds of `tolerance_draws`.
      cut: chi^2 above which a window counts less.

    Returns:
      (W, R, draws) directions; appended to a basis of `project` they divide each by its standard deviation.
    """
    left = []
    for residual in windows.residuals(list(draws)):
        change = residual - windows.residual
        left.append(nuisance.absorbed(change, cut))
    spread = np.moveaxis(np.stack(left), 0, 2) / np.sqrt(len(left))  # (W, R, draws)
    u, s, _ = np.linalg.svd(spread, full_matrices=False)
    shrink = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
    return u * np.sqrt(shrink)[:, None, :]


def with_nonlinear_tolerances(
    windows: Windows,
    base: Hypothesis,
    screened: Screen,
    draws: Sequence[Hypothesis],
    tolerances: Mapping[str, float],
    single: bool,
    cut: float,
) -> tuple[Screen, Nuisance]:
    """Tolerances of some windows, after what they do to contacts has been taken into account there.

    Args:
      windows: linearised; the `nonlinear_directions` count less in them afterwards.
      base: whose believed numbers may be refitted.
      screened: signatures of the candidates, tolerances among them.
      draws: worlds of `tolerance_draws`; none where nothing touches.
      tolerances: of `screening.tolerances_of`.
      single: see `sensitivity.signatures`.
      cut: chi^2 above which a window counts less.

    Returns:
      Signatures without these directions, and the tolerances as nuisances.
    """
    nuisance = nuisances(windows, base, screened, tolerances, single)
    if not draws or not len(nuisance.precision):
        return screened, nuisance
    windows.project_partially(nonlinear_directions(windows, nuisance, draws, cut))
    columns = np.empty_like(screened.columns)
    for i, column in enumerate(screened.columns):
        columns[i] = project(column, windows.partial_basis)
    screened = replace(screened, columns=columns)
    return screened, nuisances(windows, base, screened, tolerances, single)
