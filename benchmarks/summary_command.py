"""Command line of benchmarks that print a summary of numbers."""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import tyro

from btr_mjx.errors import cli_errors


def command[C](
    config: type[C], run: Callable[[C], Mapping[str, Any]], text: str | None, argv: Sequence[str] | None
) -> None:
    """Read the settings, run the benchmark and print its summary.

    Args:
      config: class of the settings.
      run: function that returns the results, with the numbers under "summary".
      text: description for --help.
      argv: arguments of the command line; None for those of the process.
    """
    settings = tyro.cli(config, args=sys.argv[1:] if argv is None else list(argv), description=text)
    with cli_errors():
        for name, value in run(settings)["summary"].items():
            print(f"{name:24}{value:8.2f}")
