"""Forces of actuators and springs, and derivatives of actuator forces with respect to velocity.

Source: google-deepmind/mujoco, mj_fwdActuation, mj_nextActivation and mjd_actuator_vel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from btr_mjx.engines.base import MUJOCO_4
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.delays import delayed
from btr_mjx.engines.lanes_engine.kinematics import Motion, axis_angle, path_motion, quaternion_product, unit_quaternion
from btr_mjx.engines.lanes_engine.parameters import Parameters
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, Actuator, Tendon, TreePlan
from btr_mjx.engines.scalars import Scalar, add, dot, is_zero, matvec, mul, neg, scale, sub, total

_DYN, _GAIN, _BIAS = mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias


@dataclass(frozen=True)
class _JointActuator:
    """An actuator and the state of the joint that it drives."""

    key: str
    """Prefix of the actuator's names in `Parameters`."""
    actuator: Actuator
    q: jax.Array
    """Coordinate of the joint [m or rad]."""
    v: jax.Array
    """Velocity of the joint [m/s or rad/s]."""


@dataclass
class Actuation:
    """Actuator forces and states of one step."""

    force: dict[int, Scalar]
    """Generalised force per dof of the plan."""
    damping: dict[int, Scalar]
    """Minus the derivative of that force with respect to the dof's velocity [N s/m or N m s/rad]."""
    act: list[jax.Array]
    """Activations at the end of the step."""
    history: list[list[jax.Array]]
    """Controls of the last steps, the newest first, per history of the plan."""
    power: list[tuple[Scalar, int]]
    """|force x velocity| of each actuator [W], and its group size."""


def group_rows(values: jax.Array, ids: Sequence[int] | np.ndarray) -> jax.Array:
    """Rows of an (n, C) array for the members of a group, (C,) or (G, C), as one strided slice if possible."""
    if len(ids) == 1:
        return values[ids[0]]
    steps = set(np.diff(ids).tolist())
    if len(steps) == 1 and (step := steps.pop()) > 0:
        return values[ids[0] : ids[-1] + 1 : step]
    return jnp.stack([values[i] for i in ids])


def _clip(value: Scalar, bounds: Sequence[Scalar]) -> jax.Array:
    ones = jnp.ones_like(value)
    return jnp.clip(value, mul(bounds[0], ones), mul(bounds[1], ones))


def actuate(
    model: mujoco.MjModel,
    plan: TreePlan,
    parameters: Parameters,
    q: Sequence[Sequence[jax.Array]],
    v: Sequence[jax.Array],
    act: Sequence[jax.Array],
    history: Sequence[Sequence[jax.Array]],
    ctrl: jax.Array,
) -> Actuation:
    """Actuator forces at a state and controls (nu, C), their derivatives and next activations (mj_fwdActuation).

    Coordinates are per joint, velocities per dof, activations and earlier controls per state and history of the plan.
    """
    result = Actuation({}, {}, list(act), [list(samples) for samples in history], [])
    if support.disabled(model, "ACTUATION"):
        return result
    coordinates = iter(q)
    for link in plan.links:
        for n, joint in enumerate(link.joints):
            here, key = next(coordinates), f"{link.index}/joint{n}"
            if joint.kind == FREE or not joint.actuators:
                continue
            dof = joint.dofs[0]
            force: Scalar = 0.0
            for k, actuator in enumerate(joint.actuators):
                own = f"{key}/actuator{k}"
                driven = _JointActuator(own, actuator, here[0], v[dof])
                one = _actuator(model, parameters, driven, act, ctrl, result)
                velocity = mul(parameters.one(f"{own}/gear"), v[dof])
                result.power.append((jnp.abs(mul(one[0], velocity)), link.size))
                gear = parameters.one(f"{own}/gear")
                force = add(force, mul(gear, one[0]))
                result.damping[dof] = add(result.damping.get(dof, 0.0), mul(mul(gear, gear), one[1]))
            if model.jnt_actfrclimited[joint.ids[0]]:
                limited = _clip(force, parameters[f"{key}/actfrcrange"])
                if MUJOCO_4:
                    result.damping[dof] = mul(result.damping[dof], limited == force)
                force = limited
            result.force[dof] = force
    pulls: dict[Tendon, Scalar] = {}
    for tendon in plan.tendons:
        length, velocity = path_motion(plan, tendon.path, q, v)
        for k, actuator in enumerate(tendon.actuators):
            key = f"tendon{tendon.id}/actuator{k}"
            one = _actuator(model, parameters, _JointActuator(key, actuator, length, velocity), act, ctrl, result)
            gear = parameters.one(f"{key}/gear")
            result.power.append((jnp.abs(mul(one[0], mul(gear, velocity))), 1))
            pulls[tendon] = add(pulls.get(tendon, 0.0), mul(gear, one[0]))
    for dof, force in _pulled(plan, pulls).items():
        result.force[dof] = add(result.force.get(dof, 0.0), force)
    return result


