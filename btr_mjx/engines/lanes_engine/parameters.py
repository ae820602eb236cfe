"""Parameters of a step, derived from MjModel fields in float64 on the host, for one model or a batch of models.

The batch axes of a derived parameter are (1, 1) if all fields that it depends on are equal in all worlds, and (N, C)
otherwise. Equal parameters become constants of the traced program, the others its arguments.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import mujoco
import numpy as np

from btr_mjx.engines.computed import element_name
from btr_mjx.engines.guards.pairs import PairGroup, bounding_box, shape_kind
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.contact_parameters import (
    MINVAL,
    constraint_row,
    contact_parameters,
    plane_frame,
    touch_parameters,
)
from btr_mjx.engines.lanes_engine.field_access import Fields, apply_matrix, rigid_pose, rigid_root, rotation_matrices
from btr_mjx.engines.lanes_engine.tree import BALL, FREE, Closure, Joint, TreePlan
from btr_mjx.engines.lanes_engine.tree_builder import massive_members, rigid_members
from btr_mjx.engines.scalars import SIX, Scalar, constant


def _inertia(model: mujoco.MjModel, fields: Fields, body: int) -> dict[str, np.ndarray]:
    """Inertia of a rigid link about its origin: mass, `h` = sum of m c [kg m], `inertia` (xx yy zz xy xz yz).

    "lift" are the same mass and three moments of what is without weight, by MuJoCo's gravity compensation.
    """
    h: Any = np.zeros((1, 1, 3))
    own: Any = np.zeros((1, 1))
    lift: Any = np.zeros((1, 1, 4))
    tensor: Any = np.zeros((1, 1, 3, 3))
    for b in rigid_members(model, body):
        position, matrix = rigid_pose(model, fields, b, body)
        mass = fields("body_mass", b)[..., None]
        c = position + apply_matrix(matrix, fields("body_ipos", b))
        axes = matrix @ rotation_matrices(fields("body_iquat", b))
        about = (axes * fields("body_inertia", b)[..., None, :]) @ np.swapaxes(axes, -1, -2)
        square = (c * c).sum(-1)[..., None, None] * np.eye(3) - c[..., :, None] * c[..., None, :]
        own, h = own + mass[..., 0], h + mass * c
        if model.flg_gravcomp and model.body_gravcomp[b] and _passive_forces(model):
            lift = lift + model.body_gravcomp[b] * mass * np.concatenate([np.ones_like(c[..., :1]), c], -1)
        tensor = tensor + about + mass[..., None] * square
    six = [tensor[..., i, j] for i, j in SIX]
    return {"mass": own[..., None], "h": h, "inertia": np.stack(six, -1), "lift": lift}


def _passive_forces(model: mujoco.MjModel) -> bool:
    """MuJoCo skips all passive forces, drag and gravity compensation included, without both springs and dampers."""
    return not (support.disabled(model, "SPRING") and support.disabled(model, "DAMPER"))


def _fluid(model: mujoco.MjModel, fields: Fields, body: int, root: int) -> dict[str, np.ndarray]:
    """Pose of a body's inertia in its link, and the edges [m] of the box that has this inertia."""
    position, matrix = rigid_pose(model, fields, body, root)
    moments = fields("body_inertia", body)
    spread = np.maximum(MINVAL, moments.sum(-1, keepdims=True) - 2 * moments)
    box = np.sqrt(6 * spread / fields("body_mass", body)[..., None])
    turn = matrix @ rotation_matrices(fields("body_iquat", body))
    centre = position + apply_matrix(matrix, fields("body_ipos", body))
    return {"pos": centre, "rot": turn.reshape(*turn.shape[:2], 9), "box": box}


def _frame(model: mujoco.MjModel, fields: Fields, body: int) -> dict[str, np.ndarray]:
    """Pose of a link's body at zero joint angles in the frame of its parent link."""
    parent = int(model.body_parentid[body])
    position, matrix = rigid_pose(model, fields, parent, rigid_root(model, parent))
    turn = matrix @ rotation_matrices(fields("body_quat", body))
    return {"pos": position + apply_matrix(matrix, fields("body_pos", body)), "rot": turn.reshape(*turn.shape[:2], 9)}


