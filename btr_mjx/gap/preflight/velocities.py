"""Consistency of measured velocities with the slope of positions, under every convention that logs use.

The displacement over a stretch is compared with the integral of the measured velocity. Both are turned into the world's
frame, so that the same few lines cover signs, units, frames of free joints and the order of quaternions.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.preflight.comparison import Comparison, compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.stretches import Stretch, choose_stretches, motion_seconds
from btr_mjx.models import part_names

_STRETCHES = 120
_RATIO = 4.0
"""An alternative must halve the error. Its error is that of two sensors, so that physics has no part in it."""

_MOVING = 5.0
"""A stretch counts where the displacement exceeds so many standard deviations of its noise."""

DEGREE = float(np.pi / 180)
"""[rad]."""


@dataclass(frozen=True)
class VelocityReading:
    """One way to read velocity columns.

    Attributes:
      words: what the columns {columns} hold, for messages; "" as documented.
      remedy: what to do.
      scale: factor to SI units.
      frame: "world" or "body" of a vector.
      order: "wxyz", "xyzw" or "inverse": of the joint's quaternion.
    """

    words: str
    remedy: str
    scale: float = 1.0
    frame: str = "world"
    order: str = "wxyz"


def velocity_conventions(dataset: Dataset, noise: Noise) -> list[Finding]:
    """Errors for velocities that fit their positions under another convention, and warnings where they fit under none.

    Args:
      dataset: the dataset.
      noise: of its sensors.
    """
    model, findings = dataset.model, []
    stretches = choose_stretches(dataset, motion_seconds(dataset), _STRETCHES)
    for j, name in enumerate(part_names(model, "joint")):
        kind, v = int(model.jnt_type[j]), int(model.jnt_dofadr[j])
        for block in _blocks(kind):
            own = slice(v + block.start, v + block.stop)
            if all(r.qvel_measured[own].all() for r in dataset.recordings):
                columns = _column_words(name, kind, block)
                found = _judge(dataset, stretches, j, block, columns, noise.qpos[own])
                findings += [found] if found is not None else []
    return findings


def _blocks(kind: int) -> list[slice]:
    """Coordinates of a joint that are judged together."""
    match kind:
        case mujoco.mjtJoint.mjJNT_FREE:
            return [slice(0, 3), slice(3, 6)]
        case mujoco.mjtJoint.mjJNT_BALL:
            return [slice(0, 3)]
    return [slice(0, 1)]


def _column_words(name: str, kind: int, block: slice) -> str:
    if kind == mujoco.mjtJoint.mjJNT_FREE and block.start == 0:
        return f"qvel/{name}/vx, vy, vz"
    if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
        return f"qvel/{name}/wx, wy, wz"
    return f"qvel/{name}"


def _judge(
    dataset: Dataset, stretches: list[Stretch], joint: int, block: slice, columns: str, sigma: np.ndarray
) -> Finding | None:
    """The finding about one block of velocity columns."""
    model = dataset.model
    kind = int(model.jnt_type[joint])
    errors: list[tuple[VelocityReading, np.ndarray]] = []
    for reading in _readings(model, joint, block):
        pairs = [_moved(dataset.recordings[s.recording], s, joint, block, reading) for s in stretches]
        if not pairs:
            return None
        moved, integral = (np.array(x) for x in zip(*pairs, strict=True))
        size = np.sum(moved**2, axis=1)
        noise = 2 * float(np.sum(sigma**2))
        if not errors:
            moving = size > _MOVING**2 * noise
            if not moving.any():
                return None
            noise = max(noise, 1e-12 * float(size[moving].mean()))
        left = np.sum((moved - reading.scale * integral) ** 2, axis=1)
        errors.append((reading, ((left + noise) / (size + noise))[moving]))
    now = errors[0][1]
    best, left = min(errors[1:], key=lambda pair: float(np.sum(np.log(pair[1]))))
    found = compare(now, left)
    if found.decisive(_RATIO):
        return _error(columns, best, found, kind)
    if (
        kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        and np.count_nonzero(now > 0.75) > 0.5 * len(now) > 8
    ):
        message = (
            f"{columns} does not follow the slope of {columns.replace('qvel', 'qpos')}: in half of the stretches its "
            f"integral misses {100 * np.sqrt(np.median(now)):.0f} % of the motion or more; check its unit and clock, "
            "or leave it out"
        )
        return Finding("warning", "channels", message)
    return None


def _error(columns: str, reading: VelocityReading, found: Comparison, kind: int) -> Finding:
    message = f"{reading.words.format(columns=columns)}: with that, {found.words()}; {reading.remedy}"
    return Finding("error", "convention", message, reading.remedy, found.evidence())


def _readings(model: mujoco.MjModel, joint: int, block: slice) -> Iterator[VelocityReading]:
    """The documented reading first, then the alternatives."""
    kind, name = int(model.jnt_type[joint]), part_names(model, "joint")[joint]
    free = kind == mujoco.mjtJoint.mjJNT_FREE
    if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        yield VelocityReading("", "")
        hinge = kind == mujoco.mjtJoint.mjJNT_HINGE
        both = f"qpos/{name} and qvel/{name}"
        for sign in (1.0, -1.0):
            if sign < 0:
                yield VelocityReading(
                    "{columns} has the opposite sign of the slope of its positions",
                    f"negate either of {both}, or leave the velocity out",
                    -1.0,
                )
            turned = "" if sign > 0 else " and has the opposite sign of its positions"
            for scale, words, remedy in _scalar_units(hinge, name):
                yield VelocityReading(f"{words}{turned}", remedy, sign * scale)
        return
    linear = free and block.start == 0
    documented = "world" if linear else "body"
    other = "body" if linear else "world"
    unit = ((1e-3, "mm/s"), (1e3, "units of 1000 m/s")) if linear else ((DEGREE, "degrees/s"),)
    yield VelocityReading("", "", frame=documented)
    orders = {
        "wxyz": ("", ""),
        "xyzw": (
            f"fit the quaternions of qpos/{name} if those are in the order x, y, z, w",
            f"name the columns of qpos/{name} so that qw is the scalar part",
        ),
        "inverse": (
            f"fit the quaternions of qpos/{name} if those turn the world into the body",
            f"negate qx, qy, qz of qpos/{name}",
        ),
    }
    for order, (order_words, order_remedy) in orders.items():
        for frame in (documented, other):
            for scale, unit_words in ((1.0, ""), *unit):
                if (order, frame, scale) == ("wxyz", documented, 1.0) or (
                    linear and order != "wxyz" and frame == "world"
                ):
                    continue
                parts = [order_words] if order_words else []
                remedies = [order_remedy] if order_remedy else []
                if frame == other:
                    parts.append(f"are in the {other}'s frame, not in the {documented}'s")
                    turn = "R" if linear else "R^T"
                    remedies.append(f"turn them into the {documented}'s frame ({turn} v, with R of the quaternion)")
                if scale != 1.0:
                    parts.append(f"are in {unit_words}")
                    remedies.append(f"multiply them by {scale:.6g}")
                yield VelocityReading("{columns} " + " and ".join(parts), " and ".join(remedies), scale, frame, order)


def _scalar_units(hinge: bool, name: str) -> Iterator[tuple[float, str, str]]:
    if hinge:
        yield DEGREE, "{columns} looks like degrees/s", "angular velocities are in rad/s: divide by 57.3"
        position = f"qpos/{name} looks like degrees beside {{columns}} in rad/s"
        yield 1 / DEGREE, position, f"angles are in rad: divide qpos/{name} by 57.3"
        yield 2 * np.pi / 60, "{columns} looks like revolutions per minute", "multiply by 0.10472 to have rad/s"
        yield 2 * np.pi, "{columns} looks like revolutions per second", "multiply by 6.28319 to have rad/s"
    else:
        yield 1e-3, "{columns} looks like mm/s", "velocities are in m/s: divide by 1000"
        yield (
            1e3,
            f"qpos/{name} looks like millimetres beside {{columns}} in m/s",
            f"positions are in m: divide qpos/{name} by 1000",
        )


def _moved(
    recording: Recording, stretch: Stretch, joint: int, block: slice, reading: VelocityReading
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement over a stretch, and integral of the velocity columns, in the world's frame for vectors."""
    model, rows = recording.model, slice(stretch.first, stretch.last + 1)
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    kind = int(model.jnt_type[joint])
    time, velocity = recording.time[rows], recording.qvel[rows, v + block.start : v + block.stop]
    spans = np.diff(time)[:, None]
    if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        return recording.qpos[stretch.last, q : q + 1] - recording.qpos[stretch.first, q : q + 1], _trapezoid(
            velocity, spans
        )
    first = q + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
    turns = rotations(reordered(recording.qpos[rows, first : first + 4], reading.order))
    if reading.frame == "body":
        velocity = np.einsum("kij,kj->ki", turns, velocity)
    if block.start == 0 and kind == mujoco.mjtJoint.mjJNT_FREE:
        moved = recording.qpos[stretch.last, q : q + 3] - recording.qpos[stretch.first, q : q + 3]
    else:
        steps = np.einsum("kij,kjl->kil", turns[1:], np.swapaxes(turns[:-1], 1, 2))  # in the world's frame
        moved = 0.5 * np.sum(
            np.stack([steps[:, i, j] - steps[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], 1), axis=0
        )
    return moved, _trapezoid(velocity, spans)


def _trapezoid(values: np.ndarray, spans: np.ndarray) -> np.ndarray:
    return np.sum(0.5 * (values[1:] + values[:-1]) * spans, axis=0)


def reordered(quaternions: np.ndarray, order: str) -> np.ndarray:
    """Quaternions (..., 4) read as `order`, in MuJoCo's order w, x, y, z."""
    match order:
        case "xyzw":
            return quaternions[..., [3, 0, 1, 2]]
        case "inverse":
            return quaternions * np.array([1.0, -1.0, -1.0, -1.0])
    return quaternions


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
