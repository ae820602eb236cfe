"""Arms of six joints whose drives report their torques: what these tell beside commands, and instead of them.

Encoders have 0.2 mrad of noise, reports 0.05 N m; beside commands, torque constants are 4 % off.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

JOINTS = 6
LENGTHS, MASSES = (0.15, 0.35, 0.3, 0.1, 0.1, 0.08), (4.0, 3.5, 2.2, 1.2, 1.0, 0.4)
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
STRENGTH = np.array([1.0, 1.0, 0.8, 0.4, 0.4, 0.25])
"""Size of friction and rotors at each joint, in units of the first."""

STEP, EVERY = 2e-4, 20
"""Time step of the simulated reality [s], and steps per sample."""


def arm(actuator: str = 'position kp="200" kv="5"') -> str:
    """MJCF of an arm whose joints are driven by actuators of one kind."""
    bodies = ""
    for i, (axis, length, mass) in enumerate(zip(AXES, LENGTHS, MASSES, strict=True)):
        at = LENGTHS[i - 1] if i else 0.1
        bodies += (
            f'<body name="link{i}" pos="0 0 {at}"><joint name="j{i}" axis="{axis}"/><geom type="capsule" '
            f'fromto="0 0 0 0.03 0 {length}" size="0.03" mass="{mass}" contype="0" conaffinity="0"/>'
        )
    kind, _, numbers = actuator.partition(" ")
    drives = "".join(f'<{kind} name="m{i}" joint="j{i}" {numbers}/>' for i in range(JOINTS))
    return (
        '<mujoco><option timestep="0.001" integrator="implicitfast"/><default><joint damping="0.3" armature="0.02"/>'
        f"</default><worldbody>{bodies}{'</body>' * JOINTS}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def references(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """(steps, joints) smooth motion that begins at rest [rad]."""
    size, rate = rng.uniform(0.1, 0.4, (JOINTS, 3)), rng.uniform(0.1, 0.9, (JOINTS, 3))
    phase = rng.uniform(0, 2 * np.pi, (JOINTS, 3))
    t = np.arange(round(seconds / STEP))[:, None, None] * STEP
    return (size * (np.sin(2 * np.pi * rate * t + phase) - np.sin(phase))).sum(-1)


def write_log(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write arrays (K, joints) by the ending of their names, with time stamps."""
    count = len(next(iter(columns.values())))
    head = ["t", *(f"j{i}_{name}" for name in columns for i in range(JOINTS))]
    rows = np.concatenate([np.arange(count)[:, None] * STEP * EVERY, *columns.values()], 1)
    np.savetxt(path, rows, "%.6f", delimiter=",", header=",".join(head), comments="")


def weak_or_stiff(folder: Path, seed: int, index: int, reported: bool) -> dict[str, Any]:
    """Record a weak motor and damping at one joint, with reported torques or without; returns the truth."""
    rng = np.random.default_rng([seed, index])
    model = mujoco.MjModel.from_xml_string(arm())
    model.opt.timestep = STEP
    joint = int(rng.integers(JOINTS))
    model.dof_damping *= 1 + 0.03 * rng.standard_normal(JOINTS)
    model.body_mass[1:] *= 1 + 0.005 * rng.standard_normal(JOINTS)
    model.actuator_gainprm[joint] *= 0.85
    model.actuator_biasprm[joint] *= 0.85
    damping = float(rng.uniform(0.5, 1.5) * STRENGTH[joint])
    model.dof_damping[joint] += damping
    mujoco.mj_setConst(model, mujoco.MjData(model))
    constant = 1 + 0.04 * rng.standard_normal(JOINTS)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(arm())
    for number in range(4):
        data, wanted, rows = mujoco.MjData(model), references(rng, 8.0), []
        for k, target in enumerate(wanted):
            data.ctrl[:] = target
            mujoco.mj_step1(model, data)
            if k % EVERY == 0:
                mujoco.mj_fwdActuation(model, data)
                rows.append((data.qpos.copy(), target, constant * data.actuator_force))
            mujoco.mj_step2(model, data)
        position, command, torque = map(np.array, zip(*rows, strict=True))
        position += 2e-4 * rng.standard_normal(position.shape)
        torque += 0.05 * rng.standard_normal(torque.shape)
        effort = {"effort": torque} if reported else {}
        write_log(folder / f"{number}.csv", {"pos": position, "cmd": command} | effort)
    weak = {"effect": "actuator_gain", "location": f"actuator:m{joint}", "parameters": {"change": -0.15}}
    damped = {"effect": "viscous_damping", "location": f"joint:j{joint}", "parameters": {"damping": damping}}
    return {"effects": [weak, damped]}


def drives(folder: Path, seed: int, index: int) -> dict[str, Any]:
    """Record an arm whose controller is unknown and whose drives rub, are damped and have rotors.

    Returns:
      Friction [N m], damping [N m s/rad] and rotor inertia [kg m^2] that the believed model lacks, (joints,) each.
    """
    rng = np.random.default_rng([seed, index])
    model = mujoco.MjModel.from_xml_string(arm("motor"))
    model.opt.timestep = STEP
    friction, rotor = rng.uniform(0.3, 1.5, JOINTS) * STRENGTH, rng.uniform(0.1, 0.4, JOINTS) * STRENGTH
    damping = rng.uniform(0.2, 1.2, JOINTS)
    model.dof_frictionloss[:] = friction
    model.dof_armature += rotor
    model.dof_damping += damping
    stiffness, rate = rng.uniform(100, 400, JOINTS), rng.uniform(3, 12, JOINTS)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(arm())
    for number in range(4):
        data, wanted, rows = mujoco.MjData(model), references(rng, 12.0), []
        for k, target in enumerate(wanted):
            data.ctrl[:] = stiffness * (target - data.qpos) - rate * data.qvel + 0.6 * data.qfrc_bias
            if k % EVERY == 0:
                rows.append((data.qpos.copy(), data.ctrl.copy()))
            mujoco.mj_step(model, data)
        position, torque = map(np.array, zip(*rows, strict=True))
        position += 2e-4 * rng.standard_normal(position.shape)
        torque += 0.05 * rng.standard_normal(torque.shape)
        write_log(folder / f"{number}.csv", {"pos": position, "effort": torque})
    return {name: own.tolist() for name, own in (("friction", friction), ("damping", damping), ("rotor", rotor))}
