"""Replays: films of what a run simulated and of what reality did.

`read_replay` simulates the trials of a run folder again and returns a `Replay`: motions side by side. `draw_film` makes
its frames, with MuJoCo's renderer or, without OpenGL, as outlines; `write_film` saves them as GIF or MP4. `view_replay`
plays the motions in MuJoCo's viewer. `export_motions` writes those of a diagnosis for Rerun and Foxglove.
"""

from btr_mjx.replays.film import check_film, draw_film, write_film
from btr_mjx.replays.replay_records import Replay, ReplayedMotion, magnified
from btr_mjx.replays.source import check_exports, export_motions, read_replay
from btr_mjx.replays.viewer import check_display, view_replay

__all__ = [
    "Replay",
    "ReplayedMotion",
    "check_display",
    "check_exports",
    "check_film",
    "draw_film",
    "export_motions",
    "magnified",
    "read_replay",
    "view_replay",
    "write_film",
]
