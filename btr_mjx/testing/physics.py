"""What may be different in a hidden reality: edits of the MJCF, of the command, and forces between steps.

A second, plain route to the same physics as the library of effects: the MJCF is edited through MjSpec and compiled
anew, and what depends on the state is a hook that a loop over `mj_step` calls before every step of 1e-4 s. Sharing no
code, agreement between the two means something. `motion` lets it move.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from btr_mjx.testing.robots import CaseRobot

Hook = Callable[[mujoco.MjModel, mujoco.MjData], None]


@dataclass
class HiddenReality:
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
    def of(cls, robot: CaseRobot) -> "HiddenReality":
        """A reality that is as believed."""
        spec = mujoco.MjSpec.from_string(robot.xml)
        nu = len(spec.actuators)
        return cls(robot, spec, delay=np.zeros(nu), lag=np.zeros(nu))

    def actuators_of(self, joints: Sequence[str]) -> list[tuple[int, mujoco.MjsActuator]]:
        """Index and specification of the actuators that drive some joints."""
        return [(i, a) for i, a in enumerate(self.spec.actuators) if a.target in joints]


def viscous_damping(r: HiddenReality, joints: Sequence[str], damping: float) -> None:
    """A torque -damping dq/dt [N m s/rad] more than believed."""
    for name in joints:
        joint = r.spec.joint(name)
        values = np.array(joint.damping)
        values[0] += damping
        joint.damping = values


def dry_friction(r: HiddenReality, joints: Sequence[str], torque: float) -> None:
    """Coulomb friction of so many N m."""
    for name in joints:
        r.spec.joint(name).frictionloss += torque


def armature(r: HiddenReality, joints: Sequence[str], armature: float) -> None:
    """Rotor inertia [kg m^2] more than believed."""
    for name in joints:
        r.spec.joint(name).armature += armature


def joint_stiffness(r: HiddenReality, joints: Sequence[str], stiffness: float) -> None:
    """A spring [N m/rad] around the zero angle."""
    for name in joints:
        joint = r.spec.joint(name)
        values = np.array(joint.stiffness)
        values[0] += stiffness
        joint.stiffness = values
        joint.springref = 0.0


def joint_offset(r: HiddenReality, joints: Sequence[str], offset: float) -> None:
    """Encoders that show the true angle plus `offset` [rad]; the motor controller trusts them."""
    for name in joints:
        r.offset[name] = r.offset.get(name, 0.0) + offset


def actuator_gain(r: HiddenReality, joints: Sequence[str], change: float) -> None:
    """Motors (and their controllers) whose force is `1 + change` times what is believed."""
    for _, actuator in r.actuators_of(joints):
        actuator.gainprm = np.array(actuator.gainprm) * (1 + change)
        actuator.biasprm = np.array(actuator.biasprm) * (1 + change)


def torque_limit(r: HiddenReality, joints: Sequence[str], limit: float) -> None:
    """Motors that give no more than `limit` [N m]."""
    for _, actuator in r.actuators_of(joints):
        actuator.forcelimited = True
        actuator.forcerange = [-limit, limit]


def actuator_delay(r: HiddenReality, joints: Sequence[str], delay: float) -> None:
    """Commands that arrive late [s]."""
    for i, _ in r.actuators_of(joints):
        r.delay[i] += delay


def actuator_lag(r: HiddenReality, joints: Sequence[str], time_constant: float) -> None:
    """Commands behind a first-order low pass [s]."""
    for i, _ in r.actuators_of(joints):
        r.lag[i] = time_constant


def backlash(r: HiddenReality, joints: Sequence[str], play: float) -> None:
    """A dead band of +- `play` [rad] in the error that a position controller sees."""
    pairs = [(i, a.target) for i, a in r.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            error = data.ctrl[i] - data.joint(name).qpos[0]
            data.ctrl[i] -= min(max(error, -play), play)

    r.hooks.append(hook)


def load_friction(r: HiddenReality, joints: Sequence[str], coefficient: float) -> None:
    """Friction of a gear: `coefficient` times the motor's torque."""
    pairs = [(i, a.target) for i, a in r.actuators_of(joints)]

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for i, name in pairs:
            model.joint(name).frictionloss[0] += coefficient * abs(data.actuator_force[i])

    r.hooks.append(hook)


def stribeck_friction(r: HiddenReality, joints: Sequence[str], torque: float, speed: float) -> None:
    """Friction that is `torque` [N m] at rest and falls off above `speed` [rad/s]."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        for name in joints:
            ratio = data.joint(name).qvel[0] / speed
            model.joint(name).frictionloss[0] += torque * np.exp(-ratio * ratio)

    r.hooks.append(hook)


def payload(r: HiddenReality, body: str, mass: float, position: Sequence[float]) -> None:
    """A point mass [kg] at `position` [m] in the body's frame; a negative one thins the whole body instead."""
    if mass > 0:
        extra = r.spec.body(body).add_body(name=f"payload on {body}", pos=list(position))
        extra.mass, extra.inertia, extra.ipos, extra.explicitinertial = mass, [1e-9 * mass] * 3, [0.0] * 3, True
        return
    scale_mass(r, body, 1 + mass / float(r.spec.copy().compile().body(body).mass[0]))


def scale_mass(r: HiddenReality, body: str, factor: float) -> None:
    """A body that is heavier throughout."""
    for geom in r.spec.body(body).geoms:
        if np.isfinite(geom.mass):
            geom.mass *= factor
        else:
            geom.density *= factor


def link_length(r: HiddenReality, body: str, change: float) -> None:
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


def ground_friction(r: HiddenReality, factor: float) -> None:
    """All sliding friction times `factor`."""
    for geom in r.spec.geoms:
        geom.friction = np.array(geom.friction) * [factor, 1, 1]


def contact_softness(r: HiddenReality, change: float) -> None:
    """Contacts whose time constant is longer by `change` [s]."""
    for geom in r.spec.geoms:
        geom.solref = np.array(geom.solref) + np.array([change, 0])


def ground_slope(r: HiddenReality, x: float, y: float) -> None:
    """Ground that is turned by x [rad] about the x axis, then by y about the y axis; gravity turns instead."""
    size = float(np.linalg.norm(r.spec.option.gravity))
    down = -np.array([-np.sin(y), np.cos(y) * np.sin(x), np.cos(y) * np.cos(x)])  # -z, seen from the ground
    r.spec.option.gravity = size * down


def air_drag(r: HiddenReality, density: float) -> None:
    """A medium of so many kg/m^3."""
    r.spec.option.density += density


def constant_force(r: HiddenReality, body: str, force: Sequence[float]) -> None:
    """A force [N] in world directions at the body's centre of mass."""

    def hook(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.body(body).xfrc_applied[:3] += force

    r.hooks.append(hook)
