"""What may be different in a hidden reality: edits of the MJCF, of the command, and forces between steps.

A second, plain route to the same physics as the library of effects: the MJCF is edited through MjSpec and compiled
anew, and what depends on the state is a hook that a loop over `mj_step` calls before every step of 1e-4 s. Sharing no
code, agreement between the two means something.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from btr_mjx.gap.hidden_robots import CaseRobot, Motion

TIMESTEP = 1e-4
"""[s]"""
Hook = Callable[[mujoco.MjModel, mujoco.MjData], None]


@dataclass
class Reality:
    """A reality under construction.

    Attributes:
      robot: the believed robot.
      spec: its MJCF, to be edited.
      hooks: called before every step, after the control was written.
      delay, lag: (nu,) of the command [s].
      offset: what the encoder of a joint adds to its true angle [rad], by joint.
    """

    robot: CaseRobot
    spec: mujoco.MjSpec
    hooks: list[Hook] = field(default_factory=list)
    delay: np.ndarray = field(default_factory=lambda: np.zeros(0))
    lag: np.ndarray = field(default_factory=lambda: np.zeros(0))
    offset: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, robot: CaseRobot) -> "Reality":
        """A reality that is as believed."""
        spec = mujoco.MjSpec.from_string(robot.xml)
        nu = len(spec.actuators)
        return cls(robot, spec, delay=np.zeros(nu), lag=np.zeros(nu))

    def actuators_of(self, joints: Sequence[str]) -> list[tuple[int, mujoco.MjsActuator]]:
        """Index and specification of the actuators that drive some joints."""
        return [(i, a) for i, a in enumerate(self.spec.actuators) if a.target in joints]


def viscous_damping(r: Reality, joints: Sequence[str], damping: float) -> None:
    """A torque -damping dq/dt [N m s/rad] more than believed."""
    for name in joints:
        joint = r.spec.joint(name)
        values = np.array(joint.damping)
        values[0] += damping
        joint.damping = values


def dry_friction(r: Reality, joints: Sequence[str], torque: float) -> None:
    """Coulomb friction of so many N m."""
    for name in joints:
        r.spec.joint(name).frictionloss += torque


def armature(r: Reality, joints: Sequence[str], armature: float) -> None:
    """Rotor inertia [kg m^2] more than believed."""
    for name in joints:
        r.spec.joint(name).armature += armature


def joint_stiffness(r: Reality, joints: Sequence[str], stiffness: float) -> None:
    """A spring [N m/rad] around the zero angle."""
    for name in joints:
        joint = r.spec.joint(name)
        values = np.array(joint.stiffness)
        values[0] += stiffness
        joint.stiffness = values
        joint.springref = 0.0


def joint_offset(r: Reality, joints: Sequence[str], offset: float) -> None:
    """Encoders that show the true angle plus `offset` [rad]; the motor controller trusts them."""
    for name in joints:
        r.offset[name] = r.offset.get(name, 0.0) + offset


def actuator_gain(r: Reality, joints: Sequence[str], change: float) -> None:
    """Motors (and their controllers) whose force is `1 + change` times what is believed."""
    for _, actuator in r.actuators_of(joints):
        actuator.gainprm = np.array(actuator.gainprm) * (1 + change)
        actuator.biasprm = np.array(actuator.biasprm) * (1 + change)


def torque_limit(r: Reality, joints: Sequence[str], limit: float) -> None:
    """Motors that give no more than `limit` [N m]."""
    for _, actuator in r.actuators_of(joints):
        actuator.forcelimited = True
        actuator.forcerange = [-limit, limit]


def actuator_delay(r: Reality, joints: Sequence[str], delay: float) -> None:
    """Commands that arrive late [s]."""
    for i, _ in r.actuators_of(joints):
        r.delay[i] += delay


def actuator_lag(r: Reality, joints: Sequence[str], time_constant: float) -> None:
    """Commands behind a first-order low pass [s]."""
    for i, _ in r.actuators_of(joints):
        r.lag[i] = time_constant


def backlash(r: Reality, joints: Sequence[str], play: float) -> None:
    """A dead band of +- `play` [rad] in the error that a position controller sees."""
    pairs = [(i, a.target) for i, a in r.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            error = data.ctrl[i] - data.joint(name).qpos[0]
            data.ctrl[i] -= min(max(error, -play), play)

    r.hooks.append(hook)


def load_friction(r: Reality, joints: Sequence[str], coefficient: float) -> None:
    """Friction of a gear: `coefficient` times the motor's torque."""
    pairs = [(i, a.target) for i, a in r.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            model.joint(name).frictionloss[0] += coefficient * abs(data.actuator_force[i])

    r.hooks.append(hook)


def stribeck_friction(r: Reality, joints: Sequence[str], torque: float, speed: float) -> None:
    """Friction that is `torque` [N m] at rest and falls off above `speed` [rad/s]."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for name in joints:
            ratio = data.joint(name).qvel[0] / speed
            model.joint(name).frictionloss[0] += torque * np.exp(-ratio * ratio)

    r.hooks.append(hook)


def payload(r: Reality, body: str, mass: float, position: Sequence[float]) -> None:
    """A point mass [kg] at `position` [m] in the body's frame; a negative one thins the whole body instead."""
    if mass > 0:
        extra = r.spec.body(body).add_body(name=f"payload on {body}", pos=list(position))
        extra.mass, extra.inertia, extra.ipos, extra.explicitinertial = mass, [1e-9 * mass] * 3, [0.0] * 3, True
        return
    scale_mass(r, body, 1 + mass / float(r.spec.copy().compile().body(body).mass[0]))


def scale_mass(r: Reality, body: str, factor: float) -> None:
    """A body that is heavier throughout."""
    for geom in r.spec.body(body).geoms:
        if np.isfinite(geom.mass):
            geom.mass *= factor
        else:
            geom.density *= factor


def link_length(r: Reality, body: str, change: float) -> None:
    """A link that is longer by `change` [m]: what lies at its far end moves outwards, its limb grows with it."""
    link = r.spec.body(body)
    limb = next(g for g in link.geoms if g.type == mujoco.mjtGeom.mjGEOM_CAPSULE and np.isfinite(g.fromto[0]))
    ends = np.array(limb.fromto)
    length = np.linalg.norm(ends[3:] - ends[:3])
    step = change * (ends[3:] - ends[:3]) / length
    for other in (*link.geoms, *link.bodies):
        if other is not limb and np.linalg.norm(np.array(other.pos) - ends[3:]) < 1e-3 * length:
            other.pos = np.array(other.pos) + step
    limb.fromto = np.concatenate([ends[:3], ends[3:] + step])


def ground_friction(r: Reality, factor: float) -> None:
    """All sliding friction times `factor`."""
    for geom in r.spec.geoms:
        geom.friction = np.array(geom.friction) * [factor, 1, 1]


def contact_softness(r: Reality, change: float) -> None:
    """Contacts whose time constant is longer by `change` [s]."""
    for geom in r.spec.geoms:
        geom.solref = np.array(geom.solref) + np.array([change, 0])


def ground_slope(r: Reality, x: float, y: float) -> None:
    """Ground that is turned by x [rad] about the x axis, then by y about the y axis; gravity turns instead."""
    size = float(np.linalg.norm(r.spec.option.gravity))
    down = -np.array([-np.sin(y), np.cos(y) * np.sin(x), np.cos(y) * np.cos(x)])  # -z, seen from the ground
    r.spec.option.gravity = size * down


def air_drag(r: Reality, density: float) -> None:
    """A medium of so many kg/m^3."""
    r.spec.option.density += density


def constant_force(r: Reality, body: str, force: Sequence[float]) -> None:
    """A force [N] in world directions at the body's centre of mass."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.body(body).xfrc_applied[:3] += force

    r.hooks.append(hook)


@dataclass(frozen=True)
class Loads:
    """How hard a robot works, by joint: what sizes are drawn from.

    Attributes:
      torque, speed, acceleration, travel: peaks (the 98th percentile of the absolute value) of the motor's torque
        [N m], the joint's speed [rad/s], acceleration [rad/s^2] and excursion from its mean [rad], by joint.
    """

    torque: Mapping[str, float]
    speed: Mapping[str, float]
    acceleration: Mapping[str, float]
    travel: Mapping[str, float]


def loads(robot: CaseRobot, motions: Sequence[Motion]) -> Loads:
    """Peaks over some motions of the believed robot."""
    model = robot.model
    rows = [simulate(Reality.of(robot), motion, robot.duration, 500.0, 5e-4) for motion in motions]
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
    """States that a simulation is put back to every so many samples.

    Attributes:
      rows: what `simulate` returned for another reality.
      samples: number of samples between two restarts.
    """

    rows: Mapping[str, np.ndarray]
    samples: int


def simulate(
    r: Reality, motion: Motion, duration: float, rate: float, timestep: float = TIMESTEP, restart: Restart | None = None
) -> dict[str, np.ndarray]:
    """Run a reality and sample it.

    Args:
      r: the reality.
      motion: what is commanded.
      duration: [s].
      rate: samples per second.
      timestep: of the simulation [s]; the integrator is `implicit`.
      restart: states to start anew from along the way; None for none.

    Returns:
      time (K,), qpos (K, nq), qvel (K, nv) as its encoders would show them without noise, by the believed robot's
      joints; force (K, nu) and act (K, na) of the actuators.
    """
    spec = r.spec.copy()
    spec.option.timestep, spec.option.integrator = timestep, mujoco.mjtIntegrator.mjINT_IMPLICIT
    model, believed = spec.compile(), r.robot.model
    data = mujoco.MjData(model)
    places = _places(model, believed)
    if r.robot.base is not None:
        _set_down(model, data, believed)
    steps, every = round(duration / timestep), max(1, round(1 / rate / timestep))
    commands = _arriving(r, motion, steps, timestep)
    commands -= np.array([r.offset.get(a.target, 0.0) for a in r.spec.actuators])
    rows: dict[str, list[np.ndarray]] = {"time": [], "qpos": [], "qvel": [], "force": [], "act": []}
    frictionloss = model.dof_frictionloss.copy()
    mujoco.mj_forward(model, data)
    for k in range(steps + 1):
        if restart is not None and k % (every * restart.samples) == 0:
            row = k // every
            data.qpos[places[0]], data.qvel[places[1]] = restart.rows["qpos"][row], restart.rows["qvel"][row]
            data.act[:] = restart.rows["act"][row]
            for name, angle in r.offset.items():
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
        for hook in r.hooks:
            hook(model, data)
        mujoco.mj_step(model, data)
    out = {name: np.array(values) for name, values in rows.items()}
    for name, angle in r.offset.items():
        out["qpos"][:, believed.joint(name).qposadr[0]] += angle
    return out


def _places(model: mujoco.MjModel, believed: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Addresses of the believed robot's coordinates in a model that may have more joints."""
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


def _set_down(model: mujoco.MjModel, data: mujoco.MjData, believed: mujoco.MjModel) -> None:
    """Start as high above the ground as the believed robot does."""
    clearance = _lowest(believed, mujoco.MjData(believed))
    data.qpos[2] -= _lowest(model, data) - clearance


def _arriving(r: Reality, motion: Motion, steps: int, timestep: float) -> np.ndarray:
    """Commands (steps, nu) in the middle of each step, after delay and lag; before the start the first one holds."""
    times = (np.arange(steps) + 0.5) * timestep
    commands = motion(times)
    for i in np.flatnonzero(r.delay):
        commands[:, i] = motion(np.maximum(times - r.delay[i], 0.0))[:, i]
    for i in np.flatnonzero(r.lag):
        # Exact for a command that is linear between the middles of two steps; at rest on its first value.
        constant, last, state = float(r.lag[i]), float(motion(np.zeros(1))[0, i]), float(motion(np.zeros(1))[0, i])
        for k in range(steps):
            span, command = (timestep if k else timestep / 2), float(commands[k, i])
            ramp = constant * (command - last) / span
            state = command - ramp + (state - last + ramp) * np.exp(-span / constant)
            last, commands[k, i] = command, state
    return commands
