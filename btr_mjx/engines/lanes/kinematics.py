"""Forward kinematics: positions, velocities and bias accelerations of all links, root to leaf, in world axes.

Each link is described relative to its parent's origin, not to the world's, so that lever arms keep their precision in
float32 when a robot is far from the world's origin. The origin of a link is the origin of its body frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import lax

from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    UNIT,
    ZERO,
    Matrix,
    Scalar,
    Vector,
    add,
    axis_rotation,
    cross,
    matmul,
    matvec,
    mul,
    neg,
    scale,
    sub,
    vadd,
)
from btr_mjx.engines.lanes.tree import FREE, HINGE, Joint, Link, Path, TreePlan


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


def _moved(parameters: Parameters, key: str, joint: Joint, q: jax.Array, v: jax.Array, m: Motion) -> Motion:
    """Motion of a link after one more hinge or slide joint."""
    angle = sub(q, parameters.one(f"{key}/ref"))
    axis = parameters[f"{key}/axis"]
    turn: Matrix
    spin: Vector
    spin_rate: Vector
    along = matvec(m.rotation, axis)
    if joint.kind == HINGE:
        anchor = matvec(m.rotation, parameters[f"{key}/pos"])
        turn = matmul(m.rotation, axis_rotation(axis, jnp.sin(angle), jnp.cos(angle)))
        lever = scale(-1.0, matvec(turn, parameters[f"{key}/pos"]))  # from the anchor to the origin, after the turn
        velocity, acceleration = _carry(m, anchor)
        rate = scale(v, along)
        spin, spin_rate = vadd(m.angular_velocity, rate), vadd(m.angular_acceleration, cross(m.angular_velocity, rate))
        at_anchor = Motion(turn, ZERO, ZERO, spin, velocity, spin_rate, acceleration)
        velocity, acceleration = _carry(at_anchor, lever)
        shift, column = vadd(anchor, lever), (cross(along, lever), along)
    else:
        shift = scale(angle, along)
        velocity, acceleration = _carry(m, shift)
        rate = scale(v, along)
        velocity, acceleration = vadd(velocity, rate), vadd(acceleration, scale(2.0, cross(m.angular_velocity, rate)))
        turn, spin, spin_rate, column = m.rotation, m.angular_velocity, m.angular_acceleration, (along, ZERO)
    # Columns of earlier joints refer to the origin before the shift by this joint.
    earlier = [(vadd(linear, cross(angular, shift)), angular) for linear, angular in m.columns]
    return Motion(turn, vadd(m.arm, shift), ZERO, spin, velocity, spin_rate, acceleration, [*earlier, column])


def motions(
    plan: TreePlan, parameters: Parameters, q: Sequence[Sequence[jax.Array]], v: Sequence[jax.Array]
) -> list[Motion]:
    """Motion of every link.

    Args:
      plan: the static plan.
      parameters: parameters of this chunk.
      q: per joint of the plan, in link order, its coordinates: 7 for a free joint, else 1.
      v: velocity per dof of the plan, MuJoCo's conventions.

    Returns:
      One `Motion` per link.
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
            m = _moved(parameters, f"{link.index}/joint{n}", joint, next(coordinates)[0], v[joint.dofs[0]], m)
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
    joints = [joint for link in plan.links for joint in link.joints]
    for joint, here in zip(joints, q, strict=True):
        for member, j in enumerate(joint.ids):
            if j in weights:
                row = lambda x: x[member] if x.ndim == 2 else x  # noqa: B023, E731
                length = add(length, mul(weights[j], row(here[0])))
                velocity = add(velocity, mul(weights[j], row(v[joint.dofs[0]])))
    return length, velocity


def point_velocity(m: Motion, x: Vector) -> list[Scalar]:
    """Velocity of a point of a link, given relative to its origin."""
    return vadd(m.velocity, cross(m.angular_velocity, x))
