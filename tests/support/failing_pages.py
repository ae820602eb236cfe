"""A page that cannot be drawn: what commands say by then, and that they say it in one line."""

from collections.abc import Callable
from pathlib import Path

import pytest

from btr_mjx.runs import check_sums

SAID = "no report.html: ZeroDivisionError: of a bug"
"""The line."""


def failing_page(capsys: pytest.CaptureFixture[str], printed: list[str]) -> Callable[[Path], None]:
    """What stands in for drawing: it adds what was printed to a list, checks that the run is whole, and fails."""

    def fails(run: Path) -> None:
        printed.append(capsys.readouterr().out)
        check_sums(run)
        raise ZeroDivisionError("of a bug")

    return fails
