"""Random draws of a hidden case: effects with place and size, and small errors of calibration at every part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from btr_mjx.demo import MotionCommand
from btr_mjx.errors import InputError
from hidden_cases import physics
from hidden_cases.motion import Loads
from hidden_cases.physics import HiddenReality
from hidden_cases.robots import CaseRobot

_JOINT_EFFECTS = (
    "viscous_damping",
    "dry_friction",
    "load_friction",
    "stribeck_friction",
    "armature",
    "joint_stiffness",
    "joint_offset",
    "backlash",
)
_ACTUATOR_EFFECTS = ("actuator_delay", "actuator_lag", "actuator_gain", "torque_limit")
_BODY_EFFECTS = ("payload", "link_length")
_WORLD_EFFECTS = ("ground_friction", "ground_slope", "contact_softness", "air_drag", "constant_force")
SINGLE_JOINT_EFFECTS = ("joint_stiffness", "joint_offset")
"""Effects that are drawn for a single joint only."""
PER_JOINT_EFFECTS = ("viscous_damping", "dry_friction", "armature")
"""Effects that may be drawn with a number for every joint."""


@dataclass(frozen=True)
class Missing:
    """An effect that the believed model lacks.

    Attributes:
      effect: name of the effect.
      location: label of its place.
      parameters: values by name, in SI units. Where calibration left an error of the same kind at the same place, they
        are the sum of both, which is what recordings can show; of a group it is the mean of its members' errors.
    """

    effect: str
    location: str
    parameters: Mapping[str, float]


@dataclass
class Draw:
    """State of the draw of a case.

    Attributes:
      robot: the believed robot.
      rng: generator of everything that is drawn.
      motions: commands of the recordings.
      loads: peak torques, speeds, accelerations and travel in these motions.
      each: joint effects that can have it have a number for every joint.
      background: reality with the small errors of calibration alone.
      errors: small errors of calibration by effect and joint or body.
    """

    robot: CaseRobot
    rng: np.random.Generator
    motions: Sequence[MotionCommand]
    loads: Loads
    each: bool = False
    background: HiddenReality = field(init=False)
    errors: dict[tuple[str, str], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.background = HiddenReality.of(self.robot)


def draw_background(draw: Draw, scale: float) -> Any:
    """Draw the small errors of calibration: normal, with a standard deviation for each kind.

    Args:
      draw: the case.
      scale: factor on all standard deviations.

    Returns:
      A function that adds the errors to a reality; every call adds the same ones.
    """
    rng, robot, loads = draw.rng, draw.robot, draw.loads
    joints = list(loads.torque)
    n = len(joints)
    model = robot.model
    heavy = [model.body(b).name for b in range(1, model.nbody) if model.body_mass[b] > 0]
    gain, offset, damping = (scale * s * rng.normal(size=n) for s in (3e-3, 5e-4, 4e-4))
    mass, length = scale * 4e-3 * rng.normal(size=len(heavy)), scale * 4e-4 * rng.normal(size=len(robot.links))
    friction, softness = scale * np.array([0.03, 2e-4]) * rng.normal(size=2)
    for i, name in enumerate(joints):
        believed = float(model.dof_damping[model.joint(name).dofadr[0]])
        damping[i] = max(damping[i] * loads.torque[name] / loads.speed[name], -0.9 * believed)
        draw.errors["actuator_gain", name] = float(gain[i])
        draw.errors["joint_offset", name] = float(offset[i])
        draw.errors["viscous_damping", name] = float(damping[i])
    for i, body in enumerate(robot.links):
        length[i] *= _length(robot, body)
        draw.errors["link_length", body] = float(length[i])

    def add(reality: HiddenReality) -> None:
        for i, name in enumerate(joints):
            physics.actuator_gain(reality, [name], gain[i])
            physics.joint_offset(reality, [name], offset[i])
            physics.viscous_damping(reality, [name], damping[i])
        for body, share in zip(heavy, mass, strict=True):
            physics.scale_mass(reality, body, 1 + share)
        for body, share in zip(robot.links, length, strict=True):
            physics.link_length(reality, body, share)
        if robot.floor is not None:
            physics.ground_friction(reality, 1 + friction)
            physics.contact_softness(reality, softness)

    return add


def _length(robot: CaseRobot, body: str) -> float:
    """Length of a link [m]."""
    model = robot.model
    geom = int(model.body(body).geomadr[0])
    return 2 * float(model.geom_size[geom, 1])


def _possible_effects(draw: Draw) -> list[str]:
    floor = draw.robot.floor is not None
    names = [*_JOINT_EFFECTS, *_ACTUATOR_EFFECTS, *_BODY_EFFECTS]
    return names + [name for name in _WORLD_EFFECTS if floor or name == "air_drag"]


def add_effects(draw: Draw, reality: HiddenReality, effects: Sequence[str] | int) -> tuple[Missing, ...]:
    """Draw the missing effects, each of another kind and at another place, and add them to a reality.

    Args:
      draw: the case.
      reality: reality to which the effects are added.
      effects: number of effects, or their names.

    Returns:
      The effects with places and values.

    Raises:
      InputError: a number out of range, or an effect that the robot cannot have.
    """
    known = _possible_effects(draw)
    count = effects if isinstance(effects, int) else len(effects)
    if not 1 <= count <= len(known):
        raise InputError(f"effects: got {effects!r}, expected names or a number of at least 1")
    names = [str(n) for n in draw.rng.choice(known, count, replace=False)] if isinstance(effects, int) else effects
    missing: list[Missing] = []
    for name in names:
        if name not in known:
            raise InputError(f"effect {name!r}: {draw.robot.name} can have {', '.join(known)}")
        while True:
            one, apply = _drawn_effect(draw, name, reality)
            if one.location == "world" or one.location not in [other.location for other in missing]:
                break
            if len(draw.loads.torque) == 1:
                break
        apply(reality)
        missing.append(_with_errors(draw, one))
    return tuple(missing)


def _with_errors(draw: Draw, missing: Missing) -> Missing:
    """An effect with the errors of calibration of its kind at its place added to its numbers."""
    kind, _, name = missing.location.partition(":")
    everywhere = list(draw.loads.torque)
    places = {"all": everywhere, "subtree": _below(draw.robot.model, name, everywhere) if kind == "subtree" else []}
    own = [draw.errors.get((missing.effect, place), 0.0) for place in places.get(kind, [name])]
    parameters = dict(missing.parameters)
    if kind == "each":
        errors = [draw.errors.get((missing.effect, place), 0.0) for place in everywhere]
    else:
        errors = [float(np.mean(own)), *np.zeros(len(parameters) - 1)]
    for key, error in zip(parameters, errors, strict=True):
        both = parameters[key] * error if missing.effect == "actuator_gain" else 0.0  # gains are factors
        parameters[key] += error + both
    return replace(missing, parameters=parameters)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _joints_at(draw: Draw, single: bool, group: bool = True) -> tuple[str, list[str]]:
    """A joint, a leg or all joints: name of the joint or label of the place, and the joints."""
    rng, joints = draw.rng, list(draw.loads.torque)
    kind = rng.choice(3, p=[0.5, 0.3, 0.2])
    if single or len(joints) == 1 or kind == 0 or not group:
        name = str(rng.choice(joints))
        return name, [name]
    if kind == 1 and draw.robot.legs:
        leg = str(rng.choice(draw.robot.legs))
        return f"subtree:{leg}", _below(draw.robot.model, leg, joints)
    return "all", joints


def _below(model: mujoco.MjModel, body: str, joints: Sequence[str]) -> list[str]:
    root, chosen = model.body(body).id, []
    for name in joints:
        at = int(model.joint(name).bodyid[0])
        while at > root:
            at = int(model.body_parentid[at])
        if at == root:
            chosen.append(name)
    return chosen


def _drawn_effect(draw: Draw, name: str, reality: HiddenReality) -> tuple[Missing, Any]:
    """An effect with random place and size, and a function that adds it to a reality with its small errors."""
    if name in _BODY_EFFECTS:
        return _drawn_body(draw, name)
    if name in _WORLD_EFFECTS:
        return _drawn_world(draw, name, reality)
    if draw.each and name in PER_JOINT_EFFECTS:
        return _drawn_each(draw, name)
    place, joints = _joints_at(draw, name in SINGLE_JOINT_EFFECTS)
    location = place
    if place != "all" and not place.startswith("subtree:"):
        location = f"{'joint' if name in _JOINT_EFFECTS else 'actuator'}:{place}"
    parameters = _joint_sizes(draw, name, joints)
    function = getattr(physics, name)
    return Missing(name, location, parameters), lambda reality: function(reality, joints, **parameters)


def _drawn_each(draw: Draw, name: str) -> tuple[Missing, Any]:
    """An effect with a number of its own for every joint, and a function that adds it to a reality."""
    function = getattr(physics, name)
    sizes = {joint: _joint_sizes(draw, name, [joint]) for joint in draw.loads.torque}
    parameters = {f"{key}[{joint}]": value for joint, own in sizes.items() for key, value in own.items()}

    def add(reality: HiddenReality) -> None:
        for joint, own in sizes.items():
            function(reality, [joint], **own)

    return Missing(name, "each:all", parameters), add


def _joint_sizes(draw: Draw, name: str, joints: Sequence[str]) -> dict[str, float]:
    """Parameters of an effect on joints, from the mean loads there; the same for all of them."""
    rng, s = draw.rng, draw.loads
    torque, speed, travel = (float(np.mean([v[j] for j in joints])) for v in (s.torque, s.speed, s.travel))
    acceleration = float(np.mean([s.acceleration[j] for j in joints]))
    pace = 60.0 / draw.robot.tempo
    if name == "viscous_damping":
        return {"damping": _log_uniform(rng, 3e-3, 0.1) * torque / speed}
    if name == "dry_friction":
        return {"torque": _log_uniform(rng, 3e-3, 0.06) * torque}
    if name == "load_friction":
        return {"coefficient": _log_uniform(rng, 0.02, 0.3)}
    if name == "stribeck_friction":
        return {"torque": _log_uniform(rng, 0.01, 0.1) * torque, "speed": rng.uniform(0.05, 0.3) * speed}
    if name == "armature":
        return {"armature": _log_uniform(rng, 4e-3, 0.12) * torque / acceleration}
    if name == "joint_stiffness":
        return {"stiffness": _log_uniform(rng, 4e-3, 0.06) * torque / travel}
    if name == "joint_offset":
        return {"offset": float(rng.choice([-1, 1])) * _log_uniform(rng, 4e-3, 0.03)}
    if name == "backlash":
        return {"play": _log_uniform(rng, 1e-3, 0.015)}
    if name == "actuator_delay":
        return {"delay": pace * _log_uniform(rng, 1.5e-4, 3e-3)}
    if name == "actuator_lag":
        return {"time_constant": pace * _log_uniform(rng, 1.5e-4, 3e-3)}
    if name == "actuator_gain":
        return {"change": -_log_uniform(rng, 0.01, 0.15)}
    assert name == "torque_limit"
    return {"limit": (1 - rng.uniform(0.15, 0.5)) * max(s.torque[j] for j in joints)}


def _drawn_body(draw: Draw, name: str) -> tuple[Missing, Any]:
    rng, robot = draw.rng, draw.robot
    model = robot.model
    if name == "link_length":
        body = str(rng.choice(robot.links))
        change = float(rng.choice([-1, 1])) * _log_uniform(rng, 6e-3, 0.08) * _length(robot, body)
        return Missing(name, f"body:{body}", {"change": change}), lambda reality: physics.link_length(
            reality, body, change
        )
    if robot.base is not None and rng.random() < 0.4:
        body = robot.base
        mass = _log_uniform(rng, 0.015, 0.1) * float(model.body_subtreemass[0])
        half = float(model.geom_rbound[int(model.body(body).geomadr[0])])
        position = half * rng.uniform([-0.6, -0.2, 0.0], [0.6, 0.2, 0.2])
    else:
        body = str(rng.choice(robot.links))
        mass = _log_uniform(rng, 0.03, 0.2) * float(model.body(body).mass[0])
        geom = int(model.body(body).geomadr[0])
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        tip = rotation.reshape(3, 3)[:, 2] * model.geom_size[geom, 1]  # from the capsule's centre to one end
        ends = [model.geom_pos[geom] + tip, model.geom_pos[geom] - tip]
        position = max(ends, key=np.linalg.norm) * rng.uniform(0.6, 1.0)
    size = {"mass": mass, **dict(zip(("x", "y", "z"), map(float, position), strict=True))}
    return Missing(name, f"body:{body}", size), lambda reality: physics.payload(reality, body, mass, list(position))


def _drawn_world(draw: Draw, name: str, reality: HiddenReality) -> tuple[Missing, Any]:
    rng, robot = draw.rng, draw.robot
    # The parameters of these two effects are absolute values, which include the small errors of the reality.
    if name == "ground_friction":
        factor = 1 - rng.uniform(0.15, 0.6)
        size = {"coefficient": factor * max(float(geom.friction[0]) for geom in reality.spec.geoms)}
        return Missing(name, "world", size), lambda reality: physics.ground_friction(reality, factor)
    if name == "contact_softness":
        change = _log_uniform(rng, 2e-3, 0.03)
        size = {"time_constant": float(reality.spec.geoms[0].solref[0]) + change}
        return Missing(name, "world", size), lambda reality: physics.contact_softness(reality, change)
    if name == "ground_slope":
        tilt, angle = _log_uniform(rng, 0.04, 0.15), rng.uniform(0, 2 * np.pi)
        x, y = float(tilt * np.cos(angle)), float(tilt * np.sin(angle))
        return Missing(name, "world", {"x": x, "y": y}), lambda reality: physics.ground_slope(reality, x, y)
    if name == "air_drag":
        density = _log_uniform(rng, *robot.drag)
        return Missing(name, "world", {"density": density}), lambda reality: physics.air_drag(reality, density)
    body = str(robot.base)
    force = rng.normal(size=3)
    force *= _log_uniform(rng, 0.045, 0.22) * float(robot.model.body_subtreemass[0]) * 9.81 / np.linalg.norm(force)
    pull = dict(zip(("x", "y", "z"), map(float, force), strict=True))
    return Missing(name, f"body:{body}", pull), lambda reality: physics.constant_force(reality, body, list(force))
