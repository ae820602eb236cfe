"""Write the fields of an edited compiled model back into its `mujoco.MjSpec`, so that the edit becomes MJCF.

An effect edits fields of `MjModel`. The fields in which the edited model differs from the base model are copied to the
elements of the specification (joints, geoms, bodies, actuators, options) from which the compiler computes them.
"""

from pathlib import Path

import mujoco
import numpy as np
import scipy

from btr_mjx.gap.effects import rotation_matrix
from btr_mjx.gap.simulate import World, differing_fields

_UNSET = float("nan")

_ROUNDING = 2e-5
"""Part by which the largest moment of inertia stays below the sum of the others: numbers in XML have six digits."""

DERIVED = (
    "actuator_delay",  # an edit of the command in a world; see `Effect.native`
    "actuator_acc0",
    "actuator_length0",
    "body_invweight0",
    "body_subtreemass",
    "body_sameframe",
    "dof_M0",
    "dof_invweight0",
    "dof_length",
    "geom_aabb",
    "geom_rbound",
    "geom_sameframe",
    "jnt_actgravcomp",
    "site_sameframe",
    "tendon_invweight0",
    "tendon_length0",
    "ten_J",
)
"""Fields that the compiler computes from other fields, or that are written by other means."""

_WRITTEN = {
    "actuator": ("gainprm", "biastype", "biasprm", "forcerange", "forcelimited", "gear", "ctrlrange"),
    "body": ("gravcomp", "pos"),
    "geom": ("friction", "solref", "solimp", "condim", "priority", "solmix", "margin", "gap", "pos", "quat", "size"),
    "pair": ("friction", "solref", "solimp"),
    "site": ("pos",),
}
"""Fields that elements of a specification have under the same name, by kind."""
_OPTION = ("gravity", "wind", "density", "viscosity", "impratio")
_BODY_INERTIA = ("body_mass", "body_ipos", "body_iquat", "body_inertia")


def normalised(source: str | Path | mujoco.MjSpec) -> mujoco.MjSpec:
    """A specification in MuJoCo's own form: radians, poses and inertias as the compiler found them.

    Values that the compiler would compute again from an edited model are made explicit: velocity gains that follow from
    a damping ratio, masses that are scaled to a total.

    Args:
      source: MJCF text, a file, or a specification, which is changed; meshes and textures of the last two are then
        referred to by absolute paths.

    Returns:
      The compiled specification.
    """
    if isinstance(source, str):
        spec = mujoco.MjSpec.from_string(source)
    else:
        spec = mujoco.MjSpec.from_file(str(source)) if isinstance(source, Path) else source
        folder = source.resolve().parent if isinstance(source, Path) else Path(spec.modelfiledir or ".").resolve()
        if [*spec.meshes, *spec.hfields, *spec.skins]:
            spec.meshdir = str(folder / spec.meshdir)
        if [*spec.textures]:
            spec.texturedir = str(folder / spec.texturedir)
    model = spec.compile()
    spec = mujoco.MjSpec.from_string(spec.to_xml())
    for body in spec.bodies[1:]:
        body.simple = 0  # as in the search: effects edit inertia, which MuJoCo's simple bodies do not allow
    again = spec.compile()
    if (
        spec.compiler.settotalmass > 0
        or spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    ):
        spec.compiler.settotalmass = -1
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        for body in spec.bodies:
            if body.id > 0:
                _write_inertia(body, model, model)
    for actuator in spec.actuators:
        if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE:
            actuator.gainprm = again.actuator_gainprm[actuator.id]
            actuator.biasprm = again.actuator_biasprm[actuator.id]
    spec.compile()
    return spec


def write_changes(spec: mujoco.MjSpec, world: World, base: mujoco.MjModel) -> list[str]:
    """Write every field in which a world's model differs from the base model into the specification of the base.

    The specification comes from `normalised` and is edited in place; the caller compiles it.

    Returns:
      Names of fields that differ and that a specification cannot express.
    """
    changed = differing_fields(world, base)
    model = world.model
    left = []
    for name in changed:
        if name.startswith(DERIVED) or name in _BODY_INERTIA:
            continue
        rows = _rows(getattr(model, name), getattr(base, name)) if "." not in name else []
        if not _write(spec, name, rows, model, base):
            left.append(name)
    if not set(changed).isdisjoint(_BODY_INERTIA):
        for body in spec.bodies:
            if any(not np.array_equal(getattr(model, f)[body.id], getattr(base, f)[body.id]) for f in _BODY_INERTIA):
                _write_inertia(body, model, base)
    return left


