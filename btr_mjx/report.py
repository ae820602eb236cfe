"""Draw the page of a run again, from its saved files: `python -m btr_mjx.report runs/quick-0`.

The page, report.html in the run folder, needs no other file: the verdict, figures, tables that a click sorts, films of
`btr_mjx.replay`, settings and environment. Every command draws it at its end unless it is given --no-figures.
With --export rerun or mcap, what a diagnosis compares is also written for Rerun or Foxglove, see docs/exports.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import parsed


@dataclass(frozen=True)
class ReportConfig:
    """Settings of a report; every field is a flag."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders of btr_mjx.coevolve, scan or diagnose."""
    export: tuple[Literal["rerun", "mcap"], ...] = ()
    """Of diagnoses, write what is measured and simulated as well. rerun: diagnosis.rrd, for Rerun. mcap:
    diagnosis.mcap, for Foxglove and others. Both need the extra of the same name."""


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


def check_report(config: ReportConfig) -> None:
    """Check that runs can be exported.

    Raises:
      InputError: a run that is no diagnosis, or a package that is not installed.
    """
    from btr_mjx.plotting import kind_of_run
    from btr_mjx.replays import check_exports

    check_exports(config.export)
    for run in config.runs:
        if kind_of_run(run) != "diagnose":
            raise InputError(f"{run}: --export is for runs of btr_mjx.diagnose; btr_mjx.replay films others")


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    config = parsed(ReportConfig, argv, description=__doc__, prog="btr_mjx.report")
    if not config.runs:
        raise InputError("got no run folder; give one or more, such as runs/quick-0")
    if config.export:
        check_report(config)
    for run in config.runs:
        print(report(run))
        if config.export:
            from btr_mjx.replays import export_motions

            for path in export_motions(run, config.export):
                print(path)


if __name__ == "__main__":
    main()