def _joint(model: mujoco.MjModel, fields: Fields, joint: Joint, j: int) -> dict[str, np.ndarray]:
    """Geometry, passive forces, limit and friction loss of one joint."""
    dof, adr = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    dofs = slice(dof, dof + len(joint.dofs))
    result = {
        "ref": fields("qpos0", slice(adr, adr + joint.coordinates)),
        "damping": fields("dof_damping", dofs),
        "armature": fields("dof_armature", dofs),
    }
    if support.disabled(model, "DAMPER"):
        result["damping"] = np.zeros((1, 1, len(joint.dofs)))
    if joint.kind == FREE:
        turning = result["armature"][..., 3:]
        if support.turns_alone(model, j) and np.any(turning != turning[..., :1]):
            raise support.refuse("armature that differs between the axes in which a free body turns, implicitfast")
        return result
    if joint.turned:
        for what in ("damping", "armature"):
            if np.any(result[what] != result[what][..., :1]):
                where = element_name(model, mujoco.mjtObj.mjOBJ_JOINT, j)
                raise support.refuse(f"{what} that differs between the axes of a ball joint with a limit ({where})")
    axis = fields("jnt_axis", j)
    result |= {
        "axis": axis,
        "pos": fields("jnt_pos", j),
        "spring": fields("qpos_spring", slice(adr, adr + joint.coordinates)),
    }
    stiff = np.zeros((1, 1, 1)) if support.disabled(model, "SPRING") else fields("jnt_stiffness", slice(j, j + 1))
    result |= {"stiffness": stiff, "actfrcrange": fields("jnt_actfrcrange", j)}
    if joint.limited:
        row = constraint_row(fields("jnt_solref", j), fields("jnt_solimp", j), model)
        result |= {f"limit_{key}": value for key, value in row.items()}
        bounds = fields("jnt_range", j)
        bounds = bounds.max(-1, keepdims=True) if joint.kind == BALL else bounds
        result |= {"range": bounds, "limit_margin": fields("jnt_margin", slice(j, j + 1))}
        result["limit_scale"] = 1 / np.maximum(MINVAL, fields("dof_invweight0", slice(dof, dof + 1)))
    if joint.friction:
        result |= _friction(model, fields, "dof", dofs)
    return result


def _friction(model: mujoco.MjModel, fields: Fields, kind: str, own: slice, suffix: str = "") -> dict[str, np.ndarray]:
    """Friction loss of the dofs of a joint, or of a tendon."""
    row = constraint_row(fields(f"{kind}_solref{suffix}", own), fields(f"{kind}_solimp{suffix}", own), model)
    low = row["impedance"][..., 0]  # friction rows have zero violation
    weight = low / ((1 - low) * np.maximum(MINVAL, fields(f"{kind}_invweight0", own)))
    return {
        "loss": fields(f"{kind}_frictionloss", own),
        "loss_weight": weight,
        "loss_damping": row["reference"][..., 1],
    }


def _tendon_limit(model: mujoco.MjModel, fields: Fields, t: int, side: int) -> dict[str, np.ndarray]:
    """One side of a tendon's range: 0 for the lower, 1 for the upper."""
    own = slice(t, t + 1)
    result = constraint_row(fields("tendon_solref_lim", t), fields("tendon_solimp_lim", t), model)
    result |= {"bound": fields("tendon_range", (t, slice(side, side + 1))), "margin": fields("tendon_margin", own)}
    return result | {"scale": 1 / np.maximum(MINVAL, fields("tendon_invweight0", own))}


def _equality(model: mujoco.MjModel, fields: Fields, e: int) -> dict[str, np.ndarray]:
    """Polynomial of an equality constraint, and the lengths from which those of its two sides are measured."""
    one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT:
        names = (("qpos0", model.jnt_qposadr), ("dof_invweight0", model.jnt_dofadr))
    else:
        names = (("tendon_length0", range(model.ntendon)), ("tendon_invweight0", range(model.ntendon)))
    zero, weight = (
        [fields(name, slice(int(place[i]), int(place[i]) + 1)) for i in (one, other) if i >= 0] for name, place in names
    )
    result = constraint_row(fields("eq_solref", e), fields("eq_solimp", e), model)
    result["scale"] = 1 / np.maximum(MINVAL, sum(weight))
    result["zero"] = np.concatenate(np.broadcast_arrays(zero[0], zero[-1]), -1)
    # A single side equals the constant.
    result["polynomial"] = fields("eq_data", e)[..., :5] * (np.arange(5) < (5 if other >= 0 else 1))
    return result


