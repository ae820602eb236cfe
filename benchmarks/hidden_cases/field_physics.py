"""The real robots of `field_cases.py`: plain MuJoCo at fine steps, with hidden effects added before every step.

Damping, springs, friction, offsets and ripple are forces in `qfrc_applied`; delay, lag, rate limit and dead band act
on `ctrl`. Only what changes inertia or an actuator's strength is a number of the model. Dry friction is a bristle: a
spring with a damper, many times stiffer than anything else, that slips at the friction torque.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from hidden_cases.field_laws import HiddenForce, hidden_force
from hidden_cases.field_robots import FieldRobot

SETTLE = 0.5
"""Time before the first sample, in which the robot takes its first posture [s]."""
_BRISTLE = 0.2
"""Natural frequency of a bristle times the time step."""
Hidden = Sequence[Mapping[str, Any]]
"""Effects: name, location and parameters as `btr_mjx.gap.effects` calls them; `ripple`, which it does not know; `law`,
of `field_laws`."""


@dataclass(frozen=True)
class Calibration:
    """By how much a real robot differs from a good model.

    Attributes:
      damping: (nv,) factors.
      gains: (n_actuators,) factors.
      masses: (nbody,) factors of mass and inertia.
      zeros: (nv,) what the encoders of hinges and slides read at zero [rad, m].
      shift: time from a command's time stamp to its action [s].
      ground: factor of the friction of the ground.
    """

    damping: np.ndarray
    gains: np.ndarray
    masses: np.ndarray
    zeros: np.ndarray
    shift: float = 0.0
    ground: float = 1.0

    @classmethod
    def perfect(cls, model: mujoco.MjModel) -> "Calibration":
        """That of a robot that is as its model."""
        return cls(np.ones(model.nv), np.ones(model.nactuator), np.ones(model.nbody), np.zeros(model.nv))


def draw_calibration(rng: np.random.Generator, model: mujoco.MjModel, interval: float) -> Calibration:
    """Errors of a good calibration: damping 10 %, gains 2 %, masses 1 to 2 %, zeros 0.5 to 2 mrad (0.1 to 0.4 mm)."""
    zeros = np.zeros(model.nv)
    for joint in _scalar_joints(model):
        slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        zeros[model.jnt_dofadr[joint]] = rng.choice([-1, 1]) * rng.uniform(5e-4, 2e-3) * (0.2 if slide else 1.0)
    return Calibration(
        1 + 0.1 * rng.standard_normal(model.nv).clip(-2, 2),
        1 + 0.02 * rng.standard_normal(model.nactuator).clip(-2, 2),
        1 + 0.015 * rng.standard_normal(model.nbody).clip(-2, 2),
        zeros,
        float(rng.uniform(0, interval)),
        1 + 0.03 * float(rng.standard_normal()),
    )


def _scalar_joints(model: mujoco.MjModel) -> list[int]:
    return [j for j in range(model.njnt) if model.jnt_type[j] >= int(mujoco.mjtJoint.mjJNT_SLIDE)]


def dofs_at(model: mujoco.MjModel, location: str) -> list[int]:
    """Degrees of freedom of hinges and slides at `all`, `joint:NAME` or `actuator:NAME`."""
    kind, _, name = location.partition(":")
    if kind == "all":
        return [int(model.jnt_dofadr[j]) for j in _scalar_joints(model)]
    joint = model.joint(name).id if kind == "joint" else int(model.actuator_trnid[model.actuator(name).id, 0])
    return [int(model.jnt_dofadr[joint])]


def actuators_at(model: mujoco.MjModel, location: str) -> list[int]:
    """Actuators at `all` or `actuator:NAME`."""
    kind, _, name = location.partition(":")
    return list(range(model.nactuator)) if kind == "all" else [model.actuator(name).id]


@dataclass
class Law:
    """What is added before every step: sizes by degree of freedom or by actuator; without effect, zero or infinite."""

    damping: np.ndarray
    spring: np.ndarray
    offset: np.ndarray
    dry: np.ndarray
    load: np.ndarray
    ripple: np.ndarray
    waves: np.ndarray
    delay: np.ndarray
    lag: np.ndarray
    rate: np.ndarray
    play: np.ndarray
    forces: list[HiddenForce]
    frictions: list[HiddenForce]

    @classmethod
    def nothing(cls, nv: int, nu: int) -> "Law":
        """Nothing is added to a robot of nv degrees of freedom and nu actuators."""
        by_dof = {name: np.zeros(nv) for name in ("damping", "spring", "offset", "dry", "load", "ripple", "waves")}
        by_motor = {name: np.zeros(nu) for name in ("delay", "lag", "play")}
        return cls(**by_dof, **by_motor, rate=np.full(nu, np.inf), forces=[], frictions=[])


@dataclass
class Machine:
    """A real robot.

    Attributes:
      model: with the fine step, calibration errors, and hidden inertia and strength.
      law: the other hidden effects.
      calibration: zeros of encoders and shift of commands are used while it moves.
      servo_dofs: degree of freedom of every actuator that is a position servo of a joint, else -1.
    """

    model: mujoco.MjModel
    law: Law
    calibration: Calibration
    servo_dofs: np.ndarray


def build(robot: FieldRobot, calibration: Calibration, hidden: Hidden = ()) -> Machine:
    """A real robot from the believed one."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    for effect in hidden:
        if effect["effect"] == "payload":
            place = [effect["parameters"][axis] for axis in "xyz"]
            load = spec.body(effect["location"].partition(":")[2]).add_body(name="load", pos=place)
            load.mass, load.inertia, load.explicitinertial = effect["parameters"]["mass"], [1e-9] * 3, True
            load.ipos = [0.0, 0.0, 0.0]  # else MuJoCo takes `pos` again, and the load is twice as far out
    model = spec.compile()
    model.opt.timestep = robot.step
    known = len(calibration.masses)
    names = [mujoco.MjModel.from_xml_string(robot.xml).body(b).name for b in range(known)]
    for name, factor in zip(names, calibration.masses, strict=True):
        body = model.body(name).id
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    model.dof_damping[:] *= calibration.damping
    model.actuator_gainprm[:] *= calibration.gains[:, None]
    model.actuator_biasprm[:] *= calibration.gains[:, None]
    model.geom_friction[:, 0] *= calibration.ground
    nv, nu = model.nv, model.nu
    law = Law.nothing(nv, nu)
    for effect in hidden:
        _hide(model, law, effect)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    servo = [robot.servos and model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT for a in range(nu)]
    driven = [int(model.jnt_dofadr[model.actuator_trnid[a, 0]]) if servo[a] else -1 for a in range(nu)]
    return Machine(model, law, calibration, np.array(driven))


