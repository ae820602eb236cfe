"""What was simulated before: no window is simulated twice from the same state.

Hypotheses are compared from starting states that they share, and in most windows two sets of starting states are the
same: of all that a search asks for, a tenth has been answered before. A row of a batch knows nothing of the others, so
that an answer that is remembered is the one that would be found again, to the bit.
"""

from collections.abc import Callable, Hashable, Sequence
from threading import Lock

import numpy as np

_MOST = 2**29
"""Bytes of states that are remembered; what comes later is simulated whenever it is asked for."""

Find = Callable[[Sequence[tuple[int, np.ndarray]]], Sequence[np.ndarray]]
"""Simulates: for each (i, rows) the states (len(rows), ...) that hypothesis i takes in these rows."""


class Memory:
    """States that hypotheses took from given starting states.

    Attributes:
      bytes: that are remembered.
    """

    def __init__(self, most: int = _MOST) -> None:
        self.bytes, self._most = 0, most
        self._known: dict[Hashable, dict[bytes, np.ndarray]] = {}
        self._lock = Lock()

    def __call__(self, questions: Sequence[Hashable], keys: Sequence[bytes], find: Find) -> list[np.ndarray]:
        """Answers to some questions, of which only those are simulated that are not known.

        Args:
          questions: one a hypothesis: all that its answers hang on beside the rows.
          keys: (N,) one a row: all that an answer hangs on beside the question.
          find: simulates what is not known.

        Returns:
          For each question states (N, ...).
        """
        tables = [self._known.setdefault(question, {}) for question in questions]
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
