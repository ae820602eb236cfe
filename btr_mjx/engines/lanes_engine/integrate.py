"""Integration of velocities and positions (mj_Euler, mj_implicit with implicitfast, mj_RungeKutta)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
from jax import lax

from btr_mjx.engines.base import MUJOCO_4
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.actuation import Actuation
from btr_mjx.engines.lanes_engine.articulated import factorise, lu_solve, solve_factored
from btr_mjx.engines.lanes_engine.constraints.solver import RowNumbers
from btr_mjx.engines.lanes_engine.dynamics import NO_BLOCK, System, local_rates, opposing_forces
from btr_mjx.engines.lanes_engine.kinematics import Motion, unit_quaternion
from btr_mjx.engines.lanes_engine.lanes_state import LanesState
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, propagate
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, TreePlan
from btr_mjx.engines.scalars import (
    Scalar,
    add,
    array,
    cross,
    dot,
    full,
    group_sum,
    is_zero,
    matvec,
    mul,
    scale,
    sub,
    total,
    transpose,
    vadd,
)


@dataclass(frozen=True)
class Forward:
    """Forces and accelerations at a state."""

    moving: Sequence[Motion]
    inertia: System
    damping: System
    """Of joint dampers."""
    actuation: Actuation
    medium: System | None
    """Minus the derivative of the fluid's drag by velocity."""
    found: list[jax.Array]
    """Accelerations per dof, with world axes."""
    capped: jax.Array
    zones: RowNumbers
    tripped: jax.Array


def integrate_step(model: mujoco.MjModel, plan: TreePlan, state: LanesState, f: Forward) -> LanesState:
    """State after one step of Euler or implicitfast from the forces and accelerations at a state."""
    dt = float(model.opt.timestep)
    implicit = f.damping
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        blocks = [NO_BLOCK] * len(plan.links)
        implicit = f.damping + System(blocks, {k: d for k, d in f.actuation.damping.items() if not is_zero(d)})
        implicit = implicit + f.medium if f.medium else implicit
    elif support.disabled(model, "EULERDAMP"):
        implicit = f.damping.times(0.0)
    implicit = implicit.times(dt)
    links = propagate(plan, f.moving, f.found)
    following: list[Scalar] = list(f.found)
    if not implicit.zero:
        # (M + h D) a' = M a, where M a is the sum of all forces. Solving for the difference a' - a reduces rounding
        # errors and does not need the contact forces.
        system = f.inertia + implicit
        wrenches, tau = opposing_forces(implicit, links, f.found)
        change, _ = solve_factored(factorise(plan, f.moving, system.blocks, system.diagonal), wrenches, tau)
        following = vadd(f.found, change)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        for link in plan.links:
            if link.free_body:
                i = link.index
                change = _gyroscopic(f.inertia.blocks[i], implicit.blocks[i], f.moving[i], links[i], dt)
                for k, c in zip(link.dofs, change, strict=True):
                    following[k] = add(f.found[k], c)
    acceleration = [array(x, a.shape, a.dtype) for x, a in zip(following, f.found, strict=True)]
    velocities = vadd(state.v, scale(dt, local_rates(plan, f.moving, acceleration)))
    q = moved_coordinates(plan, state.q, velocities, dt)
    return _following(q, velocities, f, local_rates(plan, f.moving, f.found))


def _following(q: list[list[jax.Array]], v: list[jax.Array], f: Forward, rates: list[jax.Array]) -> LanesState:
    """The state at these coordinates and velocities, after accelerations in MuJoCo's convention."""
    power = array(total(group_sum(p, size) for p, size in f.actuation.power), f.capped.shape, v[0].dtype)
    return LanesState(q, v, f.actuation.act, f.actuation.history, rates, f.zones, power, f.capped, f.tripped)


def runge_kutta(plan: TreePlan, dt: float, state: LanesState, forward: Callable[[LanesState], Forward]) -> LanesState:
    """State after one step of the classical Runge-Kutta method of fourth order (mj_RungeKutta).

    A stage ends where the velocity of the stage before leads; velocities of rotations are those of the coordinates of
    this motion, from MuJoCo 4.0 on.
    """
    dtype = state.v[0].dtype
    ahead, weights = (jnp.asarray(x, dtype) for x in ([0.5, 0.5, 1, 0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]))

    def stage(i: jax.Array, carry: tuple) -> tuple:
        here, moved, speed, rate, capped = carry
        f = forward(here)
        rates = [array(x, v.shape, dtype) for x, v in zip(local_rates(plan, f.moving, f.found), here.v, strict=True)]
        velocity = turning_rates(plan, moved, here.v) if MUJOCO_4 else here.v
        speed, rate = (vadd(sums, scale(weights[i], x)) for sums, x in ((speed, velocity), (rate, rates)))
        q = moved_coordinates(plan, state.q, velocity, ahead[i] * dt)
        moved, v = scale(ahead[i] * dt, velocity), vadd(state.v, scale(ahead[i] * dt, rates))
        return _following(q, v, f, rates), moved, speed, rate, capped | f.capped

    still = [jnp.zeros_like(x) for x in state.v]
    begin = (state, still, still, still, jnp.zeros_like(state.capped))
    end, _, speed, rate, capped = lax.fori_loop(0, 4, stage, begin)
    q, v = moved_coordinates(plan, state.q, speed, dt), vadd(state.v, scale(dt, rate))
    return replace(end, q=q, v=v, capped=capped)


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