def _hide(model: mujoco.MjModel, law: Law, effect: Mapping[str, Any]) -> None:
    name, place = effect["effect"], effect["location"]
    value = float(next(iter(effect["parameters"].values()), 0.0))
    by_dof = {
        "viscous_damping": law.damping,
        "joint_stiffness": law.spring,
        "offset_torque": law.offset,
        "dry_friction": law.dry,
        "load_friction": law.load,
        "ripple": law.ripple,
        "armature": model.dof_armature,
    }
    if name in by_dof:
        by_dof[name][dofs_at(model, place)] += value
    if name == "ripple":
        law.waves[dofs_at(model, place)] = effect["parameters"]["waves"]
    by_actuator = {"actuator_delay": law.delay, "actuator_lag": law.lag, "command_rate_limit": law.rate}
    if name in by_actuator:
        by_actuator[name][actuators_at(model, place)] = value
    if name == "backlash":
        driven = dofs_at(model, place)
        law.play[[a for a in range(model.nu) if int(model.jnt_dofadr[model.actuator_trnid[a, 0]]) in driven]] = value
    if name == "law":
        force, is_friction = hidden_force(effect, model)
        (law.frictions if is_friction else law.forces).append(force)
    if name == "actuator_gain":
        own = actuators_at(model, place)
        model.actuator_gainprm[own] *= 1 + value
        model.actuator_biasprm[own] *= 1 + value
    if name == "torque_limit":
        own = actuators_at(model, place)
        model.actuator_forcelimited[own], model.actuator_forcerange[own] = 1, (-value, value)


