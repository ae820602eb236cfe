"""Forces that no effect of the library is, for the robots of `field_physics`: drawn, as functions, and compared.

law = draw_law(rng, "ripple", model, usual)          # plain data, for a truth file
force, is_friction = hidden_force(law, model)        # a function of positions, velocities and time
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.results import FoundEffect, resolve_effect
from btr_mjx.gap.simulate import Rows, World

HiddenForce = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""From positions and velocities (nv,) and the time [s] to generalised forces, or to friction torques, (nv,)."""
LAWS = ("ripple", "coupling", "drag", "uneven friction", "counterweight", "dead band", "periodic")
"""Kinds of laws. A dead band is the backlash of the library."""


def draw_law(rng: np.random.Generator, kind: str, model: mujoco.MjModel, usual: Any) -> dict[str, Any]:
    """A law at a driven joint, with a size that matters.

    Args:
      rng: of the case.
      kind: of `LAWS`.
      model: the believed robot.
      usual: sizes of its motion, see `field_cases`.
    """
    joints = [int(j) for j in model.actuator_trnid[: model.nactuator, 0]]
    joint = int(rng.choice(joints))
    other = int(rng.choice([j for j in joints if j != joint]))
    dof = int(model.jnt_dofadr[joint])
    torque, speed, reach = usual.torque[dof], usual.speed[dof], usual.reach[dof]
    name = model.joint(joint).name
    if kind == "dead band":
        play = float(rng.uniform(0.05, 0.12) * reach)
        return {"effect": "backlash", "location": f"joint:{name}", "parameters": {"play": play}}
    phase = float(rng.uniform(0, 2 * np.pi))
    numbers = {
        "ripple": (rng.uniform(0.2, 0.4) * torque, rng.uniform(6, 16), phase),
        "coupling": (rng.uniform(0.4, 0.8) * torque / reach, rng.uniform(0.5, 0.8)),
        "drag": (rng.uniform(0.25, 0.5) * torque / speed**2,),
        "uneven friction": (rng.uniform(0.12, 0.25) * torque,),
        "counterweight": (rng.uniform(0.3, 0.6) * torque, phase),
        "periodic": (rng.uniform(0.15, 0.3) * torque, 2 * np.pi * rng.uniform(0.7, 4.0), phase),
    }[kind]
    return {
        "effect": "law",
        "location": f"joint:{name}",
        "kind": kind,
        "other": model.joint(other).name,
        "parameters": {f"p{i}": float(value) for i, value in enumerate(numbers)},
    }


def hidden_force(law: Mapping[str, Any], model: mujoco.MjModel) -> tuple[HiddenForce, bool]:
    """A law as a function, and whether it is that of a friction torque.

    Args:
      law: of `draw_law`.
      model: the robot.
    """
    kind, p = law["kind"], list(law["parameters"].values())
    own, other = (
        int(model.jnt_dofadr[model.joint(name).id]) for name in (law["location"].partition(":")[2], law["other"])
    )

    def at(q: np.ndarray, v: np.ndarray, t: float) -> float:
        if kind == "ripple":
            return p[0] * np.sin(p[1] * q[own] + p[2])
        if kind == "coupling":
            return -p[0] * (q[own] - p[1] * q[other])
        if kind == "drag":
            return -p[0] * v[own] * abs(v[own])
        if kind == "uneven friction":
            return p[0] * (1 + np.cos(q[own]))
        if kind == "counterweight":
            return p[0] * np.cos(q[own] + p[1])
        return p[0] * np.sin(p[1] * t + p[2])

    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        out = np.zeros(model.nv)
        out[own] = at(q, v, t)
        return out

    return force, kind == "uneven friction"


def positions(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """(N, nv) positions of hinges and slides from configurations (N, nq)."""
    out = np.zeros((len(qpos), model.nv))
    for j in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        out[:, model.jnt_dofadr[j]] = qpos[:, model.jnt_qposadr[j]]
    return out


def true_force(
    law: Mapping[str, Any], model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """(N, nv) force of a law where joints slide."""
    force, is_friction = hidden_force(law, model)
    rows = zip(positions(model, qpos), qvel, time, strict=True)
    return np.array([force(q, v, t) * (-np.sign(v) if is_friction else 1.0) for q, v, t in rows])


def found_force(
    effects: Sequence[Mapping[str, Any]],
    model: mujoco.MjModel,
    qpos: np.ndarray,
    qvel: np.ndarray,
    torque: np.ndarray,
    time: np.ndarray,
) -> np.ndarray:
    """(N, nv) generalised force that named effects add where joints slide, at rest of accelerations.

    Args:
      effects: entries of result.json.
      model: the believed robot.
      qpos: (N, nq).
      qvel: (N, nv).
      torque: (N, nv) forces of the actuators.
      time: (N,) [s].
    """
    worlds = [World.of(model), World.of(model)]
    for entry in effects:
        effect, place, values = resolve_effect(model, FoundEffect.from_result(entry), KNOWN_EFFECTS)
        effect.apply(worlds[1], place, values)
    before, after = (_force(world, qpos, qvel, torque, time) for world in worlds)
    return after - before


def _force(world: World, qpos: np.ndarray, qvel: np.ndarray, torque: np.ndarray, time: np.ndarray) -> np.ndarray:
    model = world.update_constants()
    n, data = len(qpos), mujoco.MjData(model)
    loss = np.tile(model.dof_frictionloss, (n, 1))
    fields = {"dof_frictionloss": loss}
    fields |= {
        name: np.tile(getattr(model, name), (n, *[1] * getattr(model, name).ndim))
        for law in world.laws
        for name in law.fields
        if name not in fields
    }
    applied = np.zeros((n, model.nv))
    rows = Rows(
        model,
        time,
        qpos,
        qvel,
        np.zeros((n, model.na)),
        np.zeros((n, model.nu)),
        applied,
        np.zeros((n, model.nbody, 6)),
        np.zeros((n, model.nactuator)),
        torque,
        fields,
    )
    for law in world.laws:
        law(rows)
    model.dof_frictionloss[:] = 0
    out = applied - loss * np.sign(qvel)
    for i in range(n):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[i], qvel[i], 0.0
        mujoco.mj_inverse(model, data)
        out[i] -= data.qfrc_inverse
    return out
