"""Semi-implicit integration of velocities and positions (mj_Euler, mj_implicit with implicitfast)."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import mujoco

from btr_mjx.engines.lanes import support
from btr_mjx.engines.lanes.articulated import solve
from btr_mjx.engines.lanes.dynamics import System, against, local_rates
from btr_mjx.engines.lanes.kinematics import Motion, unit_quaternion
from btr_mjx.engines.lanes.scalars import Scalar, add, array, is_zero, scale, vadd
from btr_mjx.engines.lanes.spatial import propagate
from btr_mjx.engines.lanes.tree import FREE, Plan


def advance(
    model: mujoco.MjModel,
    plan: Plan,
    motions: Sequence[Motion],
    q: Sequence[Sequence[jax.Array]],
    v: Sequence[jax.Array],
    inertia: System,
    damping: System,
    actuator_damping: Mapping[int, Scalar],
    acceleration: Sequence[jax.Array],
) -> tuple[list[list[jax.Array]], list[jax.Array]]:
    """Next coordinates and velocities.

    Args:
      model: base model: integrator, flags and time step.
      plan: the static plan.
      motions: where the links are.
      q: coordinates per joint.
      v: velocity per dof.
      inertia: of all links, with armature, M.
      damping: minus the derivative of the passive forces by velocity, D.
      actuator_damping: the same of the actuator forces, per dof.
      acceleration: solution of the constraint problem, per dof.

    Returns:
      Coordinates per joint and velocities per dof after one step.
    """
    dt = float(model.opt.timestep)
    implicit = damping
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        scalars = {k: d for k, d in actuator_damping.items() if not is_zero(d)}
        implicit = System(
            damping.blocks, damping.diagonal | {k: add(damping.diagonal.get(k, 0.0), d) for k, d in scalars.items()}
        )
    elif support.disabled(model, "EULERDAMP"):
        implicit = damping.times(0.0)
    if not implicit.zero:
        # (M + h D) a' = M a, since M a is the sum of all forces at the solution; solving for the difference a' - a
        # keeps digits and spares the projection of the contact forces.
        rated = implicit.times(dt)
        system = inertia + rated
        wrenches, tau = against(rated, propagate(plan, motions, acceleration), acceleration)
        change, _ = solve(plan, motions, system.blocks, wrenches, system.diagonal, tau)
        acceleration = [array(add(a, c), a.shape, a.dtype) for a, c in zip(acceleration, change, strict=True)]
    rates = local_rates(plan, motions, acceleration)
    velocities = vadd(v, scale(dt, rates))
    coordinates = []
    joints = [joint for link in plan.links for joint in link.joints]
    for joint, old in zip(joints, q, strict=True):
        speed = [velocities[k] for k in joint.dofs]
        moved = vadd(old[: min(3, len(old))], scale(dt, speed[: min(3, len(old))]))
        if joint.kind == FREE:
            moved += _turned(unit_quaternion(old[3:]), speed[3:], dt)
        coordinates.append(moved)
    return coordinates, velocities


def _turned(q: Sequence[jax.Array], spin: Sequence[jax.Array], dt: float) -> list[jax.Array]:
    """Unit quaternion after turning for `dt` at a constant angular velocity in link axes (mju_quatIntegrate)."""
    square = spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]
    half = (0.25 * dt * dt) * square  # square of the half angle
    # Series of sin(x)/x and cos(x): exact to rounding below one radian of half angle; an angular velocity that turns
    # further in one step is beyond what any step can follow, but must stay a rotation.
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
