"""Recordings for Rerun (rerun.io)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from btr_mjx.exports.recorded import RecordedCurves, RecordedPoses
from btr_mjx.runs import atomic_write

_COLOURS = {"measured": (144, 144, 144), "believed": (217, 119, 43)}
"""Colours by name, as on the page; `_OTHER` is that of other names."""
_OTHER = (63, 131, 209)


def write_rerun(path: Path, curves: Sequence[RecordedCurves], poses: Sequence[RecordedPoses]) -> None:
    """Write an .rrd file: bodies as boxes, and a plot for each group and coordinate, on the timeline "time".

    Args:
      path: the file.
      curves: numbers over time, at /group/coordinate/name.
      poses: motions of bodies, at /bodies/name/body.

    Raises:
      OSError: the file cannot be written.
    """
    import rerun
    import rerun.blueprint as views

    stream = rerun.RecordingStream("btr_mjx")
    content = rerun.binary_stream(recording=stream)
    plots = {}
    for one in curves:
        times = rerun.TimeColumn("time", duration=one.time)
        for coordinate, values in one.values.items():
            place = rerun.new_entity_path([one.group, coordinate, one.name])
            look = rerun.SeriesLines(colors=_COLOURS.get(one.name, _OTHER), names=one.name)
            stream.log(place, look, static=True)
            stream.send_columns(place, indexes=[times], columns=rerun.Scalars.columns(scalars=values))
            origin = rerun.new_entity_path([one.group, coordinate])
            title = f"{one.group}: {coordinate} [{one.units[coordinate]}]"
            plots[origin] = views.TimeSeriesView(origin=origin, name=title)
    for motion in poses:
        times = rerun.TimeColumn("time", duration=motion.time)
        for body, positions, quaternions, boxes in zip(
            motion.bodies, np.moveaxis(motion.positions, 1, 0), np.moveaxis(motion.quaternions, 1, 0), motion.boxes,
            strict=True,
        ):  # fmt: skip
            place = rerun.new_entity_path(["bodies", motion.name, body])
            moved = rerun.Transform3D.columns(translation=positions, quaternion=_x_first(quaternions))
            stream.send_columns(place, indexes=[times], columns=moved)
            shape = rerun.Boxes3D(
                centers=boxes[:, :3],
                half_sizes=boxes[:, 3:6],
                quaternions=_x_first(boxes[:, 6:]),
                colors=_COLOURS.get(motion.name, _OTHER),
            )
            stream.log(place, shape, static=True)
    layout = views.Horizontal(views.Spatial3DView(origin="/bodies"), views.Grid(*plots.values()))
    stream.send_blueprint(views.Blueprint(layout))
    with atomic_write(path) as file:
        file.write(content.read() or b"")


def _x_first(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions w x y z as x y z w."""
    return np.roll(quaternions, -1, axis=-1)
