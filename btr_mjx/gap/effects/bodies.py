"""Effects of bodies and of the environment: payload, link length, centre of mass, constant force, air drag, slope."""

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.links import lengthen, link_of
from btr_mjx.gap.effects.mass import MassProperties, clear_sameframe, point_mass
from btr_mjx.gap.effects.places import WORLD, Place, body_place, leaf_links, links, trunks, welded_bodies
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import World


def _extent(model: mujoco.MjModel, body: int) -> float:
    """Largest distance of the geoms of a body, and of bodies welded to it, from the body frame [m]."""
    own = model.body_weldid[model.geom_bodyid] == model.body_weldid[body]
    solid = own & (model.geom_rbound > 0)
    reach = np.linalg.norm(model.geom_pos[solid], axis=1) + model.geom_rbound[solid]
    return float(reach.max(initial=0.0)) or 0.1


def _payload_places(model: mujoco.MjModel) -> list[Place]:
    # The diagonal mass matrix of a simple body (body_simple) cannot represent another centre of mass.
    free = [b for b in [*trunks(model), *links(model), *welded_bodies(model)] if model.body_mass[b] > 0]
    return [body_place(model, b) for b in sorted(free) if not model.body_simple[b]]


def _payload(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    (body,) = place.bodies
    own = float(model.body_mass[model.body_weldid == model.body_weldid[body]].sum())
    welded = body in welded_bodies(model)
    mass = Parameter(
        "mass",
        "kg",
        -(1.0 if welded else 0.9) * float(model.body_mass[body]),
        0.5 * scales.mass + own,
        min(0.1 * own, 0.02 * scales.mass),
        0.0 if welded else 0.005 * own,  # the mass of a link, with what is welded to it, is calibrated once
        floor=welded,
    )
    if welded:
        return (mass,)
    link = link_of(model, body)
    if body in trunks(model) or link is None:
        reach = _extent(model, body)
        centre = model.body_ipos[body]
        where = tuple(
            Parameter(axis, "m", float(c) - reach, float(c) + reach, 0.2 * reach, null=float(c), shape=True)
            for axis, c in zip("xyz", centre, strict=True)
        )
        return (mass, *where)
    length = link.length
    return (mass, Parameter("along", "m", -0.2 * length, 1.2 * length, -0.2 * length, null=length, shape=True))


def _apply_payload(world: World, place: Place, values: np.ndarray) -> None:
    """A point mass m fixed to the body.

    Position: (x, y, z) in the frame of a trunk; at the distance `along` from the joint towards the far end of a link;
    at the centre of mass of a body that is welded to another one. Such a body may be taken off: a negative mass takes
    this part of the body's inertia along.
    """
    (body,) = place.bodies
    model = world.model
    if len(values) == 4:
        position = values[1:]
    elif len(values) == 2:
        link = link_of(model, body)
        assert link is not None
        position = link.point(values[1])
    elif values[0] < 0:
        MassProperties.of(model, body).scaled(1 + float(values[0]) / model.body_mass[body]).write(model, body)
        return
    else:
        position = model.body_ipos[body]
    MassProperties.of(model, body).plus(point_mass(float(values[0]), position)).write(model, body)


def _length(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    link = link_of(model, place.bodies[0])
    assert link is not None
    size = link.length
    return (Parameter("change", "m", -0.5 * size, 1.0 * size, 0.005 * size, 5e-4 * size),)


def _apply_length(world: World, place: Place, values: np.ndarray) -> None:
    """The link is longer by `change`; its mass grows with the length, see `links.lengthen`."""
    link = link_of(world.model, place.bodies[0])
    assert link is not None
    lengthen(world.model, link, float(values[0]))


def _shift(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    reach = _extent(model, place.bodies[0])
    return tuple(Parameter(axis, "m", -0.5 * reach, 0.5 * reach, 0.02 * reach, 0.002 * reach) for axis in "xyz")


def _apply_shift(world: World, place: Place, values: np.ndarray) -> None:
    """Shift of the centre of mass of a trunk, at constant mass and inertia about the centre of mass."""
    (body,) = place.bodies
    world.model.body_ipos[body] += values
    clear_sameframe(world.model, body)


def _force(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    (body,) = place.bodies
    weight = 9.81 * float(model.body_subtreemass[body])
    most = 3.0 * weight + 9.81 * scales.mass
    return tuple(Parameter(axis, "N", -most, most, 0.02 * weight) for axis in "xyz")


def _apply_force(world: World, place: Place, values: np.ndarray) -> None:
    """Constant force (x, y, z) in the world frame at the centre of mass of the body, such as of a cable or wind."""
    world.wrench[place.bodies[0], :3] += values


def _world(model: mujoco.MjModel) -> list[Place]:
    return [WORLD] if (model.body_weldid != 0).any() else []


def _drag(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    solid = (model.body_weldid != 0) & (model.body_mass > 0)
    mass, inertia = model.body_mass[solid], model.body_inertia[solid]
    if not len(mass):
        return (Parameter("density", "kg/m^3", 0.0, 100.0, 1.0),)
    # MuJoCo's inertia-based fluid model: each body is the box of equal inertia.
    sides = np.sqrt(np.maximum(6 * (inertia.sum(1, keepdims=True) - 2 * inertia) / mass[:, None], 1e-12))
    size = float(np.median(mass / np.maximum(sides.prod(1), 1e-12)))
    believed = float(model.opt.density)
    return (Parameter("density", "kg/m^3", 0.0, believed + 2.0 * size, 0.01 * size, null=believed, floor=True),)


def _apply_drag(world: World, place: Place, values: np.ndarray) -> None:
    """Drag -1/2 rho A v |v| on every body, as on the box of equal inertia (MuJoCo's inertia-based fluid model)."""
    world.model.opt.density = max(float(values[0]), 0.0)


def _mounted(model: mujoco.MjModel) -> list[Place]:
    """The world of a robot that is bolted down, with gravity."""
    return [] if (model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)).any() else _slope_places(model)


def _compensation(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    # MuJoCo leaves out what is negative.
    least = float(model.body_gravcomp[model.body_weldid != 0].min())
    return (Parameter("fraction", "1", min(0.0, -least), 1.5, 0.05, floor=True),)


def _apply_compensation(world: World, place: Place, values: np.ndarray) -> None:
    """Gravity is taken off all moving bodies by this fraction, as a controller that knows their weight does it."""
    model = world.model
    model.body_gravcomp[model.body_weldid != 0] += values[0]


def _slope_places(model: mujoco.MjModel) -> list[Place]:
    return _world(model) if np.linalg.norm(model.opt.gravity) > 0 else []


def _apply_slope(world: World, place: Place, values: np.ndarray) -> None:
    """Slope of the ground (or of the base of a fixed robot): rotation by x about the x axis, then by y about y.

    In the frame of the ground, gravity is rotated by the inverse: g' = R^T g with R = R_y(y) R_x(x).
    """
    cx, sx, cy, sy = np.cos(values[0]), np.sin(values[0]), np.cos(values[1]), np.sin(values[1])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    world.model.opt.gravity[:] = (about_y @ about_x).T @ world.model.opt.gravity


PAYLOAD = Effect(
    "payload",
    _payload_places,
    _payload,
    _apply_payload,
    excited_by="accelerations of the body, weight on its joints",
    equation="a point mass fixed to the body",
)
LINK_LENGTH = Effect(
    "link_length",
    lambda m: [body_place(m, b) for b in links(m) if link_of(m, b) is not None and not m.body_simple[b]],
    _length,
    _apply_length,
    excited_by="contact of the limb's end, accelerations",
    equation="the body's far end lies further from its joint",
)
COM_SHIFT = Effect(
    "com_shift",
    lambda m: [body_place(m, b) for b in trunks(m) if m.body_mass[b] > 0 and not m.body_simple[b]],
    _shift,
    _apply_shift,
    excited_by="accelerations and tilts of the trunk",
    equation="the centre of mass lies elsewhere",
)
CONSTANT_FORCE = Effect(
    "constant_force",
    lambda model: [body_place(model, b) for b in sorted({*trunks(model), *leaf_links(model)})],
    _force,
    _apply_force,
    excited_by="any motion",
    equation="a constant force at the body's centre of mass, world frame",
)
AIR_DRAG = Effect(
    "air_drag",
    _world,
    _drag,
    _apply_drag,
    excited_by="fast motion through the air",
    equation="drag ½ ρ A v² on every body",
)
GRAVITY_COMPENSATION = Effect(
    "gravity_compensation",
    _mounted,
    _compensation,
    _apply_compensation,
    excited_by="several postures under load",
    equation="τ = fraction × weight of the links, upwards",
)
GROUND_SLOPE = Effect(
    "ground_slope",
    _slope_places,
    lambda *_: tuple(Parameter(axis, "rad", -0.6, 0.6, 0.02, 1e-3) for axis in "xy"),
    _apply_slope,
    excited_by="free motion, standing",
    equation="gravity turned by the slope of the ground",
)

BODY_EFFECTS = (PAYLOAD, LINK_LENGTH, COM_SHIFT, CONSTANT_FORCE, AIR_DRAG, GRAVITY_COMPENSATION, GROUND_SLOPE)
