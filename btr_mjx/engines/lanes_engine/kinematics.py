"""Forward kinematics: positions, velocities and bias accelerations of all links, root to leaf, in world axes.

Each link is described relative to its parent's origin, not to the world's, so that lever arms keep their precision in
float32 when a robot is far from the world's origin. The origin of a link is the origin of its body frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, HINGE, Joint, Link, Path, TreePlan
from btr_mjx.engines.scalars import (
    UNIT,
    ZERO,
    Matrix,
    Scalar,
    Vector,
    add,
    axis_rotation,
    cross,
    dot,
    matmul,
    matvec,
    mul,
    neg,
    scale,
    sub,
    tangents,
    total,
    vadd,
)


@dataclass
class Motion:
    """Pose, velocity and bias acceleration of a link."""

    rotation: Matrix
    """Rotation from link axes to world axes."""
    arm: Vector
    """Link origin minus parent origin [m]."""
    position: Vector
    """Link origin in the world [m]."""
    angular_velocity: Vector
    """Angular velocity [rad/s]."""
    velocity: Vector
    """Velocity of the origin [m/s]."""
    angular_acceleration: Vector
    """Angular acceleration when all joint accelerations are zero [rad/s^2]."""
    acceleration: Vector
    """Acceleration of the origin when all joint accelerations are zero, minus gravity [m/s^2]."""
    columns: list[tuple[Vector, Vector]] = field(default_factory=list)
    """Per dof of the link: velocity of the origin and angular velocity that one unit of the dof's velocity causes."""
    axes: Matrix = field(default_factory=lambda: UNIT)
    """Rows: axes of the dofs of a ball joint, in link axes."""


def unit_quaternion(q: Sequence[jax.Array]) -> list[jax.Array]:
    """The quaternion divided by its norm."""
    inverse = lax.rsqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return [c * inverse for c in q]


def quaternion_matrix(q: Sequence[jax.Array]) -> list[list[jax.Array]]:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]


def matrix_quaternion(m: Matrix) -> list[Scalar]:
    """A unit quaternion, of either sign, of a rotation matrix."""
    trace = [m[i][i] for i in range(3)]
    # Rows of four times the product of the quaternion and its transpose; one with a large diagonal is well conditioned.
    skew = [sub(m[j][i], m[i][j]) for i, j in ((1, 2), (2, 0), (0, 1))]
    rows = [[add(1.0, total(trace)), *skew]]
    for i in range(3):
        own = [add(m[i][j], m[j][i]) for j in range(3)]
        own[i] = add(1.0, sub(mul(2.0, m[i][i]), total(trace)))
        rows.append([skew[i], *own])
    best, largest = rows[0], rows[0][0]
    for k in (1, 2, 3):
        larger = rows[k][k] > largest
        best = [jnp.where(larger, x, y) for x, y in zip(rows[k], best, strict=True)]
        largest = jnp.where(larger, rows[k][k], largest)
    return scale(0.5 * lax.rsqrt(largest), best)


def quaternion_product(p: Sequence[Scalar], q: Sequence[Scalar]) -> list[Scalar]:
    """Product p q of two quaternions: rotation by q, then by p."""
    vector = vadd(cross(p[1:], q[1:]), vadd(scale(p[0], q[1:]), scale(q[0], p[1:])))
    return [sub(mul(p[0], q[0]), dot(p[1:], q[1:])), *vector]


def axis_angle(q: Sequence[jax.Array]) -> tuple[list[Scalar], jax.Array]:
    """Unit axis, and angle in [0, pi], of the rotation of a unit quaternion (mju_quat2Vel)."""
    square = dot(q[1:], q[1:])
    turned = square > 1e-30
    sine = jnp.sqrt(jnp.where(turned, square, 1.0))
    sign = jnp.where(q[0] < 0, -1.0, 1.0) / sine
    axis = [jnp.where(turned, sign * x, unit) for x, unit in zip(q[1:], UNIT[0], strict=True)]
    return axis, jnp.where(turned, 2.0 * jnp.arctan2(sine, jnp.abs(q[0])), 0.0)


def ball_axes(joint: Joint, q: Sequence[jax.Array]) -> Matrix:
    """Axes of the dofs of a ball joint in link axes, see `Joint.turned`."""
    if not joint.turned:
        return UNIT
    axis, _ = axis_angle(unit_quaternion(q))
    return [axis, *tangents(axis)]


def world_motion(parameters: Parameters) -> Motion:
    """Motion of the world as the parent of root links; gravity enters as an acceleration of the world, -g."""
    gravity = [neg(g) for g in parameters["world/gravity"]]
    return Motion(UNIT, ZERO, ZERO, ZERO, ZERO, ZERO, gravity)


def _carry(m: Motion, arm: Vector) -> tuple[list[Scalar], list[Scalar]]:
    """Velocity and bias acceleration of the point at `arm` from a link's origin that moves with the link."""
    sweep = cross(m.angular_velocity, arm)
    turn = vadd(cross(m.angular_acceleration, arm), cross(m.angular_velocity, sweep))
    return vadd(m.velocity, sweep), vadd(m.acceleration, turn)


def _free(joint: Joint, q: Sequence[jax.Array], v: Sequence[jax.Array], parent: Motion) -> Motion:
    """Motion of a link with a free joint; its dofs are linear and angular velocity, here both in world axes."""
    turn = quaternion_matrix(unit_quaternion(q[3:7]))
    columns: list[tuple[Vector, Vector]] = [*((axis, ZERO) for axis in UNIT), *((ZERO, axis) for axis in UNIT)]
    return Motion(turn, q[:3], q[:3], matvec(turn, v[3:6]), v[:3], ZERO, parent.acceleration, columns)


