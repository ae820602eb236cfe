"""One self-contained HTML page about a diagnosis, drawn from its saved files only.

`draw_report` makes the page of a run folder, `python -m btr_mjx.report FOLDER` draws it again. `print_findings`,
`print_result` and `print_truth` write the output of `btr_mjx.diagnose` in a terminal.
"""

from btr_mjx.gap.report.page import draw_report
from btr_mjx.gap.report.terminal import print_findings, print_result, print_truth

__all__ = ["draw_report", "print_findings", "print_result", "print_truth"]
