"""Pages of co-evolutions and scans."""

from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.pages.coevolution_page import coevolution_content
from btr_mjx.pages.page import write_page
from btr_mjx.pages.scan_page import scan_content
from btr_mjx.plotting import draw_run, draw_scan, kind_of_run, read_run, read_scan


def draw_run_page(folder: str | Path) -> Path:
    """Draw the figures and the page of a co-evolution or a scan.

    Args:
      folder: its run folder; report.html and *.png are written there.

    Returns:
      The page.

    Raises:
      InputError: another folder, a run that has not ended, or a damaged file.
    """
    folder = Path(folder)
    kind = kind_of_run(folder)
    if kind == "scan":
        figures = draw_scan(folder)
        return write_page(folder, scan_content(folder, read_scan(folder), figures))
    if kind == "coevolve":
        figures = draw_run(folder)
        return write_page(folder, coevolution_content(folder, read_run(folder), figures))
    raise InputError(f"{folder}: the page of a diagnosis is drawn by btr_mjx.report")