def _pulled(plan: TreePlan, pulls: Mapping[Tendon, jax.Array]) -> dict[int, Scalar]:
    """Generalised forces per dof of forces along fixed tendons."""
    found: dict[int, Scalar] = {}
    for joint in plan.joints:
        rows = [total(mul(dict(t.path).get(j, 0.0), pull) for t, pull in pulls.items()) for j in joint.ids]
        if any(not is_zero(row) for row in rows):
            like = next(iter(pulls.values()))
            full = [jnp.zeros_like(like) if is_zero(row) else row for row in rows]
            found[joint.dofs[0]] = full[0] if len(full) == 1 else jnp.stack(full)
    return found


def tendon_forces(
    model: mujoco.MjModel, plan: TreePlan, q: Sequence[Sequence[jax.Array]], v: Sequence[jax.Array]
) -> dict[int, Scalar]:
    """Generalised forces per dof of the springs and dampers of fixed tendons (mj_passive)."""
    pulls = {}
    for tendon in plan.tendons:
        stiffness, damping = float(model.tendon_stiffness[tendon.id]), float(model.tendon_damping[tendon.id])
        length, velocity = path_motion(plan, tendon.path, q, v)
        low, high = model.tendon_lengthspring[tendon.id].tolist()
        stretch = jnp.maximum(length - high, 0) + jnp.minimum(length - low, 0)
        spring = 0.0 if support.disabled(model, "SPRING") else mul(-stiffness, stretch)
        drag = 0.0 if support.disabled(model, "DAMPER") else mul(-damping, velocity)
        pull = add(spring, drag)
        if not is_zero(pull):
            pulls[tendon] = pull
    return _pulled(plan, pulls)


