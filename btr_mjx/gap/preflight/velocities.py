"""Consistency of measured velocities with the slope of positions, under every convention that logs use.

The displacement over a stretch is compared with the integral of the measured velocity. Both are turned into the world's
frame, so that the same few lines cover signs, units, frames of free joints and the order of quaternions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.preflight.comparison import compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import CoordinateGroup, groups_of
from btr_mjx.gap.preflight.stretches import Stretch, choose_stretches, motion_seconds
from btr_mjx.models import part_names

_STRETCHES = 120
_RATIO = 4.0
"""An alternative must halve the error. Its error is that of two sensors, so that physics has no part in it."""

_MOVING = 5.0
"""A stretch counts where the displacement exceeds so many standard deviations of its noise."""

DEGREE = float(np.pi / 180)
"""[rad]."""

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


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
    """Errors for velocities that fit their positions under another convention, warnings where they fit under none."""
    stretches = choose_stretches(dataset, motion_seconds(dataset), _STRETCHES)
    groups = groups_of(dataset.model) if stretches else []
    measured = [g for g in groups if all(r.qvel_measured[g.dofs].all() for r in dataset.recordings)]
    return [found for group in measured if (found := _judge(dataset, stretches, group, noise)) is not None]


def _judge(dataset: Dataset, stretches: list[Stretch], group: CoordinateGroup, sensor: Noise) -> Finding | None:
    """The finding about one group of velocity columns."""
    errors: list[tuple[VelocityReading, np.ndarray]] = []
    for reading in _readings(dataset.model, group):
        pairs = [_moved(dataset.recordings[s.recording], s, group, reading) for s in stretches]
        moved, integral = (np.array(x) for x in zip(*pairs, strict=True))
        size = np.sum(moved**2, axis=1)
        noise = 2 * float(np.sum(sensor.qpos[group.dofs] ** 2))
        if not errors:
            moving = size > _MOVING**2 * noise
            if not moving.any():
                return None
            noise = max(noise, 1e-12 * float(size[moving].mean()))
        left = np.sum((moved - reading.scale * integral) ** 2, axis=1)
        errors.append((reading, ((left + noise) / (size + noise))[moving]))
    now = errors[0][1]
    best, left = min(errors[1:], key=lambda pair: float(np.sum(np.log(pair[1]))))
    found, columns = compare(now, left), f"qvel/{part_names(dataset.model, 'joint')[group.joint]}"
    is_scalar = dataset.model.jnt_type[group.joint] in _SCALAR
    if not is_scalar:
        columns += "/vx, vy, vz" if _is_place(dataset.model, group) else "/wx, wy, wz"
    if found.decisive(_RATIO):
        message = f"{best.words.format(columns=columns)}: with that, {found.words()}; {best.remedy}"
        return Finding("error", "convention", message, best.remedy, found.evidence())
    if is_scalar and np.count_nonzero(now > 0.75) > 0.5 * len(now) > 8:
        message = (
            f"{columns} does not follow the slope of {columns.replace('qvel', 'qpos')}: in half of the stretches its "
            f"integral misses {100 * np.sqrt(np.median(now)):.0f} % of the motion or more; check its unit and clock, "
            "or leave it out"
        )
        return Finding("warning", "channels", message)
    return None


def _is_place(model: mujoco.MjModel, group: CoordinateGroup) -> bool:
    """Whether coordinates are the position of a free joint, whose velocities are in the world's frame."""
    is_free = model.jnt_type[group.joint] == mujoco.mjtJoint.mjJNT_FREE
    return bool(is_free and group.dofs.start == model.jnt_dofadr[group.joint])


def _readings(model: mujoco.MjModel, group: CoordinateGroup) -> Iterator[VelocityReading]:
    """The documented reading first, then the alternatives."""
    kind, name = int(model.jnt_type[group.joint]), part_names(model, "joint")[group.joint]
    if kind in _SCALAR:
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
    linear = _is_place(model, group)
    documented, other = ("world", "body") if linear else ("body", "world")
    unit = ((1e-3, "mm/s"), (1e3, "units of 1000 m/s")) if linear else ((DEGREE, "degrees/s"),)
    yield VelocityReading("", "", frame=documented)
    turn = "R" if linear else "R^T"
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
    frames = {
        documented: ("", ""),
        other: (
            f"are in the {other}'s frame, not in the {documented}'s",
            f"turn them into the {documented}'s frame ({turn} v, with R of the quaternion)",
        ),
    }
    units = {1.0: ("", "")} | {scale: (f"are in {words}", f"multiply them by {scale:.6g}") for scale, words in unit}
    for order, frame, scale in product(orders, frames, units):
        # The linear velocity in the world needs no quaternion.
        if (order, frame, scale) != ("wxyz", documented, 1.0) and not (linear and order != "wxyz" and frame == "world"):
            said = zip(orders[order], frames[frame], units[scale], strict=True)
            words, remedy = (" and ".join(filter(None, parts)) for parts in said)
            yield VelocityReading(f"{{columns}} {words}", remedy, scale, frame, order)


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
    recording: Recording, stretch: Stretch, group: CoordinateGroup, reading: VelocityReading
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement over a stretch, and integral of the velocity columns, in the world's frame for vectors."""
    model, rows = recording.model, slice(stretch.first, stretch.last + 1)
    kind, q = int(model.jnt_type[group.joint]), int(model.jnt_qposadr[group.joint])
    time, velocity = recording.time[rows], recording.qvel[rows, group.dofs]
    qpos = recording.qpos[rows]
    if kind in _SCALAR:
        return qpos[-1, q : q + 1] - qpos[0, q : q + 1], np.trapezoid(velocity, time, axis=0)
    first = q + (3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0)
    turns = rotations(reordered(qpos[:, first : first + 4], reading.order))
    if reading.frame == "body":
        velocity = np.einsum("kij,kj->ki", turns, velocity)
    if _is_place(model, group):
        moved = qpos[-1, q : q + 3] - qpos[0, q : q + 3]
    else:
        steps = np.einsum("kij,klj->kil", turns[1:], turns[:-1])  # in the world's frame
        moved = 0.5 * np.sum([steps[:, i, j] - steps[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    return moved, np.trapezoid(velocity, time, axis=0)


def reordered(quaternions: np.ndarray, order: str) -> np.ndarray:
    """Quaternions (..., 4) read as `order`, in MuJoCo's order w, x, y, z."""
    match order:
        case "xyzw":
            return quaternions[..., [3, 0, 1, 2]]
        case "inverse":
            return quaternions * np.array([1.0, -1.0, -1.0, -1.0])
    return quaternions


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (K, 3, 3) of quaternions (K, 4)."""
    from scipy.spatial.transform import Rotation  # slow to load

    return np.asarray(Rotation.from_quat(quaternions, scalar_first=True).as_matrix())
