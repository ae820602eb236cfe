"""Physics of hidden realities: edits of the MJCF, edits of the command, and forces between steps.

An independent implementation of the effects of the library, which shares no code with it, so that the two can be tested
against each other. The MJCF is edited through `mujoco.MjSpec` and compiled again. Effects that depend on the state are
hooks that a loop over `mj_step` calls before every step. `motion` runs the simulation.

All functions below add an effect to a reality. Joints are names; values are in SI units with angles in rad.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from hidden_cases.robots import CaseRobot

Hook = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Called before a step; may change controls, applied forces and the friction loss of that step."""


@dataclass
class HiddenReality:
    """A reality to which effects are added.

    Attributes:
      robot: the believed robot.
      spec: MJCF of the reality, edited in place.
      hooks: functions that are called before every step, after the control was written.
      delay, lag: (nu,) delay and time constant of a first-order lag of the commands [s].
      offset: difference between measured and true angle [rad], by joint.
    """

    robot: CaseRobot
    spec: mujoco.MjSpec
    hooks: list[Hook] = field(default_factory=list)
    delay: np.ndarray = field(default_factory=lambda: np.zeros(0))
    lag: np.ndarray = field(default_factory=lambda: np.zeros(0))
    offset: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, robot: CaseRobot) -> "HiddenReality":
        """A reality that is equal to the believed robot."""
        spec = mujoco.MjSpec.from_string(robot.xml)
        nu = len(spec.actuators)
        return cls(robot, spec, delay=np.zeros(nu), lag=np.zeros(nu))

    def actuators_of(self, joints: Sequence[str]) -> list[tuple[int, mujoco.MjsActuator]]:
        """Index and specification of the actuators that drive some joints."""
        return [(i, a) for i, a in enumerate(self.spec.actuators) if a.target in joints]


def viscous_damping(reality: HiddenReality, joints: Sequence[str], damping: float) -> None:
    """Additional viscous damping: a torque -damping dq/dt, damping in N m s/rad."""
    for name in joints:
        joint = reality.spec.joint(name)
        values = np.array(joint.damping)
        values[0] += damping
        joint.damping = values


def dry_friction(reality: HiddenReality, joints: Sequence[str], torque: float) -> None:
    """Additional Coulomb friction [N m]."""
    for name in joints:
        reality.spec.joint(name).frictionloss += torque


def armature(reality: HiddenReality, joints: Sequence[str], armature: float) -> None:
    """Additional rotor inertia [kg m^2]."""
    for name in joints:
        reality.spec.joint(name).armature += armature


def joint_stiffness(reality: HiddenReality, joints: Sequence[str], stiffness: float) -> None:
    """A spring [N m/rad] around the zero angle."""
    for name in joints:
        joint = reality.spec.joint(name)
        values = np.array(joint.stiffness)
        values[0] += stiffness
        joint.stiffness = values
        joint.springref = 0.0


def joint_offset(reality: HiddenReality, joints: Sequence[str], offset: float) -> None:
    """Encoders that measure the true angle plus `offset` [rad]; position controllers use what they measure."""
    for name in joints:
        reality.offset[name] = reality.offset.get(name, 0.0) + offset


def actuator_gain(reality: HiddenReality, joints: Sequence[str], change: float) -> None:
    """Actuators whose force, feedback included, is `1 + change` times the believed one."""
    for _, actuator in reality.actuators_of(joints):
        actuator.gainprm = np.array(actuator.gainprm) * (1 + change)
        actuator.biasprm = np.array(actuator.biasprm) * (1 + change)


def torque_limit(reality: HiddenReality, joints: Sequence[str], limit: float) -> None:
    """Actuators whose force is limited to +- `limit` [N m]."""
    for _, actuator in reality.actuators_of(joints):
        actuator.forcelimited = True
        actuator.forcerange = [-limit, limit]


def actuator_delay(reality: HiddenReality, joints: Sequence[str], delay: float) -> None:
    """Commands that act `delay` [s] late."""
    for i, _ in reality.actuators_of(joints):
        reality.delay[i] += delay


def actuator_lag(reality: HiddenReality, joints: Sequence[str], time_constant: float) -> None:
    """Commands behind a first-order low-pass filter with a `time_constant` [s]."""
    for i, _ in reality.actuators_of(joints):
        reality.lag[i] = time_constant