def _closure(model: mujoco.MjModel, fields: Fields, closure: Closure) -> dict[str, np.ndarray]:
    """The frames of both bodies that a constraint joins, in their links, and its weights.

    A weld's data begin with the point of the second body, and the turn between the frames is part of the first's.
    """
    weld, data = closure.kind == "weld", fields("eq_data", closure.id)
    result = constraint_row(fields("eq_solref", closure.id), fields("eq_solimp", closure.id), model)
    for side, body in enumerate(closure.bodies):
        position, matrix = rigid_pose(model, fields, body, rigid_root(model, body))
        if model.eq_objtype[closure.id] == mujoco.mjtObj.mjOBJ_SITE:
            site = int((model.eq_obj1id, model.eq_obj2id)[side][closure.id])
            point, turn = fields("site_pos", site), rotation_matrices(fields("site_quat", site))
        else:
            first = 3 * (side ^ weld)
            point = data[..., first : first + 3]
            turn = rotation_matrices(data[..., 6:10]) if weld and not side else np.eye(3)
        axes = matrix @ turn
        result[f"point{side}"] = position + apply_matrix(matrix, point)
        result[f"axes{side}"] = axes.reshape(*axes.shape[:2], 9)
    for n, what in enumerate(("scale", "turn_scale")):
        weights = [fields("body_invweight0", (body, slice(n, n + 1))) for body in closure.bodies]
        result[what] = 1 / np.maximum(MINVAL, weights[0] + weights[1])
    return result | {"torquescale": data[..., 10:11]}


def _actuator(fields: Fields, a: int) -> dict[str, np.ndarray]:
    return {
        "gain": fields("actuator_gainprm", a)[..., :3],
        "bias": fields("actuator_biasprm", a)[..., :3],
        "dynamics": fields("actuator_dynprm", a)[..., :2],
        "gear": fields("actuator_gear", a)[..., :1],
        "ctrlrange": fields("actuator_ctrlrange", a),
        "forcerange": fields("actuator_forcerange", a),
        "actrange": fields("actuator_actrange", a),
        "delay": fields("actuator_delay", slice(a, a + 1)),
    }


def _placed_geom(model: mujoco.MjModel, fields: Fields, geom: int) -> dict[str, np.ndarray]:
    """Pose in its link, size and margin of a geom that may meet others; its bounding box if it is not a primitive."""
    body = int(model.geom_bodyid[geom])
    position, matrix = rigid_pose(model, fields, body, rigid_root(model, body))
    position = position + apply_matrix(matrix, fields("geom_pos", geom))
    matrix = matrix @ rotation_matrices(fields("geom_quat", geom))
    size = fields("geom_size", geom)
    if model.geom_type[geom] == support.SPHERE:
        size = size * [1.0, 0.0, 0.0]  # it may count as a capsule, without length
    if shape_kind(model, geom) != model.geom_type[geom]:
        box = bounding_box(model, geom)
        position, size = position + apply_matrix(matrix, box[None, None, :3]), box[None, None, 3:]
    margin = (fields("geom_margin", geom) + fields("geom_gap", geom))[..., None]
    return {"centre": position, "axes": matrix.reshape(*matrix.shape[:2], 9), "size": size, "margin": margin}


