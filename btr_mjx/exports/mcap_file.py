"""Recordings as MCAP with messages in JSON, which Foxglove and others read."""

import heapq
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.exports.recorded import RecordedCurves, RecordedPoses
from btr_mjx.runs import atomic_write


def write_mcap(path: Path, curves: Sequence[RecordedCurves], poses: Sequence[RecordedPoses]) -> None:
    """Write an .mcap file: a channel for each group and name with numbers by coordinate, and poses of bodies on "/tf".

    Frames are called after motion and body, such as "measured/hand", and are poses in "world". Times are those of the
    recordings; where one begins below zero, which MCAP does not have, all are counted from there.

    Args:
      path: the file.
      curves: numbers over time, on topics such as "/recording/measured"; a number that is not finite is left out.
      poses: motions of bodies.

    Raises:
      OSError: the file cannot be written.
    """
    from mcap.writer import Writer

    times = [one.time for one in curves] + [one.time for one in poses]
    origin = min([0.0, *(float(time.min()) for time in times)])
    with atomic_write(path) as file:
        writer = Writer(file)
        writer.start(library="btr_mjx")

        def channel(topic: str, name: str, schema: Any, about: dict[str, str]) -> int:
            known = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            return writer.register_channel(topic, "json", known, about)

        messages = []
        for one in curves:
            schema = _entries(**{name: _NUMBER | {"description": unit} for name, unit in one.units.items()})
            topic = f"/{one.group}/{one.name}"
            number = channel(topic, f"btr_mjx.{one.group}", schema, dict(one.units))
            messages.append(_numbers(one, number, origin))
        if poses:
            number = channel("/tf", "foxglove.FrameTransforms", _TRANSFORMS, {})
            messages += [_transforms(one, number, origin) for one in poses]
        for time, number, message in heapq.merge(*messages, key=lambda entry: entry[0]):
            writer.add_message(number, time, json.dumps(message).encode(), time)
        writer.finish()


def _entries(**properties: Any) -> dict[str, Any]:
    """Schema of an object."""
    return {"type": "object", "properties": properties}


_NUMBER, _WHOLE, _TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
_TRANSFORM = _entries(
    timestamp=_entries(sec=_WHOLE, nsec=_WHOLE),
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_entries(x=_NUMBER, y=_NUMBER, z=_NUMBER),
    rotation=_entries(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
)
_TRANSFORMS = _entries(transforms={"type": "array", "items": _TRANSFORM})
"""Schema of foxglove.FrameTransforms, whose messages Foxglove draws."""

_Message = tuple[int, int, dict[str, Any]]
"""Time [ns], channel and content."""


def _numbers(one: RecordedCurves, channel: int, origin: float) -> Iterator[_Message]:
    for k, moment in enumerate(one.time.tolist()):
        found = {name: float(values[k]) for name, values in one.values.items()}
        yield round(1e9 * (moment - origin)), channel, {n: v for n, v in found.items() if math.isfinite(v)}


def _transforms(motion: RecordedPoses, channel: int, origin: float) -> Iterator[_Message]:
    for moment, positions, quaternions in zip(
        motion.time.tolist(), motion.positions.tolist(), motion.quaternions.tolist(), strict=True
    ):
        time = round(1e9 * (moment - origin))
        stamp = dict(zip(("sec", "nsec"), divmod(time, 10**9), strict=True))
        transforms = [
            {
                "timestamp": stamp,
                "parent_frame_id": "world",
                "child_frame_id": f"{motion.name}/{body}",
                "translation": dict(zip("xyz", position, strict=True)),
                "rotation": dict(zip("wxyz", quaternion, strict=True)),
            }
            for body, position, quaternion in zip(motion.bodies, positions, quaternions, strict=True)
        ]
        yield time, channel, {"transforms": transforms}
