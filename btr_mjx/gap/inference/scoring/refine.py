"""Refinement by true simulation: Gauss-Newton steps of many hypotheses side by side, within bounds.

Linear signatures choose the leaders but mislead around touchdown, saturation and sticking. Every leader is therefore
simulated, with the tolerances refitted at each step. Leaders advance in lockstep, so that each round of all of them
is one batch.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.windows import Evidence, Fit, MakeWorld, Windows, fit, project

_PATIENCE = 3
"""Rounds before a search may be given up: its starts, its derivatives and one step."""

_BEHIND = 0.4, 40.0
"""A search whose gain is less than this part of the best one, less this much, is given up."""

AGAIN = 2, 1
"""Steps from numbers that were refined before; of what moves contacts, where derivatives lead nowhere."""

SHOWN = 0.1
"""What a number does to a residual over all its range, in units of the noise, at least: chi^2 of a hundredth."""

_STANDSTILL = 0.5
"""A step that gains less is the last, and one that promises less is not taken, in units of what a degree of freedom
typically contributes to chi^2."""


_HELD = 1e4
"""Precision of a tolerance that is not to move; that of others is about 1."""


@dataclass(frozen=True)
class Nuisance:
    """What is fitted along with every hypothesis.

    Attributes:
      columns: (W, N, R) signatures, window first.
      precision: (N,) of their Gaussian priors around zero.
      gram: (W, N, N) inner products of the columns.
    """

    columns: np.ndarray
    precision: np.ndarray
    gram: np.ndarray

    @classmethod
    def of(cls, signatures: np.ndarray, precision: np.ndarray) -> "Nuisance":
        """The nuisance of some signatures (N, W, R)."""
        columns = np.ascontiguousarray(np.moveaxis(signatures, 0, 1))
        return cls(columns, precision, (columns @ np.swapaxes(columns, 1, 2)).astype(float))

    @classmethod
    def nothing(cls, windows: int, rows: int) -> "Nuisance":
        """None at all, for residuals (windows, rows)."""
        return cls.of(np.zeros((0, windows, rows), np.float32), np.zeros(0))

    def against(self, dispersion: float) -> "Nuisance":
        """The same where no model comes nearer to the data than `dispersion` (chi^2 per degree of freedom).

        Residuals that are not noise must not pull tolerances beyond what calibration leaves.
        """
        return Nuisance(self.columns, self.precision * dispersion, self.gram)

    def projected(self, basis: np.ndarray) -> "Nuisance":
        """The same where other directions (W, R, D) are projected out, see `window_fits.project`."""
        return Nuisance.of(project(np.moveaxis(self.columns, 1, 0), basis).astype(self.columns.dtype), self.precision)

    def without(self, index: Sequence[int]) -> "Nuisance":
        """The same where some columns may hardly move: a number that is free needs no tolerance beside it.

        The linear picture of a tolerance would vie with true simulation for what a large value explains.
        """
        if not len(index):
            return self
        precision = self.precision.copy()
        precision[list(index)] = _HELD
        return Nuisance(self.columns, precision, self.gram)

    def some(self, index: np.ndarray) -> "Nuisance":
        """Those of some windows that stand for all: priors weigh less, as the loss is that of fewer windows."""
        share = len(index) / max(len(self.columns), 1)
        return Nuisance(self.columns[index], self.precision * share, self.gram[index])

    def evidence(self, residual: np.ndarray, columns: np.ndarray) -> Evidence:
        """Evidence of a residual (W, R) on free columns (P, W, R) followed by the nuisances."""
        free = np.moveaxis(columns, 0, 1).astype(self.columns.dtype)  # (W, P, R)
        vector = residual.astype(self.columns.dtype)[..., None]
        across = free @ np.swapaxes(self.columns, 1, 2)
        gram = np.block([[free @ np.swapaxes(free, 1, 2), across], [np.swapaxes(across, 1, 2), self.gram]])
        moment = np.concatenate([free @ vector, self.columns @ vector], 1)[..., 0]
        return Evidence((residual**2).sum(1), moment.astype(float), gram.astype(float))

    def profile(self, residual: np.ndarray, cut: float) -> Fit:
        """The nuisances at their best for a residual (W, R)."""
        return fit(self.evidence(residual, np.zeros((0, *residual.shape))), self.precision, cut)

    def absorbed(self, residual: np.ndarray, cut: float) -> np.ndarray:
        """The residual (W, R) with the nuisances at their best."""
        return residual + np.einsum("wnr,n->wr", self.columns, self.profile(residual, cut).values)


@dataclass(frozen=True)
class Unknowns:
    """The free numbers of a hypothesis.

    Attributes:
      low, high: (P,) bounds.
      step: (P,) of finite differences.
      make: values (P,) -> the hypothesis' world maker.
    """

    low: np.ndarray
    high: np.ndarray
    step: np.ndarray
    make: Callable[[np.ndarray], MakeWorld]


@dataclass(frozen=True)
class Refined:
    """A refined hypothesis.

    Attributes:
      values: (P,).
      loss: its bounded loss with the tolerances at their best.
      residual: (W, R) by true simulation.
      columns: (P, W, R) derivatives of the residual with respect to the values, at or near them.
      chi2: (W,) with the tolerances at their best.
    """

    values: np.ndarray
    loss: float
    residual: np.ndarray
    columns: np.ndarray
    chi2: np.ndarray


def refine(
    windows: Windows,
    nuisance: Nuisance | Sequence[Nuisance],
    cut: float,
    hypotheses: Sequence[tuple[Unknowns, Sequence[np.ndarray]]],
    iterations: int | Sequence[int] = 3,
    reference: Fit | None = None,
) -> list[Refined]:
    """Refine hypotheses side by side.

    Args:
      windows: the data.
      nuisance: what is fitted along, the same with all or with each of them.
      cut: chi^2 above which a window counts less.
      hypotheses: unknowns and one or more starting values of each; the best start is taken.
      iterations: largest number of Gauss-Newton steps, of all or of each.
      reference: fit without any of them; where given, losses are compared with it window by window, and hypotheses
        that fall far behind the best are given up early.

    Returns:
      One result per hypothesis.
    """
    along = [nuisance] * len(hypotheses) if isinstance(nuisance, Nuisance) else nuisance
    most = [iterations] * len(hypotheses) if isinstance(iterations, int) else iterations
    searches = [
        _search(unknowns, starts, own, cut, count, reference)
        for (unknowns, starts), own, count in zip(hypotheses, along, most, strict=True)
    ]
    out: list[Refined | None] = [None] * len(searches)
    wanted = {i: next(search)[0] for i, search in enumerate(searches)}
    rounds = 0
    while wanted:
        rounds += 1
        makes = [hypotheses[i][0].make(values) for i, rows in wanted.items() for values in rows]
        found = windows.residuals(makes)
        first = 0
        coming: dict[int, list[np.ndarray]] = {}
        for i, rows in wanted.items():
            answer = found[first : first + len(rows)]
            first += len(rows)
            try:
                coming[i], out[i] = searches[i].send(answer)
            except StopIteration as stop:
                out[i] = stop.value
        if reference is not None and rounds > _PATIENCE:
            gains = {i: reference.loss - result.loss for i, result in enumerate(out) if result is not None}
            least = _BEHIND[0] * max(gains.values()) - _BEHIND[1]
            coming = {i: rows for i, rows in coming.items() if gains[i] >= least}
        wanted = coming
    return [result for result in out if result is not None]


def _search(
    unknowns: Unknowns,
    starts: Sequence[np.ndarray],
    nuisance: Nuisance,
    cut: float,
    iterations: int,
    reference: Fit | None,
) -> Generator[tuple[list[np.ndarray], "Refined | None"], list[np.ndarray], "Refined"]:
    """Gauss-Newton of one hypothesis; yields the values to simulate and where it is, and is sent their residuals."""
    tries = [np.clip(start, unknowns.low, unknowns.high) for start in starts]
    found = yield tries, None
    scored = [_loss(nuisance, cut, residual, reference) for residual in found]
    best = int(np.argmin([loss for loss, _ in scored]))
    values, residual, (loss, chi2) = tries[best], found[best], scored[best]
    columns = np.zeros((len(values), *residual.shape), np.float32)
    enough = _STANDSTILL * max(1.0, cut / residual.shape[1])
    for _ in range(iterations):
        steps = nudges(unknowns, values)
        now = Refined(values, loss, residual, columns, chi2)
        found = yield [values + step for step in steps], now
        columns = answers(unknowns, residual, found, steps)
        data = nuisance.evidence(residual, columns)
        size = len(values)
        ends = np.full(data.n - size, np.inf)
        ahead = fit(
            data,
            np.concatenate([np.zeros(size), nuisance.precision]),
            cut,
            np.concatenate([unknowns.low - values, -ends]),
            np.concatenate([unknowns.high - values, ends]),
        )
        step = ahead.values[:size]
        here = nuisance.profile(residual, cut).loss
        if here - ahead.loss < enough or not np.any(np.abs(step) > 1e-3 * unknowns.step):
            break
        gained = 0.0
        for share in (1.0, 0.4):
            trial = np.clip(values + share * step, unknowns.low, unknowns.high)
            found = yield [trial], Refined(values, loss, residual, columns, chi2)
            trial_loss, trial_chi2 = _loss(nuisance, cut, found[0], reference)
            if trial_loss < loss:
                gained = loss - trial_loss
                values, residual, loss, chi2 = trial, found[0], trial_loss, trial_chi2
                break
        if gained < enough:
            break
    return Refined(values, loss, residual, columns, chi2)


def _loss(nuisance: Nuisance, cut: float, residual: np.ndarray, reference: Fit | None) -> tuple[float, np.ndarray]:
    found = nuisance.profile(residual, cut)
    loss = found.loss if reference is None else reference.loss - robust_gain(reference, found, cut)
    return loss, found.chi2


def answers(
    unknowns: Unknowns, residual: np.ndarray, nudged: Sequence[np.ndarray], steps: Sequence[np.ndarray]
) -> np.ndarray:
    """What each number does to a residual, per unit (n, W, R); nothing where all its range does not show.

    A planar robot does not tell where across its plane a payload sits. What rounding makes of that would drive the
    number to a bound.
    """
    columns = np.stack([(e - residual) / step.sum() for e, step in zip(nudged, steps, strict=True)])
    shown = np.linalg.norm(columns, axis=(1, 2)) * (unknowns.high - unknowns.low)
    columns[shown < SHOWN] = 0.0
    return columns


def nudges(unknowns: Unknowns, values: np.ndarray) -> list[np.ndarray]:
    """One finite-difference step per unknown, away from a bound that is too close."""
    size = unknowns.step * np.clip(0.25 * np.abs(values) / unknowns.step, 0.25, 1.0)
    size = np.where(values + size <= unknowns.high, size, -size)
    return [np.where(np.arange(len(values)) == i, size, 0.0) for i in range(len(values))]
