"""State of a chunk of worlds, and its conversion to and from MuJoCo's arrays."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from btr_mjx.engines.lanes_engine.actuation import group_rows
from btr_mjx.engines.lanes_engine.constraints.solver import RowNumbers
from btr_mjx.engines.lanes_engine.tree import TreePlan


@jax.tree_util.register_dataclass
@dataclass
class LanesState:
    """State of a chunk of C worlds; every array is (C,), or (G, C) for the members of a group."""

    q: list[list[jax.Array]]
    """Per joint of the plan: position and unit quaternion of a free joint, the latter of a ball joint, else one."""
    v: list[jax.Array]
    """Velocity per dof, MuJoCo's conventions."""
    act: list[jax.Array]
    """Activation states."""
    history: list[list[jax.Array]]
    """Controls of the last steps, the newest first, per actuator with a history buffer."""
    acceleration: list[jax.Array]
    """Acceleration per dof in the last step, MuJoCo's conventions; initial guess of the next step."""
    zones: RowNumbers
    """Zones of the constraints in the last step, see `constrained_acceleration`; initial guess of the next step."""
    power: jax.Array
    """Sum over actuators of |force x velocity| in the last step [W], (C,)."""
    capped: jax.Array
    """Whether the solver reached its iteration limit in the last step, bool (C,)."""
    tripped: jax.Array
    """Whether the bound of a guarded pair was crossed at the start of some step, bool (C,)."""


def split_rows(
    model: mujoco.MjModel, plan: TreePlan, qpos: jax.Array, qvel: jax.Array, act: jax.Array | None
) -> tuple[list[list[jax.Array]], list[jax.Array], list[jax.Array]]:
    """Positions (nq, C), velocities (nv, C) and activations (na, C) as the fields `q`, `v` and `act` of a state.

    Without activations these are zero.
    """
    q, v, acts = [], [], [jnp.zeros(0)] * plan.states
    for joint in plan.joints:
        positions, dofs = (np.array([adr[j] for j in joint.ids]) for adr in (model.jnt_qposadr, model.jnt_dofadr))
        q.append([group_rows(qpos, positions + i) for i in range(joint.coordinates)])
        v += [group_rows(qvel, dofs + i) for i in range(len(joint.dofs))]
    act = jnp.zeros((model.na, qpos.shape[-1]), qpos.dtype) if act is None else act
    for a in plan.actuators:
        if a.state >= 0:
            acts[a.state] = group_rows(act, model.actuator_actadr[list(a.ids)])
    return q, v, acts


def positions_in_order(model: mujoco.MjModel, plan: TreePlan, state: LanesState) -> jax.Array:
    """Generalised positions (nq, C), MuJoCo's order and conventions."""
    found = [
        (model.jnt_qposadr[j] + i, x, member)
        for joint, xs in zip(plan.joints, state.q, strict=True)
        for i, x in enumerate(xs)
        for member, j in enumerate(joint.ids)
    ]
    return _in_order(found)


def dofs_in_order(model: mujoco.MjModel, plan: TreePlan, values: Sequence[jax.Array]) -> jax.Array:
    """Values per dof of the plan as one array (nv, C), MuJoCo's order."""
    found = [
        (model.jnt_dofadr[j] + i, values[k], member)
        for joint in plan.joints
        for i, k in enumerate(joint.dofs)
        for member, j in enumerate(joint.ids)
    ]
    return _in_order(found)


def activations_in_order(model: mujoco.MjModel, plan: TreePlan, state: LanesState) -> jax.Array:
    """Activations (na, C), MuJoCo's order."""
    found = []
    for actuator in plan.actuators:
        if actuator.state >= 0:
            found += [
                (model.actuator_actadr[i], state.act[actuator.state], member) for member, i in enumerate(actuator.ids)
            ]
    return _in_order(found) if found else jnp.zeros((0, *state.power.shape), state.power.dtype)


def _in_order(rows: Sequence[tuple[int, jax.Array, int]]) -> jax.Array:
    """Stack rows (address, array (C,) or (G, C), member) by address."""
    return jnp.stack([x[member] if x.ndim == 2 else x for _, x, member in sorted(rows, key=lambda row: row[0])])
