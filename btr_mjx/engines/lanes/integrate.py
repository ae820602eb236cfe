"""Semi-implicit integration of velocities and positions (mj_Euler, mj_implicit with implicitfast)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco

from btr_mjx.engines.lanes import support
from btr_mjx.engines.lanes.articulated import factorise, lu_solve, solve_factored
from btr_mjx.engines.lanes.dynamics import NO_BLOCK, System, local_rates, opposing_forces
from btr_mjx.engines.lanes.kinematics import Motion, unit_quaternion
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    add,
    array,
    cross,
    dot,
    full,
    is_zero,
    matvec,
    mul,
    scale,
    sub,
    transpose,
    vadd,
)
from btr_mjx.engines.lanes.spatial import Block, Spatial, propagate
from btr_mjx.engines.lanes.tree import BALL, FREE, TreePlan


@dataclass(frozen=True)
class Damping:
    """Minus the derivatives of forces with respect to velocity [N s/m or N m s/rad], by the source of the forces."""

    joints: System
    """Of joint dampers."""
    actuators: Mapping[int, Scalar]
    """Of actuators, per dof."""
    medium: System | None
    """Of fluid drag; None in a vacuum."""


def integrate_step(
    model: mujoco.MjModel,
    plan: TreePlan,
    motions: Sequence[Motion],
    q: Sequence[Sequence[jax.Array]],
    v: Sequence[jax.Array],
    inertia: System,
    damping: Damping,
    acceleration: Sequence[jax.Array],
) -> tuple[list[list[jax.Array]], list[jax.Array]]:
    """Coordinates per joint and velocities per dof after one step, from the accelerations of the constraint problem."""
    dt = float(model.opt.timestep)
    implicit = damping.joints
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        blocks = [NO_BLOCK] * len(plan.links)
        implicit = damping.joints + System(blocks, {k: d for k, d in damping.actuators.items() if not is_zero(d)})
        implicit = implicit + damping.medium if damping.medium else implicit
    elif support.disabled(model, "EULERDAMP"):
        implicit = damping.joints.times(0.0)
    implicit = implicit.times(dt)
    links = propagate(plan, motions, acceleration)
    following: list[Scalar] = list(acceleration)
    if not implicit.zero:
        # (M + h D) a' = M a, where M a is the sum of all forces. Solving for the difference a' - a reduces rounding
        # errors and does not need the contact forces.
        system = inertia + implicit
        wrenches, tau = opposing_forces(implicit, links, acceleration)
        change, _ = solve_factored(factorise(plan, motions, system.blocks, system.diagonal), wrenches, tau)
        following = [add(a, c) for a, c in zip(acceleration, change, strict=True)]
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        for link in plan.links:
            if link.free_body:
                i = link.index
                change = _gyroscopic(inertia.blocks[i], implicit.blocks[i], motions[i], links[i], dt)
                for k, c in zip(link.dofs, change, strict=True):
                    following[k] = add(acceleration[k], c)
    acceleration = [array(x, a.shape, a.dtype) for x, a in zip(following, acceleration, strict=True)]
    rates = local_rates(plan, motions, acceleration)
    velocities = vadd(v, scale(dt, rates))
    return moved_coordinates(plan, q, velocities, dt), velocities


def moved_coordinates(
    plan: TreePlan, q: Sequence[Sequence[jax.Array]], v: Sequence[Scalar], dt: Scalar
) -> list[list[jax.Array]]:
    """Coordinates per joint after moving for `dt` at constant velocities (mj_integratePos)."""
    coordinates = []
    for joint, old in zip(plan.joints, q, strict=True):
        speed = [v[k] for k in joint.dofs]
        if joint.kind == BALL:
            coordinates.append(_turned(unit_quaternion(old), speed, dt))
            continue
        moved = vadd(old[: min(3, len(old))], scale(dt, speed[: min(3, len(old))]))
        if joint.kind == FREE:
            moved += _turned(unit_quaternion(old[3:]), speed[3:], dt)
        coordinates.append(moved)
    return coordinates


def turning_rates(plan: TreePlan, moved: Sequence[Scalar], v: Sequence[Scalar]) -> list[Scalar]:
    """Velocities of the coordinates in which rotations are vectors from where a step began.

    For a rotation by the vector u, u' = w + u x w / 2 + (1 - |u|/2 cot(|u|/2)) / |u|^2 u x (u x w), with the angular
    velocity w in the turned axes: the inverse of the derivative of the exponential map (Munthe-Kaas, "High order
    Runge-Kutta methods on manifolds", 1999). `moved` is u per dof, and the displacement of dofs that are no rotations.
    """
    rates = list(v)
    for joint in (joint for joint in plan.joints if joint.kind in (BALL, FREE)):
        dofs = joint.dofs[-3:]
        u, w = [moved[k] for k in dofs], [v[k] for k in dofs]
        square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
        small = square < 0.25
        angle = jnp.sqrt(jnp.where(small, 1.0, square))
        far = (1.0 - 0.5 * angle / jnp.tan(0.5 * angle)) / (angle * angle)
        near = jnp.full_like(square, _INVERSE_SERIES[-1])
        for coefficient in _INVERSE_SERIES[-2::-1]:
            near = coefficient + square * near
        turn = cross(u, w)
        second = scale(jnp.where(small, near, far), cross(u, turn))
        for k, x in zip(dofs, vadd(vadd(w, scale(0.5, turn)), second), strict=True):
            rates[k] = x
    return rates


_INVERSE_SERIES = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000)
"""Taylor coefficients of (1 - x/2 cot(x/2)) / x^2 in x^2."""


def _gyroscopic(inertia: Block, damping: Block, m: Motion, a: Spatial, dt: float) -> list[Scalar]:
    """Change of a single free body's acceleration by implicit integration of its gyroscopic and damping forces.

    The bias force is w x (w x h) and the bias torque about the origin w x J w; their derivatives with respect to w make
    the system unsymmetric (mjd_freeMhat).
    """
    w, h = m.angular_velocity, [inertia.mixed[1][2], inertia.mixed[2][0], inertia.mixed[0][1]]
    tensor = full(inertia.angular)
    along, momentum = dot(w, h), matvec(tensor, w)
    force = [[sub(mul(w[i], h[j]), mul(2.0, mul(h[i], w[j]))) for j in range(3)] for i in range(3)]
    torque = transpose([cross(w, column) for column in transpose(tensor)])
    for i in range(3):
        force[i][i] = add(force[i][i], along)
        j, k = (i + 1) % 3, (i + 2) % 3
        torque[j][k], torque[k][j] = add(torque[j][k], momentum[i]), sub(torque[k][j], momentum[i])
    both = inertia + damping
    rows = [[*full(both.linear)[i], *vadd(both.mixed[i], scale(dt, force[i]))] for i in range(3)]
    rows += [[*transpose(both.mixed)[i], *vadd(full(both.angular)[i], scale(dt, torque[i]))] for i in range(3)]
    drag, turn = damping @ a
    right = vadd(drag, scale(dt, matvec(force, a[1]))), vadd(turn, scale(dt, matvec(torque, a[1])))
    return lu_solve(rows, scale(-1.0, [*right[0], *right[1]]))


def _turned(q: Sequence[jax.Array], spin: Sequence[jax.Array], dt: Scalar) -> list[jax.Array]:
    """Unit quaternion after rotating for `dt` at a constant angular velocity in link axes (mju_quatIntegrate)."""
    square = spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]
    half = (0.25 * dt * dt) * square  # square of the half angle
    # Series of sin(x)/x and cos(x), exact to rounding for half angles below 0.5 rad. Larger rotations in one step are
    # not accurate in any case, but must stay rotations.
    small = half < 0.25
    angle = jnp.sqrt(jnp.where(small, 1.0, half))
    sinc = jnp.where(small, _series(half, 3), jnp.sin(angle) / angle) * (0.5 * dt)
    cosine = jnp.where(small, _series(half, 2), jnp.cos(angle))
    w, x, y, z = q
    a, b, c = (sinc * s for s in spin)
    return [
        w * cosine - x * a - y * b - z * c,
        w * a + x * cosine + y * c - z * b,
        w * b - x * c + y * cosine + z * a,
        w * c + x * b - y * a + z * cosine,
    ]


def _series(square: jax.Array, first: int) -> jax.Array:
    """1 - s/(first (first-1)) (1 - s/((first+2)(first+1)) (1 - ...)): sin(x)/x for first 3, cos(x) for 2, s = x^2."""
    result = jnp.ones_like(square)
    for n in range(first + 12, first - 1, -2):
        result = 1.0 - square * (1.0 / (n * (n - 1))) * result
    return result