def _actuator(
    model: mujoco.MjModel,
    parameters: Parameters,
    driven: _JointActuator,
    act: Sequence[jax.Array],
    ctrl: jax.Array,
    result: Actuation,
) -> tuple[Scalar, Scalar]:
    """Force of one actuator and minus its derivative by velocity; sets its next activation in `result`."""
    key, actuator = driven.key, driven.actuator
    a = actuator.ids[0]
    gear = parameters.one(f"{key}/gear")
    length, velocity = mul(gear, driven.q), mul(gear, driven.v)
    raw = u = group_rows(ctrl, actuator.ids)
    if actuator.history >= 0:
        samples, delay = result.history[actuator.history], parameters.one(f"{key}/delay")
        result.history[actuator.history] = [raw, *samples[:-1]]
        if not is_zero(delay):
            age = mul(1.0 / float(model.opt.timestep), delay)
            u = jnp.where(sub(delay, 0.0) != 0, delayed(samples, age, int(model.actuator_history[a, 1])), u)
    if model.actuator_ctrllimited[a] and not support.disabled(model, "CLAMPCTRL"):
        u = _clip(u, parameters[f"{key}/ctrlrange"])
    gain, bias = parameters[f"{key}/gain"], parameters[f"{key}/bias"]
    state = [1.0, length, velocity]
    if model.actuator_biastype[a] == _BIAS.mjBIAS_NONE:
        bias = [0.0, 0.0, 0.0]
    damping = mul(-1.0, bias[2])
    if actuator.state >= 0:
        result.act[actuator.state] = _next_act(model, parameters, key, a, act[actuator.state], u, length)
    if model.actuator_gaintype[a] == _GAIN.mjGAIN_PID:
        force = total([mul(mul(-1.0, bias[1]), sub(u, length)), bias[0], mul(bias[2], velocity)])
        if actuator.state >= 0:
            force = add(force, mul(gain[0], act[actuator.state]))
    else:
        drive = act[actuator.state] if actuator.state >= 0 else u
        if model.actuator_gaintype[a] == _GAIN.mjGAIN_AFFINE:
            factor = dot(gain, state)
            damping = sub(damping, mul(gain[2], drive))
        else:
            factor = gain[0]
        force = add(mul(factor, drive), dot(bias, state))
    if model.actuator_forcelimited[a]:
        bounds = parameters[f"{key}/forcerange"]
        inside = (sub(force, bounds[0]) > 0) & (sub(force, bounds[1]) < 0)
        if not is_zero(damping):
            damping = jnp.where(inside, damping, 0)
        force = _clip(force, bounds)
    return force, damping


def _next_act(
    model: mujoco.MjModel, parameters: Parameters, key: str, a: int, z: jax.Array, u: jax.Array, length: Scalar
) -> jax.Array:
    """Activation after one step (mj_nextActivation)."""
    dt, kind = float(model.opt.timestep), int(model.actuator_dyntype[a])
    first = parameters[f"{key}/dynamics"][0]
    if kind == _DYN.mjDYN_PID:
        rate = sub(u, length)
        if model.actuator_dynprm[a, 0] > 0:  # anti-windup
            rate = jnp.where(sub(z, first) >= 0, jnp.minimum(rate, 0), rate)
            rate = jnp.where(add(z, first) <= 0, jnp.maximum(rate, 0), rate)
        following = add(z, mul(dt, rate))
    elif kind == _DYN.mjDYN_INTEGRATOR:
        following = add(z, mul(dt, u))
    else:
        tau = jnp.maximum(first, 1e-15)
        share = dt / tau if kind == _DYN.mjDYN_FILTER else -jnp.expm1(-dt / tau)
        following = add(z, sub(u, z) * jnp.asarray(share, z.dtype))
    if model.actuator_actlimited[a]:
        following = _clip(following, parameters[f"{key}/actrange"])
    return following


def springs(
    plan: TreePlan, parameters: Parameters, q: Sequence[Sequence[jax.Array]], motions: Sequence[Motion]
) -> dict[int, Scalar]:
    """Spring force per dof [N or N m]; absent where a joint has no stiffness."""
    result: dict[int, Scalar] = {}
    coordinates = iter(q)
    for link, m in zip(plan.links, motions, strict=True):
        for n, joint in enumerate(link.joints):
            here, key = next(coordinates), f"{link.index}/joint{n}"
            if joint.kind == FREE or is_zero(parameters.one(f"{key}/stiffness")):
                continue
            if joint.kind == BALL:
                w, *vector = parameters[f"{key}/spring"]
                axis, angle = axis_angle(quaternion_product([w, *map(neg, vector)], unit_quaternion(here)))
                torque = scale(mul(neg(parameters.one(f"{key}/stiffness")), angle), matvec(m.axes, axis))
                result |= dict(zip(joint.dofs, torque, strict=True))
                continue
            stretch = sub(here[0], parameters.one(f"{key}/spring"))
            result[joint.dofs[0]] = mul(mul(-1.0, parameters.one(f"{key}/stiffness")), stretch)
    return result
