"""Simulation of a hidden reality by a loop over `mj_step`, and the peak loads of a robot's motions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.demo import MotionCommand
from hidden_cases.physics import HiddenReality
from hidden_cases.robots import CaseRobot

_TIMESTEP = 1e-4
"""Time step of reality [s]."""


@dataclass(frozen=True)
class Loads:
    """Peak loads by joint, the units in which sizes of effects are drawn.

    Attributes:
      torque, speed, acceleration, travel: peaks (98th percentile of the absolute value) of the motor's torque [N m],
        the joint's speed [rad/s], acceleration [rad/s^2] and distance from its mean angle [rad], by joint.
    """

    torque: Mapping[str, float]
    speed: Mapping[str, float]
    acceleration: Mapping[str, float]
    travel: Mapping[str, float]


def peak_loads(robot: CaseRobot, motions: Sequence[MotionCommand], start: "Restart | None" = None) -> Loads:
    """Peak loads of the believed robot.

    Args:
      robot: the robot.
      motions: commands that are simulated, each for the duration of a recording.
      start: states in which it starts; None for the model's own.

    Returns:
      The loads by joint.
    """
    model = robot.model
    real = HiddenReality.of(robot)
    rows = [simulate_reality(real, motion, robot.duration, 500.0, 5e-4, start) for motion in motions]
    qvel = np.concatenate([row["qvel"] for row in rows])
    force = np.concatenate([row["force"] for row in rows])
    rate = np.concatenate([np.gradient(row["qvel"], row["time"], axis=0) for row in rows])

    def peak(values: np.ndarray) -> float:
        return float(np.percentile(np.abs(values), 98)) + 1e-9

    torque, speed, acceleration, travel = {}, {}, {}, {}
    for i in range(model.nu):
        joint = model.joint(int(model.actuator_trnid[i, 0]))
        dof, adr = int(joint.dofadr[0]), int(joint.qposadr[0])
        angle = np.concatenate([row["qpos"][:, adr] - row["qpos"][:, adr].mean() for row in rows])
        torque[joint.name], speed[joint.name] = peak(force[:, i]), peak(qvel[:, dof])
        acceleration[joint.name], travel[joint.name] = peak(rate[:, dof]), peak(angle)
    return Loads(torque, speed, acceleration, travel)


@dataclass(frozen=True)
class Restart:
    """States to which a simulation is reset at regular intervals.

    Attributes:
      rows: samples of another reality, from `simulate_reality`.
      samples: number of samples between two resets.
    """

    rows: Mapping[str, np.ndarray]
    samples: int


def simulate_reality(
    reality: HiddenReality,
    motion: MotionCommand,
    duration: float,
    rate: float,
    timestep: float = _TIMESTEP,
    restart: Restart | None = None,
) -> dict[str, np.ndarray]:
    """Run a reality and sample it.

    Args:
      reality: the reality.
      motion: the command.
      duration: duration of the simulation [s].
      rate: samples per second.
      timestep: time step of the simulation [s]; the integrator is `implicit`.
      restart: states to which the simulation is reset; None for none.

    Returns:
      time (K,), qpos (K, nq) and qvel (K, nv) as encoders without noise measure them, for the believed robot's joints;
      force (K, nu) and act (K, na) of the actuators.
    """
    spec = reality.spec.copy()
    spec.option.timestep, spec.option.integrator = timestep, mujoco.mjtIntegrator.mjINT_IMPLICIT
    model, believed = spec.compile(), reality.robot.model
    data = mujoco.MjData(model)
    places = _addresses(model, believed)
    if reality.robot.base is not None:
        _place_on_ground(model, data, believed)
    steps, every = round(duration / timestep), max(1, round(1 / rate / timestep))
    commands = _delayed_commands(reality, motion, steps, timestep)
    commands -= np.array([reality.offset.get(a.target, 0.0) for a in reality.spec.actuators])
    rows: dict[str, list[np.ndarray]] = {"time": [], "qpos": [], "qvel": [], "force": [], "act": []}
    frictionloss = model.dof_frictionloss.copy()
    mujoco.mj_forward(model, data)
    for k in range(steps + 1):
        if restart is not None and k % (every * restart.samples) == 0:
            row = k // every
            data.qpos[places[0]], data.qvel[places[1]] = restart.rows["qpos"][row], restart.rows["qvel"][row]
            data.act[:] = restart.rows["act"][row]
            for name, angle in reality.offset.items():
                data.joint(name).qpos[0] -= angle
        if k % every == 0:
            rows["time"].append(np.array(k * timestep))
            rows["qpos"].append(data.qpos[places[0]])
            rows["qvel"].append(data.qvel[places[1]])
            rows["force"].append(data.actuator_force.copy())
            rows["act"].append(data.act.copy())
        if k == steps:
            break
        data.ctrl[:] = commands[k]
        data.qfrc_applied[:], data.xfrc_applied[:], model.dof_frictionloss[:] = 0.0, 0.0, frictionloss
        for hook in reality.hooks:
            hook(model, data)
        mujoco.mj_step(model, data)
    out = {name: np.array(values) for name, values in rows.items()}
    for name, angle in reality.offset.items():
        out["qpos"][:, believed.joint(name).qposadr[0]] += angle
    return out


def _addresses(model: mujoco.MjModel, believed: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Addresses of the believed robot's coordinates in qpos and qvel of a model that may have more joints."""
    positions: list[int] = []
    velocities: list[int] = []
    width = {mujoco.mjtJoint.mjJNT_FREE: (7, 6), mujoco.mjtJoint.mjJNT_BALL: (4, 3)}
    for i in range(believed.njnt):
        joint = model.joint(believed.joint(i).name)
        nq, nv = width.get(mujoco.mjtJoint(int(joint.type[0])), (1, 1))
        positions += range(joint.qposadr[0], joint.qposadr[0] + nq)
        velocities += range(joint.dofadr[0], joint.dofadr[0] + nv)
    return np.array(positions), np.array(velocities)


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Height of the lowest colliding sphere."""
    mujoco.mj_kinematics(model, data)
    heights = [
        data.geom_xpos[i, 2] - model.geom_size[i, 0]
        for i in range(model.ngeom)
        if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_SPHERE and model.geom_conaffinity[i]
    ]
    return float(min(heights))


def _place_on_ground(model: mujoco.MjModel, data: mujoco.MjData, believed: mujoco.MjModel) -> None:
    """Set the initial height so that the clearance to the ground is that of the believed robot."""
    clearance = _lowest(believed, mujoco.MjData(believed))
    data.qpos[2] -= _lowest(model, data) - clearance


def _delayed_commands(reality: HiddenReality, motion: MotionCommand, steps: int, timestep: float) -> np.ndarray:
    """Commands (steps, nu) at the start of each step, after delay and lag; constant before the start.

    Semi-implicit Euler is of second order with the command at the start of a step, see `command_phase`.
    """
    times = np.arange(steps) * timestep
    commands = motion(times)
    for i in np.flatnonzero(reality.delay):
        commands[:, i] = motion(np.maximum(times - reality.delay[i], 0.0))[:, i]
    for i in np.flatnonzero(reality.lag):
        # First-order lag, exact for a command that is linear between two steps, from a state of rest.
        constant = float(reality.lag[i])
        last = state = float(motion(np.zeros(1))[0, i])
        for k in range(1, steps):
            command = float(commands[k, i])
            ramp = constant * (command - last) / timestep
            state = command - ramp + (state - last + ramp) * np.exp(-timestep / constant)
            last, commands[k, i] = command, state
    return commands
