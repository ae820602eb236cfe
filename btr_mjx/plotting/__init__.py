"""Every figure of a run folder, drawn from its saved files only; pictures of robots.

`draw_run` and `draw_scan` draw the figures of a folder, `draw_folder` of either kind, `style` is the look that all
figures share.
"""

from btr_mjx.plotting.draw import draw_folder, draw_run, draw_scan, style

__all__ = ["draw_folder", "draw_run", "draw_scan", "style"]