def _rows(ours: np.ndarray, theirs: np.ndarray) -> list[int]:
    """Rows of a field in which two models differ."""
    different = ours != theirs
    return np.flatnonzero(different.reshape(len(different), -1).any(axis=1)).tolist()


def _write(spec: mujoco.MjSpec, name: str, rows: list[int], model: mujoco.MjModel, base: mujoco.MjModel) -> bool:
    """Write the changed rows of one field; False if a specification cannot express them."""
    kind, _, attribute = name.partition("_")
    if name.startswith("opt."):
        attribute = name[4:]
        if attribute in _OPTION:
            setattr(spec.option, attribute, getattr(model.opt, attribute))
        return attribute in _OPTION
    if kind in ("dof", "jnt", "qpos0", "qpos"):
        return _write_joints(spec, name, rows, model)
    if attribute not in _WRITTEN.get(kind, ()):
        return False
    values, before = getattr(model, name), getattr(base, name)
    for element in getattr(spec, {"body": "bodies"}.get(kind, f"{kind}s")):
        if element.id in rows:
            value = values[element.id]
            if attribute == "pos":  # the compiled place of a mesh is its centre
                value = element.pos + value - before[element.id]
            setattr(element, attribute, value.item() if value.ndim == 0 else value)
    return True


def _write_joints(spec: mujoco.MjSpec, name: str, rows: list[int], model: mujoco.MjModel) -> bool:
    joints, field = {int(joint.id): joint for joint in spec.joints}, getattr(model, name)
    if name in ("qpos0", "qpos_spring"):
        of = {int(a): j for j, a in enumerate(model.jnt_qposadr)}
        scalar = [of[r] for r in rows if r in of and model.jnt_type[of[r]] >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
        for j in scalar:
            setattr(joints[j], "ref" if name == "qpos0" else "springref", float(field[model.jnt_qposadr[j]]))
        return len(scalar) == len(rows)
    kind, _, attribute = name.partition("_")
    for j in sorted({int(j) for j in model.dof_jntid[rows]} if kind == "dof" else rows):
        joint, dof = joints[j], int(model.jnt_dofadr[j])
        if name in ("dof_damping", "dof_dampingpoly"):
            joint.damping = np.r_[model.dof_damping[dof], model.dof_dampingpoly[dof]]
        elif name in ("jnt_stiffness", "jnt_stiffnesspoly"):
            joint.stiffness = np.r_[model.jnt_stiffness[j], model.jnt_stiffnesspoly[j]]
        elif name in ("dof_frictionloss", "dof_armature"):
            setattr(joint, attribute, float(field[dof]))
        elif name in ("jnt_range", "jnt_axis"):
            setattr(joint, attribute, field[j])
        else:
            return False
    return True


def _write_inertia(body: mujoco.MjsBody, model: mujoco.MjModel, base: mujoco.MjModel) -> None:
    """Write mass, centre and moments of a body, about principal axes in the order of the base model."""
    body.explicitinertial = True
    body.mass = float(model.body_mass[body.id])
    body.ipos = model.body_ipos[body.id]
    moments, body.iquat = nearest_axes(model, base, body.id)
    least, middle, most = np.argsort(moments)
    moments[least] = max(moments[least], (1 + _ROUNDING) * moments[most] - moments[middle])
    body.inertia = moments
    body.fullinertia = [_UNSET, 0, 0, 0, 0, 0]


def nearest_axes(model: mujoco.MjModel, base: mujoco.MjModel, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,) of a body, and the orientation (4,) of their axes, in the order of another model.

    Axes of inertia have neither order nor sign: of the 24 ways to name them, the one is taken that turns those of the
    other model least.
    """
    turns = [rotation_matrix(own.body_iquat[body]) for own in (model, base)]
    alike = turns[1].T @ turns[0]  # of each axis of the base (row) with each of the model's (column)
    _, order = scipy.optimize.linear_sum_assignment(-np.abs(alike))
    axes = turns[0][:, order] * np.where(alike[np.arange(3), order] < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, np.argmin(np.abs(alike[np.arange(3), order]))] *= -1
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.flatten())
    return model.body_inertia[body][order].copy(), quaternion
