from .camera import Camera, camera_for
from .draw import attempt, draw_folder, draw_run, draw_scan, save_figure, style
from .rendering import render, working_backend
from .robot_figure import highlight
from .run_data import RunData, ScanData, kind_of_run, read_robot, read_run, read_scan, with_unit

__all__ = [
    "Camera",
    "RunData",
    "ScanData",
    "attempt",
    "camera_for",
    "draw_folder",
    "draw_run",
    "draw_scan",
    "highlight",
    "kind_of_run",
    "read_robot",
    "read_run",
    "read_scan",
    "render",
    "save_figure",
    "style",
    "with_unit",
    "working_backend",
]
