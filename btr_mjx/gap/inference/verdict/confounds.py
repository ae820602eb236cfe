"""Confounds: what would leave almost the same traces as a named effect, and which believed numbers gave way to it.

A confound is read off the final fit, without another simulation. The effect's signature there, and those of all
candidates and of what may be refitted, are taken after whatever starting states and tolerances could absorb; what is
compared is the rest. A correlation of 1 says that no amount of such data separates the two.
"""

from collections.abc import Collection, Sequence

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.results import Confound, confound_sentence, refit_sentence
from btr_mjx.gap.windows import window_weight

_LEAST = 0.9
"""Correlation from which on a candidate is a confound."""
MOST = 3
"""Confounds that are listed for an effect."""
MOVED = 0.02
"""Change of a believed number that is worth a word, as a share of the way between its bounds."""


def confounds(bench: Bench, base: Hypothesis, named: Sequence[Judged]) -> tuple[Confound, ...]:
    """What could be mistaken for the named effects, the likeliest first.

    Args:
      bench: of the search.
      base: the believed model as it was refitted without any effect.
      named: what was accepted, one after another; the last one holds all effects. Empty for nothing.
    """
    if not named:
        return ()
    final = named[-1]
    nuisance = bench.free(bench.fit)
    weights = window_weight(final.refined.chi2, bench.cut)
    rest = Rest(nuisance.columns, nuisance.precision, weights)
    taken = {candidate.effect.name for candidate, _ in final.hypothesis.effects}
    first = len(final.refined.values) - final.hypothesis.numbers
    out: list[Confound] = []
    for candidate, values in final.hypothesis.effects:
        # What the effect does as it is: its size times the derivative; shape numbers stay as they were found.
        signature = final.refined.columns[first] * (values[0] - candidate.null[0])
        first += len(values)
        found = [*_believed(bench, final, rest, signature), *_candidates(bench, weights, signature, taken)]
        found = sorted((f for f in found if f[1] >= _LEAST), key=lambda f: -f[1])
        kinds: dict[str, Confound] = {}
        for name, correlation, text in found:
            kinds.setdefault(name.partition("@")[0], Confound(candidate.name, name, correlation, text))
        out += list(kinds.values())[:MOST]
    return (*out, *_moved(base, final))


class Rest:
    """What is left of signatures after nuisances with Gaussian priors have absorbed what they can."""

    def __init__(self, nuisance: np.ndarray, precision: np.ndarray, weights: np.ndarray) -> None:
        """Prepare.

        Args:
          nuisance: (W, N, R) columns.
          precision: (N,) of their priors.
          weights: (W,) of the windows.
        """
        self._root = np.sqrt(weights)[:, None]
        flat = np.moveaxis(nuisance * self._root[:, None], 1, 0)
        self._columns = flat.reshape(len(precision), nuisance.shape[0] * nuisance.shape[2])
        block = (self._columns @ self._columns.T).astype(float) + np.diag(precision)
        self._block = block + 1e-12 * np.trace(block) * np.eye(len(block))

    def gram(self, columns: np.ndarray) -> np.ndarray:
        """Inner products (p, p) of what is left of columns (p, W, R)."""
        flat = (columns * self._root).reshape(len(columns), -1).astype(float)
        across = flat @ self._columns.T
        return flat @ flat.T - across @ np.linalg.solve(self._block, across.T)

    def alike(self, signature: np.ndarray, others: np.ndarray) -> tuple[float, np.ndarray]:
        """How well columns (p, W, R) stand in for a signature (W, R), see `closest`."""
        return closest(self.gram(np.concatenate([others, signature[None]])))


def closest(gram: np.ndarray) -> tuple[float, np.ndarray]:
    """How well some columns stand in for another one.

    Args:
      gram: (p + 1, p + 1) inner products, the one that is stood in for last.

    Returns:
      The multiple correlation, in [0, 1], and the factors (p,) of the columns that come closest.
    """
    own, moment, energy = gram[:-1, :-1], gram[:-1, -1], gram[-1, -1]
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    factors = np.linalg.lstsq(own / np.outer(scale, scale), moment / scale, rcond=1e-8)[0] / scale
    explained = float(moment @ factors) / energy if energy > 0 else 0.0
    return float(np.sqrt(np.clip(explained, 0.0, 1.0))), factors


def _candidates(
    bench: Bench, weights: np.ndarray, signature: np.ndarray, taken: Collection[str]
) -> list[tuple[str, float, str]]:
    """Name, correlation and words of candidates of other kinds that may take the size at which they stand in."""
    scanner, out = bench.scanner, []
    gram = scanner.left(signature, weights, bench.free(bench.fit).precision)
    for entry, span in zip(scanner.screened.entries, scanner.spans, strict=True):
        candidate = entry.candidate
        if entry.probe or candidate.effect.name in taken:
            continue
        columns = np.append(span, len(gram) - 1)
        correlation, factors = closest(gram[np.ix_(columns, columns)])
        first, change = candidate.parameters[0], float(factors[0] * entry.steps[0])
        if first.low <= first.null + change <= first.high:
            text = confound_sentence(candidate.effect.name, candidate.place.label, change, correlation)
            out.append((candidate.name, correlation, text))
    return out


def _believed(bench: Bench, final: Judged, rest: Rest, signature: np.ndarray) -> list[tuple[str, float, str]]:
    """The same of believed numbers, where these are refitted together with the effects."""
    out = []
    for i, parameter in enumerate(bench.base.parameters if bench.joint else ()):
        correlation, factors = rest.alike(signature, final.refined.columns[i : i + 1])
        if parameter.low <= final.hypothesis.believed[i] + float(factors[0]) <= parameter.high:
            text = confound_sentence(parameter.name, "", float(factors[0]), correlation)
            out.append((parameter.name, correlation, text))
    return out


def _moved(base: Hypothesis, final: Judged) -> list[Confound]:
    """Believed numbers that moved when the effects entered."""
    out = []
    last = final.hypothesis.believed
    for parameter, before, after in zip(base.parameters, base.believed, last, strict=True):
        if abs(after - before) > MOVED * (parameter.high - parameter.low):
            text = refit_sentence(parameter.name, before, after)
            out.append(Confound(final.hypothesis.name, parameter.name, None, text))
    return out
