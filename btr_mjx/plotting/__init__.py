"""Every figure of a run folder, drawn from its saved files only; pictures of robots.

`draw_run` and `draw_scan` draw the figures of a folder, `style` is the look that all figures share.
"""

from btr_mjx.plotting.draw import draw_scan, style

__all__ = [
    "draw_scan",
    "style",
]
