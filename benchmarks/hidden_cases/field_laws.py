"""Forces that no effect of the library is, for the robots of `field_physics`: drawn, and as functions.

law = draw_law(rng, "ripple", model, usual)          # plain data, for a truth file
force, is_friction = hidden_force(law, model)        # a function of positions, velocities and time
"""

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

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