@dataclass(frozen=True)
class Motion:
    """What happened, at every fine step from the first sample on.

    Attributes:
      time: (K,) [s].
      qpos: (K, nq) what encoders read.
      qvel: (K, nv).
      commands: (K, nu) the last commands that were computed.
      torque: (K, nv) forces of the actuators.
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    commands: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Controlled:
    """How a robot is commanded.

    Attributes:
      robot: its controller, if its motors take torques.
      reference: (K, n) at every fine step, from `-SETTLE` on.
      every: fine steps from one command to the next; 1 for commands without steps.
      start: (nq,) configuration before it moves; empty for that of the model.
      ahead: fine steps from a command to the first sample after it.
    """

    robot: FieldRobot
    reference: np.ndarray
    every: int = 1
    start: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ahead: int = 0


def move(machine: Machine, control: Controlled) -> Motion:
    """Simulate a real robot.

    Args:
      machine: the robot.
      control: its commands.

    Returns:
      The motion, without the time in which the robot takes its first posture.
    """
    model, law, zeros = machine.model, machine.law, machine.calibration.zeros
    data, dt = mujoco.MjData(model), model.opt.timestep
    count, nu, settle = len(control.reference), model.nu, round(SETTLE / dt)
    scalar = [(int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])) for j in _scalar_joints(model)]
    q, v = np.array([s[0] for s in scalar], int), np.array([s[1] for s in scalar], int)
    servos = np.flatnonzero(machine.servo_dofs >= 0)
    servo_q = q[[v.tolist().index(d) for d in machine.servo_dofs[servos]]] if len(servos) else servos
    servo_zero = zeros[machine.servo_dofs[servos]]
    if len(control.start):
        data.qpos[:] = control.start
    issued = np.zeros((count, nu))
    if control.robot.controller is None:
        held = np.arange(count) - (np.arange(count) - settle + control.ahead) % control.every
        issued[:] = control.reference[np.maximum(held, 0)]
    late = np.round((machine.calibration.shift + law.delay) / dt).astype(int)
    lag = np.where(law.lag > 0, 1 - np.exp(-dt / np.maximum(law.lag, 1e-12)), 1.0)
    bristle, slips = np.zeros(len(v)), bool((law.dry + law.load).any() or law.frictions)
    stiff = _BRISTLE**2 / dt**2 / model.dof_invweight0[v]
    damp = 1.4 * _BRISTLE / dt / model.dof_invweight0[v]
    pushes = bool(law.damping.any() or law.spring.any() or law.offset.any() or law.ripple.any() or slips or law.forces)
    drive, plays = np.empty(0), bool(law.play.any())
    out = tuple(np.zeros((count - settle, n)) for n in (model.nq, model.nv, model.nv))
    columns = np.arange(nu)
    for i in range(count):
        if control.robot.controller is not None and (i - settle + control.ahead) % control.every == 0:
            seen = data.qpos.copy()
            seen[q] += zeros[v]
            issued[i : i + control.every] = control.robot.controller(control.reference[i], seen, data.qvel)
        command = issued[np.maximum(i - late, 0), columns]
        drive = command if not len(drive) else drive + np.clip(lag * (command - drive), -law.rate * dt, law.rate * dt)
        data.ctrl[:] = drive
        if len(servos):
            data.ctrl[servos] -= servo_zero
            if plays:
                error = data.ctrl[servos] - data.qpos[servo_q]
                data.ctrl[servos] -= np.clip(error, -law.play[servos], law.play[servos])
        if pushes:
            speed, place = data.qvel[v], data.qpos[q]
            force = law.offset[v] - law.damping[v] * speed - law.spring[v] * place
            force += law.ripple[v] * np.sin(law.waves[v] * place)
            if law.forces or law.frictions:
                where, rate, now = np.zeros(model.nv), data.qvel.copy(), (i - settle) * dt
                where[v] = place
            for added in law.forces:
                force += added(where, rate, now)[v]
            if slips:
                most = law.dry[v] + law.load[v] * np.abs(data.qfrc_actuator[v])
                for added in law.frictions:
                    most += added(where, rate, now)[v]
                bristle += speed * dt
                pull = np.clip(stiff * bristle + damp * speed, -most, most)
                bristle = (pull - damp * speed) / stiff
                force -= pull
            data.qfrc_applied[v] = force
        if i >= settle:
            out[0][i - settle], out[1][i - settle], out[2][i - settle] = data.qpos, data.qvel, data.qfrc_actuator
            out[0][i - settle, q] += zeros[v]
        mujoco.mj_step(model, data)
    if not np.isfinite(out[0]).all():
        raise FloatingPointError("the simulated robot diverged")
    return Motion(np.arange(count - settle) * dt, out[0], out[1], issued[settle:], out[2])
