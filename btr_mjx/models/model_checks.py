"""Checks of a compiled model's numbers: MuJoCo accepts a mass of NaN and a time step of -1 s."""

from collections.abc import Mapping

import mujoco
import numpy as np

from btr_mjx.errors import InputError

TIMESTEPS = (1e-6, 1.0)
"""Shortest and longest time step that is accepted [s]."""

LARGEST = 1e15
"""Largest number of a model in SI units; beyond it products overflow."""

COMPILE_ERRORS = (ValueError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError)
"""What MuJoCo raises for a model that it cannot compile or allocate."""

NOT_NEGATIVE = (
    *("body_mass", "body_inertia", "geom_size", "geom_friction", "actuator_armature", "actuator_damping"),
    *("dof_armature", "dof_damping", "dof_frictionloss"),
    *("tendon_armature", "tendon_damping", "tendon_frictionloss"),
    *("opt.density", "opt.viscosity", "opt.tolerance", "opt.ls_tolerance", "opt.impratio"),
)
"""Numbers that are 0 or more."""

FLOAT_FIELDS = (
    *("qpos0", "qpos_spring", "jnt_pos", "jnt_axis", "jnt_stiffness", "jnt_margin", "jnt_solref", "jnt_solimp"),
    *("jnt_range", "jnt_actfrcrange", "dof_armature", "dof_damping", "dof_frictionloss", "dof_solref", "dof_solimp"),
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "body_gravcomp"),
    *("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_margin", "geom_gap", "geom_solref", "geom_solimp"),
    *("geom_solmix", "geom_fluid", "site_pos", "site_quat", "eq_data", "eq_solref", "eq_solimp", "pair_solref"),
    *("pair_friction", "pair_solimp", "pair_margin", "pair_gap", "tendon_stiffness", "tendon_damping"),
    *("tendon_armature", "tendon_frictionloss", "tendon_range", "tendon_actfrcrange", "tendon_lengthspring"),
    *("tendon_margin", "tendon_solref_lim", "tendon_solimp_lim", "wrap_prm", "actuator_gear", "actuator_gainprm"),
    *("actuator_biasprm", "actuator_dynprm", "actuator_ctrlrange", "actuator_forcerange", "actuator_actrange"),
    *("actuator_cranklength", "actuator_lengthrange", "actuator_armature", "actuator_damping"),
)
"""Fields of MjModel that hold physical numbers: those that a path may name by index, and that are checked. Fields of
indices, types and addresses are not among them; MuJoCo reads memory that is not its own where they are wrong."""

DERIVED_FIELDS = (
    *("body_invweight0", "body_subtreemass", "dof_M0", "dof_invweight0", "dof_length", "geom_aabb", "geom_rbound"),
    *("actuator_acc0", "actuator_length0", "tendon_length0", "tendon_invweight0"),
    *("jnt_stiffnesspoly", "dof_dampingpoly", "tendon_stiffnesspoly", "tendon_dampingpoly"),
)
"""Fields that a path may name as well, most of which mj_setConst computes from the others."""

_ALSO_CHECKED = (
    *("key_qpos", "key_qvel", "key_act", "key_ctrl", "actuator_delay", "sensor_delay", "sensor_interval"),
    *("dof_dampingpoly", "jnt_stiffnesspoly", "tendon_dampingpoly", "tendon_stiffnesspoly", "actuator_dampingpoly"),
    *("geom_surfacevel", "geom_adhesion", "body_margin", "site_size", "hfield_size", "flex_damping", "flex_friction"),
    *("flex_stiffness", "flex_margin", "flex_gap", "flex_solref", "flex_solimp", "flex_radius"),
)
"""Further fields that are checked; they need not exist in every version of MuJoCo."""

_OPTIONS = ("gravity", "wind", "density", "viscosity", "impratio", "tolerance", "ls_tolerance")
_WITH_INFINITY = ("range", "lengthspring")


def physical_numbers(model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
    """The numbers that are checked: fields by name, and options as "opt.<name>"."""
    names = (*FLOAT_FIELDS, *_ALSO_CHECKED)
    found = {name: getattr(model, name) for name in names if isinstance(getattr(model, name, None), np.ndarray)}
    options = {f"opt.{name}": np.atleast_1d(np.asarray(getattr(model.opt, name), float)) for name in _OPTIONS}
    return found | options


def check_model(model: mujoco.MjModel, where: str) -> None:
    """Check that the numbers of a compiled model can be simulated.

    Raises:
      InputError: a time step outside `TIMESTEPS`, a number that is not finite, larger than `LARGEST`, or negative where
        it cannot be.
    """
    low, high = TIMESTEPS
    if not low <= model.opt.timestep <= high:
        raise InputError(f"{where}: timestep = {model.opt.timestep:g} s: expected {low:g} to {high:g} s")
    numbers = physical_numbers(model)
    flat = np.concatenate([values.ravel() for values in numbers.values()])
    signed = np.concatenate([numbers[name].ravel() for name in NOT_NEGATIVE if name in numbers])
    if (np.abs(flat) <= LARGEST).all() and (signed >= 0).all():
        return  # the common case, several times faster than field by field
    for name, values in numbers.items():
        bad = np.isnan(values) if name.endswith(_WITH_INFINITY) else ~(np.abs(values) <= LARGEST)
        if name in NOT_NEGATIVE:
            bad = bad | (values < 0)
        if bad.any():
            place = tuple(int(i) for i in np.argwhere(bad)[0])
            wanted = "a number of 0 or more" if name in NOT_NEGATIVE else "a finite number"
            index = "".join(f"[{i}]" for i in place)
            raise InputError(
                f"{where}: {name}{index}{_part(model, name, place)} = {float(values[place]):g}: expected {wanted}, at "
                f"most {LARGEST:g}"
            )


def _part(model: mujoco.MjModel, name: str, place: tuple[int, ...]) -> str:
    """' (body 'arm')' where the number belongs to a named part."""
    kind = name.split("_")[0]
    kinds = {"body": "BODY", "geom": "GEOM", "jnt": "JOINT", "site": "SITE", "tendon": "TENDON", "actuator": "ACTUATOR"}
    index = place[0]
    if kind == "dof":
        kind, index = "jnt", int(model.dof_jntid[index])
    if kind not in kinds:
        return ""
    found = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kinds[kind]}"), index)
    return f" ({kinds[kind].lower()} {found!r})" if found else ""
