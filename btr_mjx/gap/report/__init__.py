"""One self-contained HTML page about a diagnosis, drawn from its saved files only.

`draw` makes the page of a run folder; `python -m btr_mjx.gap.report FOLDER` draws it again.
"""
