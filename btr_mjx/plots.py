"""Command that draws the figures of run folders again: `python -m btr_mjx.plots runs/quick-0`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.plotting import draw_folder
from btr_mjx.runs import parsed


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""

    def command(folders: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> tuple[Path, ...]:
        """Draw the figures of run folders again.

        Args:
          folders: run folders of btr_mjx.coevolve or btr_mjx.scan.
        """
        return folders

    folders = parsed(command, argv, prog="btr_mjx.plots")
    if not folders:
        raise InputError("got no run folder; give one or more, such as runs/quick-0")
    for folder in folders:
        for path in draw_folder(folder):
            print(path)


if __name__ == "__main__":
    main()
