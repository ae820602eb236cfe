"""Figures of run folders, drawn from their saved files only, and pictures of robots.

`draw_run` and `draw_scan` draw the figures of a folder, `draw_folder` those of either kind; `style` is the matplotlib
style of all figures. `read_run` and `read_scan` read what they show. `working_backend` tests whether robots can be
rendered here, `render_motion` renders the frames of a film, `sketch` draws a robot without OpenGL.
Names load on first use, since pictures need MuJoCo.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
