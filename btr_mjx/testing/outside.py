"""Effects outside the library: what a workflow has to call unexplained instead of naming the nearest thing it knows."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from btr_mjx.testing.motion import Loads
from btr_mjx.testing.physics import HiddenReality

Outside = Callable[[HiddenReality, Sequence[str], Loads, np.random.Generator], str]
"""Adds the effect to a reality with driven joints, their loads and a generator; returns where it sits."""


def crosstalk(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A share of one motor's torque leaks into another joint."""
    source, target = rng.choice(len(joints), 2, replace=False)
    share = rng.uniform(0.06, 0.2)
    motor, name = r.actuators_of([joints[source]])[0][0], joints[target]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] += share * data.actuator_force[motor]

    r.hooks.append(hook)
    return f"joint:{name}"


def shaking(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A periodic force on the trunk, or a torque on a joint of a robot that is bolted down; not locked to the gait."""
    frequency, phase = r.robot.tempo * rng.uniform(1.5, 3.0), rng.uniform(0, 2 * np.pi)
    base, name = r.robot.base, str(rng.choice(joints))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    force = rng.uniform(0.15, 0.4) * _weight(r)
    torque = rng.uniform(0.05, 0.2) * sizes.torque[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        wave = np.sin(frequency * data.time + phase)
        if base is not None:
            data.body(base).xfrc_applied[:3] += force * wave * direction
        else:
            data.joint(name).qfrc_applied[0] += torque * wave

    r.hooks.append(hook)
    return f"body:{base}" if base is not None else f"joint:{name}"


def elastic_cable(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """An elastic cable that ties two joints together."""
    first, second = (str(name) for name in rng.choice(joints, 2, replace=False))
    travel = sizes.travel[first] + sizes.travel[second]
    stiffness = rng.uniform(0.04, 0.12) * min(sizes.torque[first], sizes.torque[second]) / travel

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        torque = stiffness * (data.joint(first).qpos[0] - data.joint(second).qpos[0])
        data.joint(first).qfrc_applied[0] -= torque
        data.joint(second).qfrc_applied[0] += torque

    r.hooks.append(hook)
    return f"joint:{first}"


def one_sided_cable(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A cable that pulls in one half of a joint's range and hangs loose in the other."""
    name, sign = str(rng.choice(joints)), rng.choice([-1.0, 1.0])
    start = rng.uniform(-0.2, 0.2) * sizes.travel[name]
    stiffness = rng.uniform(0.15, 0.45) * sizes.torque[name] / sizes.travel[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= sign * stiffness * max(0.0, sign * (data.joint(name).qpos[0] - start))

    r.hooks.append(hook)
    return f"joint:{name}"


def hardening_spring(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A spring whose torque grows with the cube of the angle."""
    name = str(rng.choice(joints))
    cubic = rng.uniform(0.15, 0.5) * sizes.torque[name] / sizes.travel[name] ** 3

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= cubic * data.joint(name).qpos[0] ** 3

    r.hooks.append(hook)
    return f"joint:{name}"


def fading_motor(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A motor that loses force over the recording, as one that grows hot."""
    name, loss = str(rng.choice(joints)), rng.uniform(0.1, 0.35)
    motor, duration = r.actuators_of([name])[0][0], r.robot.duration

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] -= loss * data.time / duration * data.actuator_force[motor]

    r.hooks.append(hook)
    return f"joint:{name}"


def cogging(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A torque that ripples with the angle, a few periods over the joint's travel."""
    name, phase = str(rng.choice(joints)), rng.uniform(0, 2 * np.pi)
    size = rng.uniform(0.04, 0.12) * sizes.torque[name]
    periods = rng.uniform(1.5, 4.0) * np.pi / sizes.travel[name]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.joint(name).qfrc_applied[0] += size * np.sin(periods * data.joint(name).qpos[0] + phase)

    r.hooks.append(hook)
    return f"joint:{name}"


def bungee(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """An elastic cord from the trunk to a fixed point above."""
    base = str(r.robot.base)
    anchor = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(1.5, 2.5)])
    stiffness = rng.uniform(0.1, 0.3) * _weight(r)

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.body(base).xfrc_applied[:3] += stiffness * (anchor - data.body(base).xipos)

    r.hooks.append(hook)
    return f"body:{base}"


def loose_battery(r: HiddenReality, joints: Sequence[str], sizes: Loads, rng: np.random.Generator) -> str:
    """A battery that swings in the trunk, or at the last link of a robot that is bolted down."""
    model = r.robot.model
    body = r.robot.base or model.body(int(model.jnt_bodyid[model.njnt - 1])).name
    whole = float(model.body_subtreemass[0])
    length = 1.5 * 9.81 / (0.5 * r.robot.tempo) ** 2  # swings at about half the tempo of the motion
    holder = r.spec.body(body).add_body(name="battery", pos=[*rng.uniform(-0.05, 0.05, 2), 0.0])
    holder.add_joint(name="battery swings", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], damping=[1e-4, 0, 0])
    length = float(np.clip(length, 0.02, 0.3))
    weight = rng.uniform(0.04, 0.12) * (whole if r.robot.base else float(model.body(body).mass[0]) * 2)
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
"""By name."""


def possible(reality: HiddenReality) -> list[str]:
    """Those that a robot can have."""
    single = len(reality.spec.actuators) < 2
    floating = reality.robot.base is not None
    absent = {"crosstalk", "elastic_cable"} if single else set()
    return [name for name in OUTSIDE if name not in absent and (floating or name != "bungee")]


def _weight(r: HiddenReality) -> float:
    return float(r.robot.model.body_subtreemass[0]) * 9.81
