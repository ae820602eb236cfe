"""Names of a model's parts, and paths to single numbers in a model.

A path names one number of a model, with the names of the MJCF file:

    joint:knee/damping      an attribute of a named part: joint, body, geom, actuator, site or tendon
    geom:foot/friction[1]   one component of a vector; without an index the first
    option/density          an attribute of <option>
    dof_damping[3]          a field of physical numbers of the compiled `mujoco.MjModel`, by index: dof_damping[3],
                            geom_friction[2][0]; see `model_checks.FLOAT_FIELDS`

`joint/knee/damping`, `joint:knee.damping` and `joint[@name='knee']/@damping` mean the same as the first line.

A change of `body:<name>/mass` scales the body's inertia by the same factor, as a change of density does. `set_values`
also updates the constants that MuJoCo derives from the changed numbers (mj_setConst).
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models.model_checks import DERIVED_FIELDS, FLOAT_FIELDS, check_model

KINDS: Mapping[str, tuple[mujoco.mjtObj, str]] = {
    "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
    "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nactuator"),
    "site": (mujoco.mjtObj.mjOBJ_SITE, "nsite"),
    "tendon": (mujoco.mjtObj.mjOBJ_TENDON, "ntendon"),
    "sensor": (mujoco.mjtObj.mjOBJ_SENSOR, "nsensor"),
}
"""Kinds of named parts, and the field of MjModel that counts them."""

_DOF = {"damping": "dof_damping", "armature": "dof_armature", "frictionloss": "dof_frictionloss"}
ATTRIBUTES: Mapping[str, Mapping[str, str]] = {
    "joint": {**_DOF, "stiffness": "jnt_stiffness", "range": "jnt_range", "pos": "jnt_pos", "axis": "jnt_axis"}
    | {"springref": "qpos_spring", "margin": "jnt_margin", "actuatorfrcrange": "jnt_actfrcrange"},
    "body": {"mass": "body_mass", "pos": "body_pos", "quat": "body_quat", "gravcomp": "body_gravcomp"}
    | {"ipos": "body_ipos", "diaginertia": "body_inertia"},
    "geom": {"friction": "geom_friction", "solref": "geom_solref", "solimp": "geom_solimp", "margin": "geom_margin"}
    | {"gap": "geom_gap", "pos": "geom_pos", "size": "geom_size"},
    "actuator": {"kp": "", "kv": "", "ki": "", "gear": "actuator_gear", "forcerange": "actuator_forcerange"}
    | {"ctrlrange": "actuator_ctrlrange", "gainprm": "actuator_gainprm", "biasprm": "actuator_biasprm"}
    | {"dynprm": "actuator_dynprm"},
    "site": {"pos": "site_pos"},
    "tendon": {"damping": "tendon_damping", "stiffness": "tendon_stiffness", "frictionloss": "tendon_frictionloss"}
    | {"armature": "tendon_armature"},
    "option": {name: "" for name in ("timestep", "gravity", "wind", "density", "viscosity")},
}
"""Kind -> attribute -> field of MjModel ("" where the attribute has no field of its own)."""

_ADDRESSES = {"ctrlrange": "actuator_ctrladr", "gear": "actuator_outadr"}
"""Attributes of which an actuator has one for each of its controls or outputs -> where its first one is."""

_PATH = re.compile(
    r"^(?P<kind>[a-z]+)(?:\[@name=['\"](?P<quoted>.*)['\"]\]|[:/](?P<name>.+))[/.]@?(?P<attribute>[a-z]+)$"
)
_INDEX = re.compile(r"^(?P<head>.*?)(?P<index>(?:\[[0-9]{1,9}\])+)$")
_SHARED_LENGTH = "; a length that several elements share is a variable of a template (docs/robot_file.md)"
_LONGEST = 400
"""Characters of a path."""


def nearest_names(name: str, known: Sequence[str], count: int = 3) -> str:
    """The known names most similar to `name`, quoted and joined, for error messages; the first ones if none is."""
    if not known:
        return "none"
    known = [k[:200] for k in list(known)[:2000]]  # the comparison takes the product of the lengths
    close = difflib.get_close_matches(name[:200], known, count, 0.4)
    return ", ".join(repr(k) for k in (close or list(known)[: 2 * count]))


def refuse_unknown_keys(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    """InputError for a key of a TOML table that is not known."""
    for key in table:
        if key not in known:
            near = nearest_names(key, known)
            raise InputError(f"{where}: unknown key {key!r}; nearest: {near}; valid keys: {', '.join(known)}")


def part_names(model: mujoco.MjModel, kind: str) -> list[str]:
    """Names of all parts of a kind, in the model's order.

    A part without a name is called by another unique name: a joint by its body's, an actuator by its joint's, else
    "<kind><index>".

    Raises:
      InputError: an unknown kind.
    """
    if kind not in KINDS:
        raise InputError(f"kind of part {kind!r}: expected one of {', '.join(KINDS)}")
    what, count = KINDS[kind]
    names = [mujoco.mj_id2name(model, what, i) or "" for i in range(getattr(model, count))]
    for i, name in enumerate(names):
        if name:
            continue
        other = ""
        if kind == "joint":
            other = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, int(model.jnt_bodyid[i])) or ""
        elif kind == "actuator" and model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT:
            other = part_names(model, "joint")[int(model.actuator_trnid[i, 0])]
        names[i] = other if other and other not in names else f"{kind}{i}"
    return names


def control_names(model: mujoco.MjModel) -> list[str]:
    """Names of the nu controls: of an actuator with a single one its own, else "<name>/0", "<name>/1", ..."""
    controls = zip(part_names(model, "actuator"), model.actuator_ctrlnum.tolist(), strict=True)
    return [name if count == 1 else f"{name}/{i}" for name, count in controls for i in range(count)]


def refuse_several_controls(model: mujoco.MjModel, where: str) -> None:
    """Check that every actuator has one control and one output, as most code takes for granted.

    Raises:
      InputError: the message names the actuator.
    """
    for a, name in enumerate(part_names(model, "actuator")):
        controls, outputs = int(model.actuator_ctrlnum[a]), int(model.actuator_outnum[a])
        if controls != 1 or outputs != 1:
            raise InputError(
                f"{where}: the actuator {name!r} has {controls} controls and {outputs} outputs; expected one of each: "
                'give a <pid> input="pos", and others as several actuators'
            )


@dataclass(frozen=True)
class ModelPath:
    """A number of a model.

    Attributes:
      text: the path as it was given.
      kind: "joint", ..., "option", or "" for a field of MjModel.
      part: index of the part; 0 for an option.
      attribute: the attribute's or the field's name.
      index: indices into the attribute's or the field's array.
    """

    text: str
    kind: str
    part: int
    attribute: str
    index: tuple[int, ...]

    def read(self, model: mujoco.MjModel) -> float:
        """The value of the number in a model."""
        array, sign = self._view(model)
        return float(sign * array[self.index])

    def write(self, model: mujoco.MjModel, value: float) -> None:
        """Set the number in a model. Derived constants are not updated: call `mujoco.mj_setConst` after the last write.

        Raises:
          InputError: a value that is not finite, or a mass that is not positive.
        """
        if not np.isfinite(value):
            raise InputError(f"{self.text}: got {value}, expected a finite number")
        if (self.kind, self.attribute) == ("body", "mass"):
            old = model.body_mass[self.part]
            if value <= 0 or old <= 0:
                raise InputError(f"{self.text}: got {value} instead of {old}, expected two positive masses")
            model.body_inertia[self.part] *= value / old
        if (self.kind, self.attribute) == ("option", "timestep"):
            model.opt.timestep = value
            return
        if self.kind == "option" and self.attribute in ("density", "viscosity"):
            setattr(model.opt, self.attribute, value)
            return
        array, sign = self._view(model)
        array[self.index] = sign * value
        pid = self.kind == "actuator" and model.actuator_gaintype[self.part] == mujoco.mjtGain.mjGAIN_PID
        if (self.kind, self.attribute) == ("actuator", "kp") and not pid:
            model.actuator_gainprm[self.part, 0] = value
        if (self.kind, self.attribute) == ("actuator", "forcerange"):
            model.actuator_forcelimited[self.part] = 1
        if (self.kind, self.attribute) == ("joint", "damping"):
            model.dof_damping[self._dofs(model)] = value
        if self.kind == "joint" and self.attribute in ("armature", "frictionloss"):
            getattr(model, f"dof_{self.attribute}")[self._dofs(model)] = value

    def _dofs(self, model: mujoco.MjModel) -> slice:
        first = int(model.jnt_dofadr[self.part])
        return slice(first, first + int(np.sum(model.dof_jntid == self.part)))

    def _view(self, model: mujoco.MjModel) -> tuple[np.ndarray, float]:
        """An array that `index` points into, and the sign of the number in it."""
        if not self.kind:
            return getattr(model, self.attribute), 1.0
        if self.kind == "option":
            return np.atleast_1d(np.asarray(getattr(model.opt, self.attribute))), 1.0
        if self.kind == "actuator" and self.attribute in ("kp", "kv"):
            return model.actuator_biasprm[self.part, {"kp": 1, "kv": 2}[self.attribute] :], -1.0
        if self.kind == "actuator" and self.attribute == "ki":
            return model.actuator_gainprm[self.part], 1.0
        field = getattr(model, ATTRIBUTES[self.kind][self.attribute])
        row = self.part
        if self.kind == "joint" and self.attribute in _DOF:
            row = int(model.jnt_dofadr[self.part])
        elif self.kind == "joint" and self.attribute == "springref":
            row = int(model.jnt_qposadr[self.part])
        elif self.kind == "actuator" and self.attribute in _ADDRESSES:
            row = int(getattr(model, _ADDRESSES[self.attribute])[self.part])
        return np.atleast_1d(field[row : row + 1] if field.ndim == 1 else field[row]), 1.0


def parse_path(model: mujoco.MjModel, text: str) -> ModelPath:
    """The number that a path names.

    Args:
      model: the model.
      text: the path, see the module's notes.

    Raises:
      InputError: bad syntax, or a part, attribute, field or index that the model lacks; the message has the nearest
        ones.
    """
    if len(text) > _LONGEST:
        raise InputError(f"path {text[:40]!r}...: has {len(text)} characters, at most {_LONGEST} are read")
    match = _INDEX.match(text.strip())
    head, index = (match["head"], match["index"]) if match else (text.strip(), "")
    numbers = tuple(int(n) for n in re.findall(r"\d+", index))
    if head.startswith("option/"):
        head = "option:x/" + head.removeprefix("option/")
    found = _PATH.match(head)
    if found is None:
        if head in FLOAT_FIELDS or head in DERIVED_FIELDS:
            path = ModelPath(text, "", 0, head, numbers)
        elif head.isidentifier() and (index or hasattr(model, head)):
            raise InputError(
                f"path {text!r}: MjModel has no array {head!r} of physical numbers that may be set; nearest: "
                f"{nearest_names(head, FLOAT_FIELDS)}"
            )
        else:
            raise InputError(
                f"path {text!r}: expected KIND:NAME/ATTRIBUTE such as 'joint:knee/damping', or a field of MjModel such "
                "as 'dof_damping[3]'"
            )
    else:
        kind, name, attribute = found["kind"], found["quoted"] or found["name"], found["attribute"]
        if kind not in ATTRIBUTES:
            raise InputError(f"path {text!r}: there is no kind {kind!r}; expected one of {', '.join(ATTRIBUTES)}")
        names = ["x"] if kind == "option" else part_names(model, kind)
        if name not in names:
            raise InputError(f"path {text!r}: the model has no {kind} {name!r}; nearest: {nearest_names(name, names)}")
        if attribute not in ATTRIBUTES[kind]:
            known = ", ".join(ATTRIBUTES[kind])
            more = "" if attribute != "fromto" else _SHARED_LENGTH
            raise InputError(f"path {text!r}: a {kind}'s attributes here are {known}; got {attribute!r}{more}")
        path = ModelPath(text, kind, names.index(name), attribute, numbers or (0,))
    try:
        value = path.read(model)
    except (IndexError, TypeError):
        raise InputError(f"path {text!r}: the index does not point at a single number of {path.attribute}") from None
    if not np.isfinite(value):
        raise InputError(f"path {text!r}: the model's own value is {value}")
    return path


def set_values(model: mujoco.MjModel, values: Mapping[str, float]) -> None:
    """Set numbers of a model by path in place, and update its derived constants (mj_setConst).

    Raises:
      InputError: see `parse_path` and `ModelPath.write`.
    """
    for text, value in values.items():
        parse_path(model, text).write(model, float(value))
    check_model(model, "with these values")
    mujoco.mj_setConst(model, mujoco.MjData(model))


def dof_places(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Where the generalised force of every degree of freedom (nv,) acts, in words, and its unit."""
    joints, bodies = part_names(model, "joint"), part_names(model, "body")
    out = []
    for joint, kind in enumerate(model.jnt_type.tolist()):  # MuJoCo's enumerations equal int, not numpy's integers
        where = f"joint {joints[joint]}"
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            where = f"body {bodies[model.jnt_bodyid[joint]]}"
            out += [(f"{where}, force along {axis}", "N") for axis in "xyz"]
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            out += [(f"{where}, torque about {axis}", "N m") for axis in "xyz"]
        else:
            out.append((where, "N" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "N m"))
    return out
