from .draw import draw_folder, draw_run, draw_scan, style
from .pictures import Camera, camera_for, render_motion, sketch, working_backend
from .robot_figure import highlight
from .run_data import RunData, ScanData, read_robot, read_run, read_scan, with_unit

__all__ = [
    "Camera",
    "RunData",
    "ScanData",
    "camera_for",
    "draw_folder",
    "draw_run",
    "draw_scan",
    "highlight",
    "read_robot",
    "read_run",
    "read_scan",
    "render_motion",
    "sketch",
    "style",
    "with_unit",
    "working_backend",
]
