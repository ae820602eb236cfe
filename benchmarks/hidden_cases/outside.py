"""Effects outside the library, for cases in which "unexplained" is the correct verdict."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from hidden_cases.motion import Loads
from hidden_cases.physics import HiddenReality

Outside = Callable[[HiddenReality, Sequence[str], Loads, np.random.Generator], str]
"""Adds an effect to a reality, given its driven joints, their peak loads and a generator; returns the place."""


def crosstalk(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A share of one motor's torque acts on another joint, too."""
    source, target = rng.choice(len(joints), 2, replace=False)
    share = rng.uniform(0.06, 0.2)
    motor, name = reality.actuators_of([joints[source]])[0][0], joints[target]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] += share * data.actuator_force[motor]

    reality.hooks.append(hook)
    return f"joint:{name}"


def shaking(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A sinusoidal force on the trunk, or torque on a joint of a robot with a fixed base, at 1.5 to 3 `tempo`."""
    frequency, phase = reality.robot.tempo * rng.uniform(1.5, 3.0), rng.uniform(0, 2 * np.pi)
    base, name = reality.robot.base, str(rng.choice(joints))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    force = rng.uniform(0.15, 0.4) * _weight(reality)
    torque = rng.uniform(0.05, 0.2) * loads.torque[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        wave = np.sin(frequency * data.time + phase)
        if base is not None:
            data.body(base).xfrc_applied[:3] += force * wave * direction
        else:
            data.joint(name).qfrc_applied[0] += torque * wave

    reality.hooks.append(hook)
    return f"body:{base}" if base is not None else f"joint:{name}"


def elastic_cable(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A spring between two joints: a torque proportional to the difference of their angles."""
    first, second = (str(name) for name in rng.choice(joints, 2, replace=False))
    travel = loads.travel[first] + loads.travel[second]
    stiffness = rng.uniform(0.04, 0.12) * min(loads.torque[first], loads.torque[second]) / travel

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        torque = stiffness * (data.joint(first).qpos[0] - data.joint(second).qpos[0])
        data.joint(first).qfrc_applied[0] -= torque
        data.joint(second).qfrc_applied[0] += torque

    reality.hooks.append(hook)
    return f"joint:{first}"


def one_sided_cable(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A spring that acts on one side of an angle only, as a cable that is slack on the other."""
    name, sign = str(rng.choice(joints)), rng.choice([-1.0, 1.0])
    start = rng.uniform(-0.2, 0.2) * loads.travel[name]
    stiffness = rng.uniform(0.15, 0.45) * loads.torque[name] / loads.travel[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= sign * stiffness * max(0.0, sign * (data.joint(name).qpos[0] - start))

    reality.hooks.append(hook)
    return f"joint:{name}"


def hardening_spring(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A spring whose torque grows with the cube of the angle."""
    name = str(rng.choice(joints))
    cubic = rng.uniform(0.15, 0.5) * loads.torque[name] / loads.travel[name] ** 3

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= cubic * data.joint(name).qpos[0] ** 3

    reality.hooks.append(hook)
    return f"joint:{name}"


def fading_motor(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A motor whose force falls linearly over the recording, as by heating."""
    name, loss = str(rng.choice(joints)), rng.uniform(0.1, 0.35)
    motor, duration = reality.actuators_of([name])[0][0], reality.robot.duration

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= loss * data.time / duration * data.actuator_force[motor]

    reality.hooks.append(hook)
    return f"joint:{name}"


def cogging(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """Cogging: a torque that is sinusoidal in the angle, with a few periods over the joint's travel."""
    name, phase = str(rng.choice(joints)), rng.uniform(0, 2 * np.pi)
    size = rng.uniform(0.04, 0.12) * loads.torque[name]
    periods = rng.uniform(1.5, 4.0) * np.pi / loads.travel[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] += size * np.sin(periods * data.joint(name).qpos[0] + phase)

    reality.hooks.append(hook)
    return f"joint:{name}"


def bungee(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A linear spring of zero rest length from the trunk to a fixed point above it."""
    base = str(reality.robot.base)
    anchor = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(1.5, 2.5)])
    stiffness = rng.uniform(0.1, 0.3) * _weight(reality)

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.body(base).xfrc_applied[:3] += stiffness * (anchor - data.body(base).xipos)

    reality.hooks.append(hook)
    return f"body:{base}"


def loose_battery(reality: HiddenReality, joints: Sequence[str], loads: Loads, rng: np.random.Generator) -> str:
    """A pendulum in the trunk, or at the last link of a robot with a fixed base, as a loose battery."""
    model = reality.robot.model
    body = reality.robot.base or model.body(int(model.jnt_bodyid[model.njnt - 1])).name
    whole = float(model.body_subtreemass[0])
    length = 1.5 * 9.81 / (0.5 * reality.robot.tempo) ** 2  # natural frequency near half of `tempo`
    holder = reality.spec.body(body).add_body(name="battery", pos=[*rng.uniform(-0.05, 0.05, 2), 0.0])
    holder.add_joint(name="battery swings", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], damping=[1e-4, 0, 0])
    length = float(np.clip(length, 0.02, 0.3))
    weight = rng.uniform(0.04, 0.12) * (whole if reality.robot.base else float(model.body(body).mass[0]) * 2)
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    holder.add_geom(type=ball, pos=[0, 0, -length], size=[0.01, 0, 0], mass=weight, contype=0, conaffinity=0)
    return f"body:{body}"


OUTSIDE: dict[str, Outside] = {
    "crosstalk": crosstalk,
    "shaking": shaking,
    "elastic_cable": elastic_cable,
    "one_sided_cable": one_sided_cable,
    "hardening_spring": hardening_spring,
    "fading_motor": fading_motor,
    "cogging": cogging,
    "bungee": bungee,
    "loose_battery": loose_battery,
}
"""Effects by name."""


def possible_outside(reality: HiddenReality) -> list[str]:
    """Names of the effects outside the library that a robot can have.

    Args:
      reality: a reality of the robot.
    """
    single = len(reality.spec.actuators) < 2
    floating = reality.robot.base is not None
    absent = {"crosstalk", "elastic_cable"} if single else set()
    return [name for name in OUTSIDE if name not in absent and (floating or name != "bungee")]


def _weight(reality: HiddenReality) -> float:
    return float(reality.robot.model.body_subtreemass[0]) * 9.81
