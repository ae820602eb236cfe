"""Cases that resemble what users bring: folders with `model.xml` and logs of a real robot, and what is hidden in it.

    make_case(folder, seed, "arm", Wanted(effects=0))        # writes the folder, returns the truth

The robots are those of `field_robots`, their physics that of `field_physics`: another simulation than the one that is
searched, with errors of calibration everywhere, and with the faults that logs have.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hidden_cases.field_laws import draw_law
from hidden_cases.field_physics import SETTLE, Calibration, Controlled, Hidden, Motion, build, draw_calibration, move
from hidden_cases.field_robots import ROBOTS, FieldRobot

FAULTS = ("jitter", "coarse", "held", "lowpass", "late", "lost")
"""Faults of data: time stamps that come late by 0.8 ms on average, encoders of 5 mrad (1 mm), commands that a
controller holds between rows, velocities behind a filter, commands that are logged late, missing rows."""
FRESH = "fresh.npz"
"""Where states of another motion are kept, beside the folder of a case that hides a law."""
RUNS, DURATION = 3, 6.0
"""Recordings of a case, and their length [s]."""
JOINT_EFFECTS = ("dry_friction", "viscous_damping", "armature", "joint_stiffness", "load_friction", "ripple")
MOTOR_EFFECTS = ("actuator_gain", "actuator_lag", "actuator_delay", "torque_limit", "offset_torque", "payload")


@dataclass(frozen=True)
class Wanted:
    """What a case is to hold; None for what is drawn.

    Attributes:
      effects: number of hidden effects, 0 to 3.
      faults: names of `FAULTS`.
      law: kind of `field_laws.LAWS`, which is all that is hidden.
    """

    effects: int | None = None
    faults: tuple[str, ...] | None = None
    law: str | None = None


@dataclass(frozen=True)
class UsualSizes:
    """Usual sizes of a robot in motion: (nv,) torque, speed, reach and inertia, (n_actuators,) force, command rate."""

    torque: np.ndarray
    speed: np.ndarray
    reach: np.ndarray
    inertia: np.ndarray
    force: np.ndarray
    rate: np.ndarray


def usual_sizes(model: mujoco.MjModel, motion: Motion) -> UsualSizes:
    """Usual sizes of a robot in a motion."""
    speed, torque = np.percentile(np.abs(motion.qvel), 95, axis=0), np.percentile(np.abs(motion.torque), 95, axis=0)
    reach = np.zeros(model.nv)
    for j in range(model.njnt):
        if model.jnt_type[j] >= int(mujoco.mjtJoint.mjJNT_SLIDE):
            reach[model.jnt_dofadr[j]] = 0.5 * np.ptp(motion.qpos[:, model.jnt_qposadr[j]])
    steps = round(0.02 / float(motion.time[1]))  # longer than any command is held
    apart = np.abs(motion.commands[steps:] - motion.commands[:-steps]) / (steps * motion.time[1])
    joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    dof = model.jnt_dofadr[np.where(joints, model.actuator_trnid[:, 0], 0)]
    force = np.where(joints, torque[dof], np.percentile(np.abs(motion.commands), 95, axis=0))
    return UsualSizes(torque, speed, reach, model.dof_M0.copy(), force, np.percentile(apart, 98, axis=0))


def _draw_effect(
    rng: np.random.Generator, robot: FieldRobot, model: mujoco.MjModel, usual: UsualSizes, name: str
) -> dict[str, Any]:
    """One hidden effect with a size that matters, as a part of what is usual."""
    a = int(rng.integers(model.nactuator))
    if robot.name == "arm":
        a = int(rng.integers(min(model.nactuator, 4)))
    motor = model.actuator(a).name
    jointed = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
    dof = int(model.jnt_dofadr[model.actuator_trnid[a, 0]]) if jointed else 0
    torque, speed, reach = usual.torque[dof], usual.speed[dof], usual.reach[dof]
    where = "all" if rng.random() < 0.6 else f"actuator:{motor}"
    own = {
        "dry_friction": (0.1, 0.3, "torque", torque),
        "viscous_damping": (0.15, 0.5, "damping", torque / max(speed, 1e-9)),
        "armature": (0.3, 1.0, "armature", usual.inertia[dof]),
        "joint_stiffness": (0.15, 0.5, "stiffness", torque / max(reach, 1e-9)),
        "load_friction": (0.1, 0.3, "coefficient", 1.0),
        "ripple": (0.15, 0.35, "torque", torque),
        "offset_torque": (0.1, 0.3, "torque", torque * rng.choice([-1, 1])),
        "backlash": (0.05, 0.15, "play", reach),
    }
    if name in own:
        low, high, parameter, scale = own[name]
        more = {"waves": float(rng.integers(7, 20) / max(reach, 1e-3) * 0.3)} if name == "ripple" else {}
        joint = f"joint:{model.joint(int(model.actuator_trnid[a, 0])).name}"
        return {"effect": name, "location": joint, "parameters": {parameter: rng.uniform(low, high) * scale, **more}}
    if name in ("actuator_delay", "actuator_lag"):
        parameter = "delay" if name == "actuator_delay" else "time_constant"
        return {"effect": name, "location": where, "parameters": {parameter: round(float(rng.uniform(0.012, 0.04)), 4)}}
    if name == "payload":
        return _payload(rng, robot, model)
    low, high, parameter, scale = {
        "actuator_gain": (-0.35, -0.12, "change", 1.0),
        "torque_limit": (0.45, 0.75, "limit", usual.force[a]),
        "command_rate_limit": (0.4, 0.7, "limit", usual.rate[a]),
    }[name]
    value = float(rng.uniform(low, high) * scale)
    return {"effect": name, "location": f"actuator:{motor}", "parameters": {parameter: value}}


def _payload(rng: np.random.Generator, robot: FieldRobot, model: mujoco.MjModel) -> dict[str, Any]:
    """A mass at the far end of the last link, or near the middle of a free body."""
    free = robot.name in ("drone", "legged")
    body = 1 if free else model.nbody - 1
    share, mass = rng.uniform(0.15, 0.5), float(model.body_mass[body])
    if free:
        place = rng.uniform(-0.06, 0.06, 3)
    else:
        geom = int(model.body_geomadr[body] + model.body_geomnum[body] - 1)
        place = model.geom_pos[geom] * (1.0 if robot.name in ("pendulum", "gantry") else 1.7)
    parameters = {"mass": share * mass, **dict(zip("xyz", place.tolist(), strict=True))}
    return {"effect": "payload", "location": f"body:{model.body(body).name}", "parameters": parameters}


def possible_effects(robot: FieldRobot) -> tuple[str, ...]:
    """Names of the effects that a robot may hide."""
    if robot.name == "drone":
        return ("actuator_gain", "actuator_lag", "actuator_delay", "payload")
    more = ("backlash", "command_rate_limit") if robot.servos else ()
    return (*JOINT_EFFECTS, *MOTOR_EFFECTS, *more)


def _draw_hidden(
    rng: np.random.Generator, robot: FieldRobot, model: mujoco.MjModel, usual: UsualSizes, count: int
) -> list[dict[str, Any]]:
    """Effects of different kinds, not two that act on time alike."""
    names = list[str]()
    for name in rng.permutation(possible_effects(robot)).tolist():
        alike = {"actuator_delay", "actuator_lag", "command_rate_limit"}
        if len(names) < count and not (name in alike and alike & set(names)):
            names.append(name)
    return [_draw_effect(rng, robot, model, usual, name) for name in names]


@dataclass(frozen=True)
class Logging:
    """How a robot is logged."""

    interval: float
    faults: tuple[str, ...]
    velocities: bool
    filter: float
    late: int
    noise: tuple[float, float, float]


def log_rows(rng: np.random.Generator, robot: FieldRobot, model: mujoco.MjModel, motion: Motion, log: Logging) -> str:
    """A log as text."""
    dt = float(motion.time[1])
    every = round(log.interval / dt)
    at = np.arange(0, len(motion.time), every)
    qpos, qvel = motion.qpos[at].copy(), motion.qvel
    if "lowpass" in log.faults:
        qvel, part = qvel.copy(), 1 - np.exp(-dt / log.filter)
        for i in range(1, len(qvel)):
            qvel[i] = qvel[i - 1] + part * (motion.qvel[i] - qvel[i - 1])
    qvel, columns = qvel[at], {"time": motion.time[at].copy()}
    speeds = dict[str, np.ndarray]()
    for j in range(model.njnt):
        q, v, name = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]), model.joint(j).name
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            shift = log.noise[1] * rng.standard_normal((len(at), 3))
            turned = qpos[:, q + 3 : q + 7] + 0.5 * log.noise[2] * rng.standard_normal((len(at), 4))
            turned /= np.linalg.norm(turned, axis=1, keepdims=True)
            for k, part_name in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz")):
                columns[f"{name}_{part_name}"] = qpos[:, q + k] + shift[:, k] if k < 3 else turned[:, k - 3]
            for k, part_name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz")):
                speeds[f"{name}_{part_name}"] = qvel[:, v + k] + 0.01 * rng.standard_normal(len(at))
            continue
        slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
        column = qpos[:, q] + log.noise[0] * rng.standard_normal(len(at))
        if "coarse" in log.faults:
            grain = 1e-3 if slide else 5e-3
            column = np.round(qpos[:, q] / grain) * grain
        columns[f"q_{name}"] = column
        noise = (2e-3 if slide else 1e-2) * rng.standard_normal(len(at))
        speeds[f"dq_{name}"] = qvel[:, v] + noise
    if log.velocities:
        columns |= speeds
    late = np.maximum(at - log.late * every, 0)
    for a in range(model.nu):
        columns[f"cmd_{model.actuator(a).name}"] = motion.commands[late, a]
    kept = np.ones(len(at), bool)
    if "jitter" in log.faults:
        columns["time"] += rng.exponential(8e-4, len(at)) + 4e-3 * (rng.random(len(at)) < 0.01)
        for k in range(1, len(at)):  # the next stamp waits for a late one
            columns["time"][k] = max(columns["time"][k], columns["time"][k - 1] + 5e-5)
    if "lost" in log.faults:
        kept[rng.random(len(at)) < 0.01] = False
        first = int(rng.integers(len(at) // 4, 3 * len(at) // 4))
        kept[first : first + int(rng.integers(4, 30))] = False
    table = np.stack(list(columns.values()), 1)[kept]
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in table)
    return f"{','.join(columns)}\n{rows}\n"


def make_case(folder: Path, seed: int, kind: str, wanted: Wanted | None = None) -> dict[str, Any]:
    """Write the folder of a case.

    Args:
      folder: gets model.xml, run1.csv, ..., and of some cases a dataset.toml.
      seed: of everything random.
      kind: a robot of `ROBOTS`.
      wanted: what the case is to hold.

    Returns:
      The truth: hidden effects, faults, and by how many noises each effect moves the first recording.
    """
    wanted = wanted or Wanted()
    rng = np.random.default_rng([seed, sorted(ROBOTS).index(kind)])
    robot = ROBOTS[kind](rng)
    model = mujoco.MjModel.from_xml_string(robot.xml)
    count = int(rng.choice([0, 1, 1, 2, 2, 3])) if wanted.effects is None else wanted.effects
    faults = tuple(f for f in FAULTS if rng.random() < 0.25) if wanted.faults is None else wanted.faults
    interval = 1 / float(rng.choice(robot.rates))
    velocities = bool(rng.random() < 0.5) or "lowpass" in faults
    log = Logging(
        interval,
        faults,
        velocities,
        float(rng.uniform(0.01, 0.03)),
        int(rng.integers(1, 4)) if "late" in faults else 0,
        robot.noise,
    )
    # A controller with feedback runs at a rate of its own, unless it is the one that writes the rows.
    every = round(interval / robot.step) if "held" in faults else 10 if robot.controller else 1
    calibration, ahead = draw_calibration(rng, model, 0.5 * interval), 0
    if "held" in faults and calibration.shift > 0.2 * interval:
        # Rows are written by another clock than that of the commands: the last command is up to one row old.
        ahead = round((calibration.shift / interval - 0.2) / 0.3 * every)
        calibration = replace(calibration, shift=0.0)
    times = np.arange(-round(SETTLE / robot.step), round(DURATION / robot.step)) * robot.step
    references = [robot.reference(rng)(times) for _ in range(RUNS)]
    commanded = [Controlled(robot, reference, every, ahead=ahead) for reference in references]
    usual = usual_sizes(model, _motion(robot, calibration, (), commanded[0]))
    if wanted.law is None:
        hidden = _draw_hidden(rng, robot, model, usual, count)
    else:
        hidden = [draw_law(rng, wanted.law, model, usual)]
    motions = [_motion(robot, calibration, hidden, one) for one in commanded]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(robot.xml)
    for k, motion in enumerate(motions):
        (folder / f"run{k + 1}.csv").write_text(log_rows(rng, robot, model, motion, log))
    described = bool(rng.random() < 0.3)
    if described:
        files = "".join(f'[[recording]]\nfile = "run{k + 1}.csv"\n' for k in range(RUNS))
        text = '[control]\ninterpolation = "hold"\n' if "held" in faults else ""
        (folder / "dataset.toml").write_text(f'[model]\nfile = "model.xml"\n{files}{text}')
    if wanted.law is not None:  # states drawn afresh, on which laws are compared
        fresh = Controlled(robot, robot.reference(rng)(times), every, ahead=ahead)
        new = _motion(robot, calibration, hidden, fresh)
        at = rng.choice(len(new.time), 400, replace=False)
        np.savez(
            folder.with_name(FRESH), time=new.time[at], qpos=new.qpos[at], qvel=new.qvel[at], torque=new.torque[at]
        )
    return {
        "robot": kind,
        "seed": seed,
        "effects": hidden,
        "visible": _visible(robot, calibration, hidden, commanded[0], motions[0], log),
        "faults": list(faults),
        "rate": 1 / interval,
        "velocities": velocities,
        "described": described,
        "late": log.late * interval,
        "shift": calibration.shift,
        "ahead": ahead * robot.step,
        "filter": log.filter if "lowpass" in faults else 0.0,
        "damping": (model.dof_damping * (calibration.damping - 1)).tolist(),
        "zeros": calibration.zeros.tolist(),
    }


def _motion(robot: FieldRobot, calibration: Calibration, hidden: Hidden, control: Controlled) -> Motion:
    return move(build(robot, calibration, hidden), control)


def _visible(
    robot: FieldRobot,
    calibration: Calibration,
    hidden: list[dict[str, Any]],
    control: Controlled,
    motion: Motion,
    log: Logging,
) -> list[float]:
    """How far positions are apart with and without each effect, beside the others: root mean square over noise."""
    out = []
    for effect in hidden:
        other = _motion(robot, calibration, [one for one in hidden if one is not effect], control)
        noise = 1.5e-3 if "coarse" in log.faults else log.noise[0]
        out.append(float(np.sqrt(np.mean((other.qpos - motion.qpos) ** 2)) / noise))
    return out
