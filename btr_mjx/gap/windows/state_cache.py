"""Cache in memory of simulated states: no window is simulated twice from the same state.

Rows of a batch are independent of each other, so that a cached result is bit-identical to a new simulation.
"""

from collections.abc import Callable, Hashable, Sequence
from threading import Lock

import numpy as np

_MAX_BYTES = 2**29
"""Largest size of the cache [bytes]; later results are not stored."""

Find = Callable[[Sequence[tuple[int, np.ndarray]]], Sequence[np.ndarray]]
"""Simulates: for each (i, rows) the states (len(rows), ...) of hypothesis i in these rows."""


class StateCache:
    """Cached states of hypotheses, by starting state.

    Attributes:
      bytes: size of the stored states.
    """

    def __init__(self, most: int = _MAX_BYTES) -> None:
        self.bytes, self._most = 0, most
        self._known: dict[Hashable, dict[bytes, np.ndarray]] = {}
        self._lock = Lock()

    def __call__(self, hypotheses: Sequence[Hashable], keys: Sequence[bytes], find: Find) -> list[np.ndarray]:
        """States of hypotheses in some rows; only those that are not cached are simulated.

        Args:
          hypotheses: key of each hypothesis: everything that its states depend on besides the row.
          keys: (N,) key of each row: everything that states depend on besides the hypothesis.
          find: simulates missing states.

        Returns:
          For each hypothesis states (N, ...).
        """
        tables = [self._known.setdefault(hypothesis, {}) for hypothesis in hypotheses]
        known = [np.array([key in table for key in keys], bool) for table in tables]
        wanted = [(i, np.flatnonzero(~own)) for i, own in enumerate(known) if not own.all()]
        found = dict(zip([i for i, _ in wanted], find(wanted), strict=True)) if wanted else {}
        out = []
        for i, (table, own) in enumerate(zip(tables, known, strict=True)):
            rows = iter(found.get(i, ()))
            states = [table[key] if there else next(rows) for key, there in zip(keys, own, strict=True)]
            out.append(np.stack(states))
            if i in found:
                self._keep(table, [key for key, there in zip(keys, own, strict=True) if not there], found[i])
        return out

    def _keep(self, table: dict[bytes, np.ndarray], keys: Sequence[bytes], states: np.ndarray) -> None:
        with self._lock:
            if self.bytes + states.nbytes > self._most:
                return
            self.bytes += states.nbytes
        table.update(zip(keys, states, strict=True))
