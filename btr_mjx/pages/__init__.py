"""Self-contained HTML pages about runs, drawn from their saved files only.

`draw_run_page` makes the page of a co-evolution, a scan or the claims of the paper. `write_page` renders a template
that extends base.html.j2, which has the style, the folded settings and environment, and the films of the folder.
"""

from btr_mjx.pages.content import Figure, Section, Table
from btr_mjx.pages.page import PAGE, embedded, write_page
from btr_mjx.pages.runs import draw_claims_page, draw_run_page, kind_of_run

__all__ = [
    "PAGE",
    "Figure",
    "Section",
    "Table",
    "draw_claims_page",
    "draw_run_page",
    "embedded",
    "kind_of_run",
    "write_page",
]
