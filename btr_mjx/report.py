"""Draw the page of a run again, from its saved files: `python -m btr_mjx.report runs/quick-0`.

The page, report.html in the run folder, needs no other file: the verdict, figures, tables that a click sorts, films of
`btr_mjx.replay`, settings and environment. Every command draws it at its end unless it is given --no-figures.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from btr_mjx.errors import cli_errors


def report(folder: str | Path) -> Path:
    """Draw the figures and the page of a run.

    Args:
      folder: run folder of btr_mjx.coevolve, scan or diagnose.

    Returns:
      The page.

    Raises:
      InputError: no such run, one that has not ended, or a damaged file.
    """
    from btr_mjx.pages import draw_run_page
    from btr_mjx.plotting import kind_of_run

    if kind_of_run(folder) == "diagnose":
        from btr_mjx.gap.report import draw_report

        return draw_report(folder)
    return draw_run_page(folder)


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""

    def command(folders: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> tuple[Path, ...]:
        """Draw the pages of runs again.

        Args:
          folders: run folders of btr_mjx.coevolve, scan or diagnose.
        """
        return folders

    folders = tyro.cli(command, args=argv, description=__doc__, prog="btr_mjx.report")
    for folder in folders:
        print(report(folder))


if __name__ == "__main__":
    main()
