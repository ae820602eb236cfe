"""How far a search is: a share of its work, estimated from its phases and from the steps that were simulated."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btr_mjx.gap.simulate.journal import Journal
from btr_mjx.runs import progress

_PARTS = {
    "effects of the library": 0.14,
    "effects": 0.45,
    "held-out recordings": 0.02,
    "numbers": 0.9,
    "state estimates": 0.02,
    "windows": 0.01,
    "linearisation": 0.13,
    "signatures": 0.42,
    "leaders": 0.4,
    "each beside the others": 0.2,
    "lack of fit": 0.9,
    "next experiment": 1.0,
}
"""Part of the time left that a phase of a search takes, in the order of phases: first of robots that touch nothing,
then of others. Set by `python -m btr_mjx.diagnose --demo --robot ROBOT` with arm, pendulum and quadruped."""

_OTHER = 0.1
"""The same of a phase that is not listed, such as one more effect."""

_FIRST_STEPS = 4e5
"""Steps of a first phase that says nothing of them: about those of a quadruped."""

_STEADY = 0.8
"""Part of a phase up to which its share grows in proportion to its steps; it nears its end slowly from there on, as the
number of its steps is an estimate."""


class SearchShare:
    """The part of a search that is done, from 0 to 1; it never falls.

    Every phase takes a part of what is left, so that nothing needs to be known of how many rounds there will be.
    """

    def __init__(self, total: int | None = None) -> None:
        """Begin.

        Args:
          total: steps of the search, where they are known: phases do not matter then.
        """
        self._total = total
        self._first, self._last, self._begun = 0.0, 0.0 if total is None else 1.0, 0
        self._expected = _FIRST_STEPS if total is None else float(max(total, 1))

    def enter(self, phase: str, steps: int) -> None:
        """A phase begins.

        Args:
          phase: its name; "2 of 3: name" where several sets are searched one after another.
          steps: simulated so far.
        """
        if self._total is not None:
            return
        found = re.match(r"(\d+) of (\d+): (.*)", phase)
        index, count, name = (int(found[1]), int(found[2]), found[3]) if found else (1, 1, phase)
        first = max(self._last, (index - 1) / count)
        part = next((part for key, part in _PARTS.items() if name.startswith(key)), _OTHER)
        self._first, self._last = first, first + part * max(0.0, index / count - first)
        self._begun = steps
        # As many steps for a share as so far.
        self._expected = (self._last - first) / first * steps if first > 0 and steps > 0 else _FIRST_STEPS

    def expect(self, steps: float) -> None:
        """Say how many steps the phase that has begun takes, about."""
        if self._total is None:
            self._expected = steps

    def at(self, steps: int) -> float:
        """The share that is done after so many steps."""
        part = max(0.0, steps - self._begun) / max(self._expected, 1.0)
        if part > _STEADY:
            part = 1.0 - (1.0 - _STEADY) * np.exp((_STEADY - part) / (1.0 - _STEADY))
        return float(self._first + part * (self._last - self._first))


@contextmanager
def followed_search(
    folder: Path,
    checkpoint: Callable[[], None],
    *,
    total: int | None = None,
    code: bytes = b"",
    show: bool | None = False,
) -> Iterator[tuple[Journal, Callable[[str], None]]]:
    """Follow a search with a progress bar and keep a journal of it.

    Args:
      folder: of the journal; it stays until `Journal.close`.
      checkpoint: called often; raises Interrupted to stop the search.
      total: steps of the search; None where they are not known, but estimated from phase to phase.
      code: of user-defined effects, see `Journal`.
      show: as of `progress`.

    Yields:
      The journal, and what to call with a word on what is being done.
    """
    share, begun = SearchShare(total), time.monotonic()
    with progress(total=100, description="search", show=show, bar_format=_FORMAT) as bar:
        bar.smoothing, bar.miniters = 0.0, 0

        def say(phase: str) -> None:
            share.enter(phase, journal.steps)
            bar.set_description(phase)
            checkpoint()

        def count(steps: int) -> None:
            rate = tqdm.format_sizeof(steps / max(time.monotonic() - begun, 1e-3))
            bar.set_postfix_str(f"{tqdm.format_sizeof(steps)} steps, {rate} steps/s", refresh=False)
            bar.update(100 * max(0.0, share.at(steps) - bar.n / 100))
            checkpoint()

        journal = Journal(folder, count, code, share.expect)
        yield journal, say
        bar.update(100 - bar.n)


_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
"""Of the bar of a search: what is counted is a share, which has no unit of its own."""
