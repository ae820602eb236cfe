"""Progress bars on stderr, and interrupts that stop a run at a safe point.

Bars are made by tqdm. Where stderr is not a terminal, nothing is shown by default; on request, plain lines are printed
at intervals, as for a log file.
"""

import math
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from tqdm import tqdm

from btr_mjx.errors import Interrupted

LINE_INTERVAL = 10.0
"""Time between the lines that replace a bar where there is no terminal [s]."""


def note(message: str) -> None:
    """Print a line on stderr without disturbing a progress bar that is being drawn."""
    tqdm.write(message, file=sys.stderr)


def progress(
    iterable: Iterable[Any] | None = None,
    *,
    total: int | None = None,
    description: str | None = None,
    unit: str = "it",
    unit_scale: bool = False,
    show: bool | None = None,
    bar_format: str | None = None,
    interval: float = LINE_INTERVAL,
    file: TextIO | None = None,
) -> Any:
    """A progress bar with rate and time left; iterate over it, or use it as a context manager and call `update(n)`.

    Bars may be nested: on a terminal inner bars are drawn below and removed at their end; in a log each prints lines.

    Args:
      iterable: what to iterate over; None for a bar that is advanced by `update`.
      total: number of units; taken from the iterable where it has a length.
      description: text in front of the bar.
      unit: what is counted, e.g. "pairs".
      unit_scale: write 1234567 as 1.23M.
      show: True: always (lines where there is no terminal); False: never; None: on a terminal only.
      bar_format: of tqdm; None for its own.
      interval: minimum time between two lines [s].
      file: output stream; None means stderr.

    Returns:
      A tqdm bar (`update`, `set_postfix`, `close`); one that prints nothing if it is not shown.
    """
    stream = sys.stderr if file is None else file
    terminal = hasattr(stream, "isatty") and stream.isatty()
    scaled = {"iterable": iterable, "total": total, "desc": description, "unit": unit, "unit_scale": unit_scale}
    scaled["bar_format"] = bar_format
    if show is False or (show is None and not terminal):
        return tqdm(disable=True, **scaled)
    if terminal:
        return tqdm(file=stream, leave=None, dynamic_ncols=True, **scaled)
    return _LineBar(file=_Lines(stream), mininterval=interval, miniters=1, position=0, leave=True, **scaled)


def say_progress(bar: Any, text: str, numbers: bool = True) -> None:
    """Change what a bar says.

    Args:
      bar: of `progress`.
      text: in front of the numbers.
      numbers: whether count, rate and time left are shown; not where they would mean nothing.
    """
    bar.bar_format = None if numbers else "{desc}"
    (bar.set_description if numbers else bar.set_description_str)(text)


class _Lines:
    """A stream for tqdm in which every redraw is a line of its own and cursor movements are dropped."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        text = text.strip("\r\n ")
        if text:
            self._stream.write(text + "\n")

    def flush(self) -> None:
        self._stream.flush()


class _LineBar(tqdm):
    """tqdm that prints a line at the beginning, at intervals and at the end."""

    _drawn = -math.inf

    def refresh(self, *args: Any, **options: Any) -> None:
        # set_description() requests a redraw each time, which would print a line each time
        if self._time() - self._drawn >= self.mininterval:
            self._drawn = self._time()
            self.display()

    @staticmethod
    def format_meter(*args: Any, **options: Any) -> str:
        # set_description() has appended ": ", which is written again where no total is known
        return tqdm.format_meter(*args, **options | {"prefix": (options.get("prefix") or "").removesuffix(": ")})


class StopRequest:
    """Whether a signal asked the run to stop; see `graceful_interrupt`."""

    def __init__(self) -> None:
        self.signum: int | None = None
        self._anywhere = False

    @property
    def requested(self) -> bool:
        """True after the first signal; for loops that poll."""
        return self.signum is not None

    def checkpoint(self) -> None:
        """Stop here if a stop was requested; to be called where everything is saved.

        Raises:
          Interrupted: a signal has arrived.
        """
        if self.signum is not None:
            raise Interrupted(f"stopped at a safe point ({signal.Signals(self.signum).name})", self.signum)

    @contextmanager
    def anywhere(self) -> Iterator[None]:
        """A block in which every point is safe, as all that counts is in complete files: one signal stops it at once.

        Threads of the block stop at their next `checkpoint()`.

        Raises:
          Interrupted: a signal arrives in the block, or has arrived before.
        """
        self.checkpoint()
        before, self._anywhere = self._anywhere, True
        try:
            yield
        finally:
            self._anywhere = before

    def _handle(self, signum: int, frame: Any) -> None:
        first, self.signum = self.signum is None, signum
        if not first or self._anywhere:
            raise Interrupted(f"stopped at once ({signal.Signals(signum).name})", signum)
        # Not print: the signal may have interrupted a buffered write to the same stream.
        with suppress(OSError, ValueError):
            os.write(2, b"\nstopping at the next safe point; once more to stop at once\n")


@contextmanager
def graceful_interrupt() -> Iterator[StopRequest]:
    """Let SIGINT and SIGTERM stop the block at its next safe point instead of anywhere.

    The first signal sets `requested` and makes the next `checkpoint()` raise; the second raises `Interrupted` at once,
    that is, as soon as a compiled call in progress returns to Python. The previous handlers are restored when the block
    ends. Within another `graceful_interrupt` the outer request is shared. Outside the main thread, where Python allows
    no signal handlers, no stop is ever requested.

    Raises:
      Interrupted: from `checkpoint()`, or anywhere in the block on the second signal.
    """
    outer = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
    if isinstance(outer, StopRequest):
        yield outer
        return
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.signal(number, request._handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            # None: the handler was not installed from Python and cannot be restored
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
