"""Numbers that a mended model has instead of those of the believed one, with names of physical quantities.

Moments of inertia are compared as tensors in the axes of their body: which principal axis is called the first one is no
property of a robot.
"""

from typing import Any

import mujoco
import numpy as np

from btr_mjx.exports import field_ends
from btr_mjx.gap.effects import MassProperties
from btr_mjx.gap.results.transcribe import DERIVED
from btr_mjx.models import part_names

_ROUNDING = 1e-5
"""Part of the largest number of a body's inertia below which a difference is one of digits: XML has six."""

_INERTIA = ("body_mass", "body_ipos", "body_iquat", "body_inertia")
"""Fields that are told as mass properties of their body."""

_PARTS = {"jnt": "joint", "body": "body", "geom": "geom", "site": "site", "actuator": "actuator", "tendon": "tendon"}
"""Kinds of parts by the beginning of the names of their fields."""

_TURNING, _SLIDING = (
    {"damping": "N m s/rad", "frictionloss": "N m", "armature": "kg m^2", "stiffness": "N m/rad"},
    {
        "damping": "N s/m",
        "frictionloss": "N",
        "armature": "kg",
        "stiffness": "N/m",
    },
)
"""Units of numbers of hinges and of slides."""

_QUANTITIES = {
    "dof_damping": "viscous damping",
    "dof_frictionloss": "dry friction",
    "dof_armature": "rotor inertia",
    "jnt_stiffness": "stiffness of the spring",
    "qpos_spring": "rest position of the spring",
    "qpos0": "reference position",
    "jnt_range": "range",
    "body_gravcomp": "gravity compensation",
    "body_pos": "position",
    "geom_friction": "friction",
    "geom_size": "size",
    "geom_pos": "position",
    "actuator_gainprm": "gain",
    "actuator_biasprm": "bias",
    "actuator_gear": "gear ratio",
    "actuator_forcerange": "limit of the force",
    "actuator_ctrlrange": "range of the command",
}
"""Fields in words."""

_LENGTHS = ("body_pos", "geom_size", "geom_pos", "site_pos")
"""Fields in metres."""


def changed_numbers(believed: mujoco.MjModel, mended: mujoco.MjModel) -> tuple[dict[str, Any], ...]:
    """Numbers that a mended model has instead of those of the believed one, without those that MuJoCo derives.

    Args:
      believed: the model before.
      mended: a model of the same structure.

    Returns:
      For each number `what` it is, such as "mass of body hand", its values `believed` and `mended`, the change in
      `percent` (None where it was 0), `unit`, and the `field` of MjModel with indices; "" of inertia.
    """
    out = []
    for body in range(1, believed.nbody):
        out += _mass_properties(believed, mended, body)
    for path, (before, after) in field_ends(believed, mended).items():
        field, _, rest = path.partition("[")
        if field not in (*DERIVED, *_INERTIA):
            what, unit = _quantity(believed, field, [int(index) for index in rest.replace("]", "").split("[") if index])
            out.append(_change(what, unit, before, after, path))
    return tuple(out)


def _change(what: str, unit: str, before: float, after: float, field: str = "") -> dict[str, Any]:
    percent = 100 * (after - before) / abs(before) if before else None
    return {"what": what, "unit": unit, "believed": before, "mended": after, "percent": percent, "field": field}


def _mass_properties(believed: mujoco.MjModel, mended: mujoco.MjModel, body: int) -> list[dict[str, Any]]:
    """Changes of mass, centre of mass and inertia of a body."""
    before, after = (MassProperties.of(model, body) for model in (believed, mended))
    name = f"body {part_names(believed, 'body')[body]}"
    out = []
    if abs(after.mass - before.mass) > _ROUNDING * max(before.mass, after.mass):
        out.append(_change(f"mass of {name}", "kg", before.mass, after.mass, f"body_mass[{body}]"))
    size = float(np.abs([before.centre, after.centre]).max())
    for i, axis in enumerate("xyz"):
        if abs(after.centre[i] - before.centre[i]) > _ROUNDING * size:
            ends = float(before.centre[i]), float(after.centre[i])
            out.append(_change(f"centre of mass of {name} along {axis}", "m", *ends, f"body_ipos[{body}][{i}]"))
    size = float(np.abs([before.inertia, after.inertia]).max())
    for i, first in enumerate("xyz"):
        for j, second in list(enumerate("xyz"))[i:]:
            ends = float(before.inertia[i, j]), float(after.inertia[i, j])
            if abs(ends[1] - ends[0]) > _ROUNDING * size:
                what = f"inertia of {name} about {first}" if i == j else f"product of inertia {first}{second} of {name}"
                out.append(_change(what, "kg m^2", *ends))
    return out


def _quantity(model: mujoco.MjModel, field: str, indices: list[int]) -> tuple[str, str]:
    """A number of a model in words, and its unit; "" where it depends."""
    kind, _, attribute = field.partition("_")
    what, index = _QUANTITIES.get(field, attribute.replace("_", " ") or field), indices[0] if indices else 0
    which = f", number {indices[1] + 1}" if len(indices) > 1 else ""
    unit = "m" if field in _LENGTHS else ""
    if kind in ("dof", "jnt") or field in ("qpos0", "qpos_spring"):
        joint = index if kind == "jnt" else _joint_of(model, field, index)
        is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        unit = (_SLIDING if is_slide else _TURNING).get(attribute, "m" if is_slide else "rad")
        return f"{what} of joint {part_names(model, 'joint')[joint]}{which}", unit
    if kind in _PARTS:
        named = model.names[getattr(model, f"name_{kind}adr")[index] :].split(b"\0", 1)[0].decode()
        return f"{what} of {_PARTS[kind]} {named or index}{which}", unit
    return f"{field.removeprefix('option/').replace('_', ' ')}{which}", unit


def _joint_of(model: mujoco.MjModel, field: str, index: int) -> int:
    """The joint of a degree of freedom, or of an entry of the configuration."""
    if field.startswith("dof"):
        return int(model.dof_jntid[index])
    return int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
