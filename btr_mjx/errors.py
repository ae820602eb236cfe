"""Errors of bad input and of interrupts, and how commands report them.

Four outcomes of a command are not bugs: bad input (exit code 2), a file or folder the operating system refuses (2), an
interrupt (130) and output that nobody reads to the end (141). `cli_errors` turns these into one line on stderr, with
what to write below it where that takes more, and the last into silence; everything else is a bug and keeps its
traceback. Set `BTR_MJX_TRACEBACK=1` to see the traceback of bad input as well.

Inside the package, raise `InputError` (or another ValueError subclass of the package) for whatever a caller can
correct: the message names what was given, what was expected and the remedy. A bare ValueError counts as a bug, because
numpy and the standard library raise it too.
"""

import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

BAD_INPUT_CODE = 2
"""Exit code of a command after bad input."""

MAX_LINE = 1000
"""Most characters of a message; a longer one loses its middle."""

INTERRUPTED_CODE = 130
"""Exit code of a command after an interrupt: 128 + SIGINT."""

WAITING_CODE = 75
"""Exit code of a command that waits for others and is to be run again: EX_TEMPFAIL of sysexits.h."""

UNREAD_CODE = 141
"""Exit code of a command whose output nobody reads to the end, as in `--help | head`: 128 + SIGPIPE."""


class InputError(ValueError):
    """Bad input: the message names what was given, what was expected and the remedy.

    Attributes:
      lines: what to write or to run, where that takes more than the message; commands print it below the message.
    """

    def __init__(self, *message: object, lines: Sequence[str] = ()) -> None:
        super().__init__(*message)
        self.lines = tuple(lines)


class DamagedFile(InputError):
    """A file that was cut short, altered or is of another format; the message begins with its path."""


class Interrupted(KeyboardInterrupt):
    """A signal asked the run to stop. Like KeyboardInterrupt it passes through `except Exception`."""

    def __init__(self, message: str = "interrupted", signum: int | None = None) -> None:
        super().__init__(message)
        self.signum = signum


def is_bad_input(error: BaseException) -> bool:
    """Whether a command reports this as bad input rather than as a bug.

    Counts: OSError, `InputError`, and any other ValueError subclass that is defined in this package.
    """
    ours = type(error).__module__.split(".")[0] == __name__.split(".")[0]
    return isinstance(error, OSError | InputError) or (isinstance(error, ValueError) and ours)


def one_line(error: BaseException) -> str:
    """The error's message on one line; for an OSError the file name comes first and the errno is left out.

    Letters that are not printable, such as those that move a terminal's cursor, are escaped.
    """
    if isinstance(error, OSError) and error.strerror:
        names = [os.fspath(name) for name in (error.filename, error.filename2) if isinstance(name, str | os.PathLike)]
        text = ": ".join([" -> ".join(names), error.strerror] if names else [error.strerror])
    else:
        text = str(error) or type(error).__name__
    text = _printable(" ".join(text.split()))
    return text if len(text) <= MAX_LINE else f"{text[: MAX_LINE - 200]} ... {text[-190:]}"


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def command_line(module: str, words: Sequence[str]) -> str:
    """The shell command that runs a command of this package.

    Under `uv run` it begins with `uv run`, since Python alone would not find this package; where the command was
    started by its own name (btr-coevolve), it has that.

    Args:
      module: name of the command's module, e.g. "btr_mjx.coevolve".
      words: its arguments.
    """
    launcher = ["uv", "run"] if "UV_RUN_RECURSION_DEPTH" in os.environ else []
    script = module.replace("btr_mjx.", "btr-")
    command = [script] if Path(sys.argv[0]).name == script else ["python", "-m", module]
    return shlex.join([*launcher, *command, *words])


def resume_command(module: str, argv: Sequence[str] | None = None, out: str | Path | None = None) -> str:
    """The shell command that continues an interrupted run.

    A resumed run needs the config it began with, so every argument is repeated; see `command_line`.

    Args:
      module: name of the command's module, e.g. "btr_mjx.coevolve".
      argv: its arguments; None means those of this process.
      out: the run folder; added as `--out` where the arguments do not name one.

    Returns:
      For instance "python -m btr_mjx.coevolve --seed 3 --out runs/demo --resume".
    """
    words = [word for word in (sys.argv[1:] if argv is None else argv) if word not in ("--resume", "--no-resume")]
    if out is not None and not any(word == "--out" or word.startswith("--out=") for word in words):
        words += ["--out", str(out)]
    return command_line(module, [*words, "--resume"])


@contextmanager
def cli_errors(resume: str | None = None) -> Iterator[None]:
    """The error boundary of a command; a context manager, also usable as a decorator.

    May be nested: an inner boundary, entered once the run folder is known, can carry the resume command.

    Args:
      resume: command that continues the run, printed after an interrupt (see `resume_command`).

    Raises:
      SystemExit: 2 for bad input (see `is_bad_input`), 130 for an interrupt, 141 where nobody reads the output any
        more. All other errors pass unchanged.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # What is left in the buffer must not fail once more when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(UNREAD_CODE) from None
    except KeyboardInterrupt as interrupt:
        print(f"\n{one_line(interrupt) if str(interrupt) else 'interrupted'}", file=sys.stderr)
        if resume:
            print(f"resume with: {resume}", file=sys.stderr)
        raise SystemExit(INTERRUPTED_CODE) from None
    except Exception as error:
        if not is_bad_input(error) or os.environ.get("BTR_MJX_TRACEBACK", "") not in ("", "0"):
            raise
        print(f"error: {one_line(error)}", file=sys.stderr)
        for line in getattr(error, "lines", ()):
            print(_printable(line), file=sys.stderr)
        raise SystemExit(BAD_INPUT_CODE) from None
