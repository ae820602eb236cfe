"""Figures of run folders, drawn from their saved files only, and pictures of robots.

`draw_run` and `draw_scan` draw the figures of a folder, `draw_folder` those of either kind; `style` is the matplotlib
style of all figures.
"""

from btr_mjx.plotting.draw import draw_folder, draw_run, draw_scan, style

__all__ = ["draw_folder", "draw_run", "draw_scan", "style"]
