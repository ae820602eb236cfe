"""Linear scans: which candidates a residual points at, by arithmetic on inner products of their signatures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.inference.scoring.refine import SHOWN, Nuisance
from btr_mjx.gap.inference.scoring.screening import Screen
from btr_mjx.gap.windows import Evidence, fit, scan_candidates, window_weight


@dataclass(frozen=True)
class Lead:
    """A candidate as the linear scan sees it.

    Attributes:
      index: of the candidate.
      gain: reduction of the loss.
      values: (p,) its numbers.
    """

    index: int
    gain: float
    values: np.ndarray


class Scanner:
    """Linear scans of all candidates on residuals of one set of windows.

    Signatures of groups are formed once; every scan is arithmetic on inner products.

    Attributes:
      screened: entries and their signatures.
      nuisance: what is fitted along.
      spans: per entry the numbers of its columns.
    """

    def __init__(self, screened: Screen, nuisance: Nuisance) -> None:
        self.screened, self.nuisance = screened, nuisance
        spans, count = [], 0
        for entry in screened.entries:
            spans.append(np.arange(count, count + len(entry.steps)))
            count += len(entry.steps)
        self.spans = spans
        columns = np.concatenate([screened.signature(i) for i in range(len(screened.entries))])
        self._columns = np.ascontiguousarray(np.moveaxis(columns, 0, 1))  # (W, C, R)
        own = self._columns @ np.swapaxes(self._columns, 1, 2)
        across = self._columns @ np.swapaxes(nuisance.columns, 1, 2)
        self._gram = np.block([[own, across], [np.swapaxes(across, 1, 2), nuisance.gram]]).astype(np.float32)
        self._count = count

    def evidence(self, residual: np.ndarray) -> Evidence:
        """Evidence of a residual (W, R) on all candidates' numbers followed by the nuisances."""
        vector = residual.astype(np.float32)[..., None]
        own = (self._columns @ vector)[..., 0]
        moment = np.concatenate([own, (self.nuisance.columns @ vector)[..., 0]], 1)
        return Evidence((residual**2).sum(1), moment.astype(float), self._gram)

    def left(self, signature: np.ndarray, weights: np.ndarray, precision: np.ndarray) -> np.ndarray:
        """Inner products of what nuisances leave of all candidates' columns, and of a signature.

        Args:
          signature: (W, R).
          weights: (W,) of the windows.
          precision: (N,) of the nuisances' priors; those beyond are left out.

        Returns:
          (C + 1, C + 1), the signature last.
        """
        data, c = self.evidence(signature), self._count
        moment = weights @ data.moment
        gram = np.block(
            [
                [np.tensordot(weights, data.gram, 1), moment[:, None]],
                [moment[None], np.array([[weights @ data.energy]])],
            ]
        )
        own, rest = np.append(np.arange(c), len(gram) - 1), c + np.arange(len(precision))
        block = gram[np.ix_(rest, rest)] + np.diag(precision)
        across = gram[np.ix_(rest, own)]
        block += 1e-12 * np.trace(block) * np.eye(len(block))
        return gram[np.ix_(own, own)] - across.T @ np.linalg.solve(block, across)

    def __call__(
        self,
        residual: np.ndarray,
        cut: float,
        extra: np.ndarray | None = None,
        thorough: int = 40,
        dispersion: float = 1.0,
    ) -> list[Lead]:
        """Scan all candidates.

        Args:
          residual: (W, R).
          cut: chi^2 above which a window counts less.
          extra: (E, W, R) free columns that are fitted along (effects that were found already).
          thorough: so many leaders are fitted again with weights of their own.
          dispersion: chi^2 per degree of freedom that no candidate falls below, beside which tolerances stay tight.

        Returns:
          Leads, best first.
        """
        data = self.evidence(residual)
        nuisance = np.arange(self._count, data.n)
        precision = self.nuisance.precision * dispersion
        if extra is not None and len(extra):
            data = self._extended(data, residual, extra)
            nuisance = np.arange(self._count, data.n)
            precision = np.concatenate([precision, np.zeros(len(extra))])
        alone = fit(data.take(nuisance), precision, cut)
        gains, _ = scan_candidates(data, self.spans, nuisance, precision, window_weight(alone.chi2, cut))
        open_gains, _ = scan_candidates(data, self.spans, nuisance, precision, np.sqrt(window_weight(alone.chi2, cut)))
        half = thorough // 2
        chosen = dict.fromkeys([*np.argsort(-gains)[:half].tolist(), *np.argsort(-open_gains)[:half].tolist()])
        leads = []
        for index in chosen:
            span = self.spans[index]
            low, high = self._bounds(index)
            ends = np.full(len(nuisance), np.inf)
            own = fit(
                data.take(np.concatenate([span, nuisance])),
                np.concatenate([np.zeros(len(span)), precision]),
                cut,
                np.concatenate([low, -ends]),
                np.concatenate([high, ends]),
            )
            size = np.sqrt(np.maximum(data.gram[:, span, span].sum(0), 0.0))
            values = self._values(index, own.values[: len(span)], size)
            leads.append(Lead(index, alone.loss - own.loss, values))
        return sorted(leads, key=lambda lead: -lead.gain)

    def best_left(self, leads: Sequence[Lead], residual: np.ndarray, nuisance: Nuisance, cut: float) -> np.ndarray:
        """Windows' chi^2 (W,) of the lead with the lowest median, in the linear picture.

        Args:
          leads: at least one.
          residual: (W, R).
          nuisance: what is fitted along.
          cut: chi^2 above which a window counts less.
        """
        left = []
        for lead in leads:
            entry = self.screened.entries[lead.index]
            share = (lead.values - entry.candidate.null) / entry.steps
            moved = residual + np.tensordot(share, self.screened.signature(lead.index), 1)
            left.append(nuisance.profile(moved, cut).chi2)
        return min(left, key=np.median)

    def _extended(self, data: Evidence, residual: np.ndarray, extra: np.ndarray) -> Evidence:
        """Evidence with more columns at the end."""
        free = np.moveaxis(extra, 0, 1).astype(np.float32)
        vector = residual.astype(np.float32)[..., None]
        own = self._columns @ np.swapaxes(free, 1, 2)
        across = np.concatenate([own, self.nuisance.columns @ np.swapaxes(free, 1, 2)], 1)  # (W, C, E)
        gram = np.block([[data.gram, across], [np.swapaxes(across, 1, 2), free @ np.swapaxes(free, 1, 2)]])
        moment = np.concatenate([data.moment, (free @ vector)[..., 0]], 1)
        return Evidence(data.energy, moment, gram)

    def _bounds(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of an entry's coefficients, in steps; those of shapes are open, those of probes near 1."""
        entry = self.screened.entries[index]
        low, high = np.full(len(entry.steps), -np.inf), np.full(len(entry.steps), np.inf)
        for i, (parameter, step) in enumerate(zip(entry.candidate.parameters, entry.steps, strict=True)):
            if not parameter.shape:
                low[i], high[i] = sorted(
                    ((parameter.low - parameter.null) / step, (parameter.high - parameter.null) / step)
                )
        if entry.probe:
            low[0], high[0] = 0.0, 1.5
        return low, high

    def _values(self, index: int, coefficients: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Coefficients in steps as numbers: that of a shape stands for its product with the first number.

        Args:
          index: of the entry.
          coefficients: (n,).
          size: (n,) of what a step does; numbers whose whole range does not show stay where they are.
        """
        entry = self.screened.entries[index]
        values = entry.candidate.null
        for i, parameter in enumerate(entry.candidate.parameters):
            share = coefficients[i]
            if parameter.shape:
                amplitude = coefficients[0] if abs(coefficients[0]) > 0.3 else 0.3 * np.sign(coefficients[0] or 1.0)
                share = coefficients[i] / amplitude
            elif entry.probe and i == 0:
                share = 1.0
            whole = size[i] * (parameter.high - parameter.low) / abs(entry.steps[i])
            if i and whole * max(1.0, abs(coefficients[0])) < SHOWN:
                continue
            values[i] = np.clip(values[i] + share * entry.steps[i], parameter.low, parameter.high)
        return values