def _placed(parameters: Parameters, link: Link, parent: Motion) -> Motion:
    """Motion of a link that is fixed to its parent, before its own joints are applied."""
    arm = matvec(parent.rotation, parameters[f"{link.index}/pos"])
    velocity, acceleration = _carry(parent, arm)
    turn = matmul(parent.rotation, parameters.matrix(f"{link.index}/rot"))
    return Motion(turn, arm, ZERO, parent.angular_velocity, velocity, parent.angular_acceleration, acceleration)


def _moved(
    parameters: Parameters, key: str, joint: Joint, q: Sequence[jax.Array], v: Sequence[jax.Array], m: Motion
) -> Motion:
    """Motion of a link after one more hinge, slide or ball joint."""
    if joint.kind == BALL:
        axes = ball_axes(joint, q)
        anchor = matvec(m.rotation, parameters[f"{key}/pos"])
        turn = matmul(m.rotation, quaternion_matrix(unit_quaternion(q)))
        along = [matvec(turn, axis) for axis in axes]
        moved = _pivoted(parameters[f"{key}/pos"], anchor, turn, along, matvec(axes, v), m)
        return replace(moved, axes=axes)
    angle = sub(q[0], parameters.one(f"{key}/ref"))
    axis = parameters[f"{key}/axis"]
    direction = matvec(m.rotation, axis)
    if joint.kind == HINGE:
        anchor = matvec(m.rotation, parameters[f"{key}/pos"])
        turn = matmul(m.rotation, axis_rotation(axis, jnp.sin(angle), jnp.cos(angle)))
        return _pivoted(parameters[f"{key}/pos"], anchor, turn, [direction], v, m)
    shift = scale(angle, direction)
    velocity, acceleration = _carry(m, shift)
    rate = scale(v[0], direction)
    velocity, acceleration = vadd(velocity, rate), vadd(acceleration, scale(2.0, cross(m.angular_velocity, rate)))
    return _shifted(replace(m, velocity=velocity, acceleration=acceleration), shift, [(direction, ZERO)])


def _pivoted(
    pivot: Vector, anchor: Vector, turn: Matrix, axes: Sequence[Vector], speeds: Sequence[jax.Array], m: Motion
) -> Motion:
    """Motion `m` of a link after a rotation, whose matrix is `turn` afterwards, about axes in the world.

    The fixed point is `pivot` in link axes from the origin, and `anchor` in world axes before the rotation.
    """
    lever = scale(-1.0, matvec(turn, pivot))  # from the anchor to the origin, after the turn
    velocity, acceleration = _carry(m, anchor)
    rate: Vector = ZERO
    for axis, speed in zip(axes, speeds, strict=True):
        rate = vadd(rate, scale(speed, axis))
    spin, spin_rate = vadd(m.angular_velocity, rate), vadd(m.angular_acceleration, cross(m.angular_velocity, rate))
    at_anchor = Motion(turn, m.arm, ZERO, spin, velocity, spin_rate, acceleration, m.columns)
    velocity, acceleration = _carry(at_anchor, lever)
    shift, columns = vadd(anchor, lever), [(cross(axis, lever), axis) for axis in axes]
    return _shifted(replace(at_anchor, velocity=velocity, acceleration=acceleration), shift, columns)


def _shifted(m: Motion, shift: Vector, columns: Sequence[tuple[Vector, Vector]]) -> Motion:
    """Motion with the origin moved by a joint, whose columns are added."""
    # Columns of earlier joints refer to the origin before the shift by this joint.
    earlier = [(vadd(linear, cross(angular, shift)), angular) for linear, angular in m.columns]
    return replace(m, arm=vadd(m.arm, shift), columns=[*earlier, *columns])


def motions(
    plan: TreePlan, parameters: Parameters, q: Sequence[Sequence[jax.Array]], v: Sequence[jax.Array]
) -> list[Motion]:
    """Motion of every link.

    Coordinates are per joint in link order, 7 of a free joint, 4 of a ball joint, else 1; velocities per dof in
    MuJoCo's conventions.
    """
    found: list[Motion] = []
    world = world_motion(parameters)
    coordinates = iter(q)
    for link in plan.links:
        parent = found[link.parent] if link.parent >= 0 else world
        if link.joints[0].kind == FREE:
            joint = link.joints[0]
            found.append(_free(joint, next(coordinates), [v[k] for k in joint.dofs], parent))
            continue
        m = _placed(parameters, link, parent)
        for n, joint in enumerate(link.joints):
            m = _moved(parameters, f"{link.index}/joint{n}", joint, next(coordinates), [v[k] for k in joint.dofs], m)
        m.position = vadd(parent.position, m.arm)
        found.append(m)
    return found


def path_motion(
    plan: TreePlan, path: Path, q: Sequence[Sequence[jax.Array]], v: Sequence[jax.Array]
) -> tuple[Scalar, Scalar]:
    """Length [m or rad] of a weighted sum of joint coordinates, and its velocity, (C,)."""
    weights = dict(path)
    length: Scalar = 0.0
    velocity: Scalar = 0.0
    for joint, here in zip(plan.joints, q, strict=True):
        for member, j in enumerate(joint.ids):
            if j in weights:
                row = lambda x: x[member] if x.ndim == 2 else x  # noqa: B023, E731
                length = add(length, mul(weights[j], row(here[0])))
                velocity = add(velocity, mul(weights[j], row(v[joint.dofs[0]])))
    return length, velocity


def point_velocity(m: Motion, x: Vector) -> list[Scalar]:
    """Velocity of a point of a link, given relative to its origin."""
    return vadd(m.velocity, cross(m.angular_velocity, x))
