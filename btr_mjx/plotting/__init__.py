"""Figures of run folders, drawn from their saved files only, and pictures of robots.

`draw_run` and `draw_scan` draw the figures of a folder, `draw_folder` those of either kind; `style` is the matplotlib
style of all figures. `read_run` and `read_scan` read what they show. `render` makes
pictures of robots, `working_backend` tests whether that works here.
Names load on first use, since pictures need MuJoCo.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