def derive(
    model: mujoco.MjModel,
    plan: TreePlan,
    fields: Fields,
    geoms: Sequence[int] = (),
    between: Sequence[PairGroup] = (),
) -> dict[str, np.ndarray]:
    """All parameters of a step: name -> (N, C, G, k), or (1, 1, G, k) where the worlds are equal.

    G are the members of a group, k the components of the parameter. `geoms`, which may meet others than planes, are the
    members of the group "geoms"; the n-th of their pairs whose contact is computed, `between`, are those of
    "between<n>".
    """
    table: dict[str, np.ndarray] = {}

    def put(prefix: str, members: list[dict[str, np.ndarray]]) -> None:
        for key in members[0]:
            table[f"{prefix}/{key}"] = np.stack(np.broadcast_arrays(*(member[key] for member in members)), axis=2)

    gravity = np.zeros((1, 1, 3)) if support.disabled(model, "GRAVITY") else fields("opt.gravity")
    options = {key: fields(f"opt.{key}")[..., None] for key in ("density", "viscosity", "impratio")}
    put("world", [{"gravity": gravity, "wind": fields("opt.wind"), **options}])
    has_fluid = _passive_forces(model) and bool(np.any(options["density"]) or np.any(options["viscosity"]))
    for plane in sorted({touch.plane for link in plan.links for touch in link.touches}):
        put(f"plane{plane}", [plane_frame(model, fields, plane)])
    for link in plan.links:
        put(f"{link.index}", [_inertia(model, fields, b) | _frame(model, fields, b) for b in link.bodies])
        if has_fluid:
            for n, bodies in enumerate(zip(*(massive_members(model, b) for b in link.bodies), strict=False)):
                members = zip(bodies, link.bodies, strict=True)
                put(f"{link.index}/fluid{n}", [_fluid(model, fields, b, root) for b, root in members])
        for n, joint in enumerate(link.joints):
            put(f"{link.index}/joint{n}", [_joint(model, fields, joint, j) for j in joint.ids])
            for k, actuator in enumerate(joint.actuators):
                put(f"{link.index}/joint{n}/actuator{k}", [_actuator(fields, a) for a in actuator.ids])
        for n, touch in enumerate(link.touches):
            both = zip(link.bodies, touch.geoms, strict=True)
            put(f"{link.index}/touch{n}", [touch_parameters(model, fields, b, touch, g) for b, g in both])
    for tendon in plan.tendons:
        for k, actuator in enumerate(tendon.actuators):
            put(f"tendon{tendon.id}/actuator{k}", [_actuator(fields, a) for a in actuator.ids])
    limited = [(tendon.id, side) for tendon in plan.tendons if tendon.limited for side in (0, 1)]
    for name, rows in (
        ("tendon_limit", [_tendon_limit(model, fields, t, side) for t, side in limited]),
        (
            "tendon_friction",
            [_friction(model, fields, "tendon", slice(t.id, t.id + 1), "_fri") for t in plan.tendons if t.friction],
        ),
        ("equality", [_equality(model, fields, equality.id) for equality in plan.equalities]),
        *(
            (kind, [_closure(model, fields, c) for c in plan.closures if c.kind == kind])
            for kind in ("connect", "weld")
        ),
    ):
        if rows:
            put(name, rows)
    if geoms:
        put("geoms", [_placed_geom(model, fields, g) for g in geoms])
    for n, group in enumerate(between):
        named = [(geoms[a], geoms[b]) for a, b in zip(group.first, group.second, strict=True)]
        put(f"between{n}", [contact_parameters(model, fields, a, b, group.condim) for a, b in named])
    return table


def split_constants(table: Mapping[str, np.ndarray]) -> tuple[dict[str, list[Scalar]], dict[str, list[np.ndarray]]]:
    """Lists of the k constants, and of the k float64 arrays (N, C) or (N, G, C), by name of a parameter of `derive`."""
    constants: dict[str, list[Scalar]] = {}
    arrays: dict[str, list[np.ndarray]] = {}
    for key, value in table.items():
        if value.shape[:2] == (1, 1):
            constants[key] = [constant(value[0, 0, :, i]) for i in range(value.shape[-1])]
        else:
            lanes_last = np.moveaxis(value, 1, -1)  # (N, G, k, C)
            columns = [lanes_last[:, :, i] for i in range(value.shape[-1])]
            arrays[key] = [column[:, 0] if value.shape[2] == 1 else column for column in columns]
    return constants, arrays


class Parameters:
    """Parameters of one chunk while tracing: constants, and the arrays of one slice of the packed leaves."""

    def __init__(self, constants: Mapping[str, list[Scalar]], arrays: Mapping[str, list[jax.Array]]):
        self._constants, self._arrays = constants, arrays

    def __getitem__(self, key: str) -> list[Scalar]:
        return list(self._arrays[key]) if key in self._arrays else self._constants[key]

    def __contains__(self, key: str) -> bool:
        return key in self._arrays or key in self._constants

    def one(self, key: str) -> Scalar:
        """A parameter with a single component."""
        (value,) = self[key]
        return value

    def matrix(self, key: str) -> list[list[Scalar]]:
        """A parameter with nine components, as the three rows of a matrix."""
        nine = self[key]
        return [nine[0:3], nine[3:6], nine[6:9]]