def backlash(reality: HiddenReality, joints: Sequence[str], play: float) -> None:
    """A dead band of +- `play` [rad] in the error of a position controller."""
    pairs = [(i, a.target) for i, a in reality.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            error = data.ctrl[i] - data.joint(name).qpos[0]
            data.ctrl[i] -= min(max(error, -play), play)

    reality.hooks.append(hook)


def load_friction(reality: HiddenReality, joints: Sequence[str], coefficient: float) -> None:
    """Friction of a gear: Coulomb friction of `coefficient` times the absolute torque of the motor."""
    pairs = [(i, a.target) for i, a in reality.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            model.joint(name).frictionloss[0] += coefficient * abs(data.actuator_force[i])

    reality.hooks.append(hook)


def stribeck_friction(reality: HiddenReality, joints: Sequence[str], torque: float, speed: float) -> None:
    """Stribeck friction: Coulomb friction of torque exp(-(dq/dt / speed)^2), torque in N m, speed in rad/s."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for name in joints:
            ratio = data.joint(name).qvel[0] / speed
            model.joint(name).frictionloss[0] += torque * np.exp(-ratio * ratio)

    reality.hooks.append(hook)


def payload(reality: HiddenReality, body: str, mass: float, position: Sequence[float]) -> None:
    """A point mass [kg] at `position` [m] in the body's frame; a negative mass reduces the body's density instead."""
    if mass > 0:
        extra = reality.spec.body(body).add_body(name=f"payload on {body}", pos=list(position))
        extra.mass, extra.inertia, extra.ipos, extra.explicitinertial = mass, [1e-9 * mass] * 3, [0.0] * 3, True
        return
    scale_mass(reality, body, 1 + mass / float(reality.spec.copy().compile().body(body).mass[0]))


def scale_mass(reality: HiddenReality, body: str, factor: float) -> None:
    """A body whose mass and inertia are multiplied by `factor`."""
    for geom in reality.spec.body(body).geoms:
        if np.isfinite(geom.mass):
            geom.mass *= factor
        else:
            geom.density *= factor


def link_length(reality: HiddenReality, body: str, change: float) -> None:
    """A link that is longer by `change` [m]: its capsule grows, and elements at its far end move with it."""
    link = reality.spec.body(body)
    limb = next(g for g in link.geoms if g.type == mujoco.mjtGeom.mjGEOM_CAPSULE and np.isfinite(g.fromto[0]))
    ends = np.array(limb.fromto)
    length = np.linalg.norm(ends[3:] - ends[:3])
    step = change * (ends[3:] - ends[:3]) / length
    for other in (*link.geoms, *link.bodies):
        if other is not limb and np.linalg.norm(np.array(other.pos) - ends[3:]) < 1e-3 * length:
            other.pos = np.array(other.pos) + step
    limb.fromto = np.concatenate([ends[:3], ends[3:] + step])


def ground_friction(reality: HiddenReality, factor: float) -> None:
    """Sliding friction of all geoms, multiplied by `factor`."""
    for geom in reality.spec.geoms:
        geom.friction = np.array(geom.friction) * [factor, 1, 1]


def contact_softness(reality: HiddenReality, change: float) -> None:
    """Contacts whose time constant (the first number of solref) is larger by `change` [s]."""
    for geom in reality.spec.geoms:
        geom.solref = np.array(geom.solref) + np.array([change, 0])


def ground_slope(reality: HiddenReality, x: float, y: float) -> None:
    """A slope: ground turned by x [rad] about the x axis, then by y about the y axis; gravity is turned instead."""
    size = float(np.linalg.norm(reality.spec.option.gravity))
    down = -np.array([-np.sin(y), np.cos(y) * np.sin(x), np.cos(y) * np.cos(x)])  # -z in the frame of the ground
    reality.spec.option.gravity = size * down


def air_drag(reality: HiddenReality, density: float) -> None:
    """A medium with a `density` [kg/m^3]."""
    reality.spec.option.density += density


def constant_force(reality: HiddenReality, body: str, force: Sequence[float]) -> None:
    """A constant force [N] in the world frame at the body's centre of mass."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.body(body).xfrc_applied[:3] += force

    reality.hooks.append(hook)
