"""Quadrupeds in the field: recordings with encoders, an inertial unit and torques instead of motion capture.

    make_walks(folder, seed=1, index=0, sensors="imu", fault="late")        # writes the folder, returns the truth

Two simulators make the robots: that of `cases` and that of `field_cases`. Encoders have 1 mrad and 0.05 rad/s of noise,
the unit 0.005 rad/s, 0.1 m/s^2 and 0.01 rad, and is turned by 2 degrees on its base; reported torques are 4 % off.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.models import integrate
from btr_mjx.runs import write_arrays
from hidden_cases.case_sampling import Draw
from hidden_cases.cases import draw_reality
from hidden_cases.field_cases import usual_sizes
from hidden_cases.field_physics import SETTLE, Calibration, Controlled, build, draw_calibration, move
from hidden_cases.field_robots import ROBOTS
from hidden_cases.imu import Mount, imu_columns, with_fault, with_imu
from hidden_cases.motion import peak_loads, simulate_reality
from hidden_cases.robots import case_robot

EFFECTS = ("payload", "ground_friction", "viscous_damping", "dry_friction", "actuator_gain", "actuator_delay")
RATE = 200
"""Samples per second."""
ANGLE, SPEED, TORQUE = 1e-3, 0.05, 0.05
"""Noise of encoders [rad], [rad/s] and of reported torques [N m]."""
POSE = (1e-3, 2e-3, 2e-2, 3e-2)
"""Noise of a measured base: position [m], rotation [rad], velocity [m/s], angular velocity [rad/s]."""
NULLS = 3
"""Nulls of each generator."""


@dataclass(frozen=True)
class Walk:
    """A recording without noise: K samples, and (2 K + 1,) rows of states at these and at half samples around them."""

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    torque: np.ndarray


def demo_walks(rng: np.random.Generator, effect: str | None) -> tuple[str, list[Walk], list[dict[str, Any]]]:
    """Walks of the quadruped of `hidden_cases` (12 of 2.5 s): its MJCF, the walks, and what is hidden."""
    robot = replace(case_robot("quadruped"), duration=2.5)
    motions = [robot.draw_motion(rng) for _ in range(12)]
    draw = Draw(robot, rng, motions, peak_loads(robot, motions[:3]), False)
    reality, missing, _ = draw_reality(draw, "effect" if effect else "none", [effect] if effect else 1, None, 1.0)
    walks = []
    for motion in motions:
        row = simulate_reality(reality, motion, robot.duration, 2 * RATE)
        count = (len(row["time"]) - 1) // 2
        keep, at = slice(0, 2 * count + 1), slice(1, 2 * count, 2)
        walks.append(
            Walk(row["time"][at], row["qpos"][keep], row["qvel"][keep], motion(row["time"][at]), row["force"][at])
        )
    hidden = [{"effect": m.effect, "location": m.location, "parameters": dict(m.parameters)} for m in missing]
    return with_imu(robot.xml, '<freejoint name="root"/>'[:-2]), walks, hidden


def field_walks(rng: np.random.Generator, effect: str | None) -> tuple[str, list[Walk], list[dict[str, Any]]]:
    """Walks of the quadruped of `field_robots` (5 of 6 s): its MJCF, the walks, and what is hidden."""
    robot = ROBOTS["legged"](rng)
    model = mujoco.MjModel.from_xml_string(robot.xml)
    calibration = draw_calibration(rng, model, 0.5 / RATE)
    times = np.arange(-round(SETTLE / robot.step), round(6.0 / robot.step)) * robot.step
    controls = [Controlled(robot, robot.reference(rng)(times)) for _ in range(5)]
    hidden = [_field_effect(rng, model, calibration, controls[0], effect)] if effect else []
    slippery = [one for one in hidden if one["effect"] == "ground_friction"]
    machine = build(robot, calibration, [one for one in hidden if one not in slippery])
    for one in slippery:
        machine.model.geom_friction[:, 0] = one["parameters"]["coefficient"]
    half, walks = round(0.5 / RATE / robot.step), []
    for control in controls:
        motion = move(machine, control)
        rows = np.arange(0, len(motion.time), half)
        rows = rows[: len(rows) - (len(rows) + 1) % 2]
        at = rows[1::2]
        joints = [int(model.jnt_dofadr[model.actuator_trnid[a, 0]]) for a in range(model.nu)]
        walks.append(
            Walk(
                motion.time[at], motion.qpos[rows], motion.qvel[rows], motion.commands[at], motion.torque[at][:, joints]
            )
        )
    return with_imu(robot.xml, '<freejoint name="base"/>'[:-2]), walks, hidden


def _field_effect(
    rng: np.random.Generator, model: mujoco.MjModel, calibration: Calibration, control: Controlled, name: str
) -> dict[str, Any]:
    """An effect with a size that matters."""
    usual = usual_sizes(model, move(build(control.robot, calibration), control))
    motor = int(rng.integers(model.nu))
    joint, dof = model.joint(int(model.actuator_trnid[motor, 0])), int(model.jnt_dofadr[model.actuator_trnid[motor, 0]])
    load = {"mass": float(rng.uniform(0.1, 0.3) * model.body_mass[1])}
    load |= dict(zip("xyz", rng.uniform(-0.06, 0.06, 3).tolist(), strict=True))
    location, parameters = {
        "payload": ("body:hull", load),
        "ground_friction": ("world", {"coefficient": 0.8 * float(rng.uniform(0.4, 0.75))}),
        "viscous_damping": (
            f"joint:{joint.name}",
            {"damping": rng.uniform(0.15, 0.5) * usual.torque[dof] / usual.speed[dof]},
        ),
        "dry_friction": (f"joint:{joint.name}", {"torque": rng.uniform(0.1, 0.3) * usual.torque[dof]}),
        "actuator_gain": (f"actuator:{model.actuator(motor).name}", {"change": rng.uniform(-0.35, -0.12)}),
        "actuator_delay": ("all", {"delay": round(float(rng.uniform(0.012, 0.03)), 4)}),
    }[name]
    return {"effect": name, "location": location, "parameters": {k: float(v) for k, v in parameters.items()}}


def make_walks(folder: Path, seed: int, index: int, sensors: str, fault: str) -> dict[str, Any]:
    """Write the folder of a case.

    Args:
      folder: gets model.xml, dataset.toml and walks.
      seed: of everything random.
      index: number of the case: twelve with an effect, then six with none, and so on.
      sensors: what is measured of the base: "imu", or "pose" beside it, of the same robots and motions.
      fault: of `imu.FAULTS`, or "none".

    Returns:
      The truth.
    """
    kinds = list(cases())
    generator, effect = kinds[index % len(kinds)]
    rng = np.random.default_rng((seed, index))
    xml, walks, hidden = (demo_walks if generator == "demo" else field_walks)(rng, effect)
    model = mujoco.MjModel.from_xml_string(xml)
    mount, constant, gravity = Mount.drawn(rng), 1 + 0.04 * rng.standard_normal(model.nu), model.opt.gravity
    joints = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    names, base = tuple(model.joint(j).name for j in joints), model.joint(0).name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(xml)
    files = ""
    for number, walk in enumerate(walks):
        qpos, qvel, count = walk.qpos[1::2], walk.qvel[1::2], len(walk.time)
        columns = {"time": walk.time}
        columns |= {f"ctrl/{model.actuator(a).name}": walk.ctrl[:, a] for a in range(model.nu)}
        for j, name in zip(joints, names, strict=True):
            q, v = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
            columns[f"qpos/{name}"] = qpos[:, q] + ANGLE * rng.standard_normal(count)
            columns[f"qvel/{name}"] = qvel[:, v] + SPEED * rng.standard_normal(count)
        torque = constant * walk.torque + TORQUE * rng.standard_normal(walk.torque.shape)
        columns |= {f"force/{model.actuator(a).name}": torque[:, a] for a in range(model.nu)}
        half = 0.5 / RATE
        between = np.append(walk.time - half, walk.time[-1] + half)
        columns |= imu_columns(between, walk.qpos, walk.qvel, gravity, mount, rng)
        # Drawn whether it is written or not, so that both kinds of logs have the same noise.
        errors = np.zeros((count, model.nv))
        errors[:, :6] = np.repeat(POSE[:2], 3) * rng.standard_normal((count, 6))
        posed = integrate(model, qpos, errors)[:, :7]
        speed = qvel[:, :6] + np.repeat(POSE[2:], 3) * rng.standard_normal((count, 6))
        if sensors == "pose":
            columns |= {f"qpos/{base}/{n}": posed[:, i] for i, n in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz"))}
            columns |= {f"qvel/{base}/{n}": speed[:, i] for i, n in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))}
        with_fault(columns, fault, names, np.random.default_rng((seed, index, number)))
        write_arrays(folder / f"walk_{number:02d}.npz", columns)
        files += f'\n[[recording]]\nfile = "walk_{number:02d}.npz"\n'
    text = f'[model]\nfile = "model.xml"\n\n[control]\ninterpolation = "cubic"\n{files}'
    (folder / "dataset.toml").write_text(text)
    return {"robot": generator, "effects": hidden, "faults": [fault], "constant": constant.tolist()}


def cases() -> Iterator[tuple[str, str | None]]:
    """Generator and effect of each case; None where nothing is missing."""
    for effect in (*EFFECTS, *[None] * NULLS):
        for generator in ("demo", "field"):
            yield generator, effect
