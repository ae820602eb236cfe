from .draw import draw_folder, draw_run, draw_scan, style
from .pictures import camera_for, sketch, working_backend

__all__ = ["camera_for", "draw_folder", "draw_run", "draw_scan", "sketch", "style", "working_backend"]
