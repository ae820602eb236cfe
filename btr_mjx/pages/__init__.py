"""Self-contained HTML pages about runs, drawn from their saved files only.

`draw_run_page` makes the page of a co-evolution or a scan. `write_page` renders
`Section`s of lines, figures, tables and curves by the templates in templates/, with the films of the folder and the
folded settings and environment.
"""

from btr_mjx.pages.page import PAGE, embedded, write_page
from btr_mjx.pages.page_content import Curves, Figure, Section, Table, with_interval
from btr_mjx.pages.runs import draw_run_page

__all__ = [
    "PAGE",
    "Curves",
    "Figure",
    "Section",
    "Table",
    "draw_run_page",
    "embedded",
    "with_interval",
    "write_page",
]
