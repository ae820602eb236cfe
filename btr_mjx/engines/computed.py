"""What of MuJoCo the lanes engine computes, as tables: members of its enums, and fields of MjModel.

They list what is known. Whatever is in none of them, of this version of MuJoCo or of a later one, is refused: a member
wherever a model has it, a field wherever it has another value than a plain element of its kind.
"""

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache

import mujoco
import numpy as np

FLAGS: Mapping[str, tuple[str, str]] = {
    "opt.disableflags": (
        "mjtDisableBit",
        "CONSTRAINT EQUALITY FRICTIONLOSS LIMIT CONTACT SPRING DAMPER GRAVITY CLAMPCTRL WARMSTART FILTERPARENT "
        "ACTUATION REFSAFE SENSOR MIDPHASE EULERDAMP AUTORESET NATIVECCD ISLAND MULTICCD",
    ),
    "opt.enableflags": ("mjtEnableBit", "ENERGY FWDINV INVDISCRETE"),
    "actuator_ctrlspec": ("mjtCtrlInput", "POS VEL FF PRESSURE"),
}
"""Fields whose bits are members of an enum -> the enum, and the members that are computed."""

MEMBERS: Mapping[str, tuple[str, str]] = {
    "opt.integrator": ("mjtIntegrator", "EULER RK4 IMPLICITFAST"),
    "opt.cone": ("mjtCone", "PYRAMIDAL ELLIPTIC"),
    "opt.solver": ("mjtSolver", "PGS CG NEWTON"),
    "opt.jacobian": ("mjtJacobian", "DENSE SPARSE AUTO"),
    "jnt_type": ("mjtJoint", "FREE BALL SLIDE HINGE"),
    "geom_type": ("mjtGeom", "PLANE HFIELD SPHERE CAPSULE ELLIPSOID CYLINDER BOX MESH"),
    "actuator_trntype": ("mjtTrn", "JOINT JOINTINPARENT TENDON"),
    "actuator_dyntype": ("mjtDyn", "NONE INTEGRATOR FILTER FILTEREXACT PID"),
    "actuator_gaintype": ("mjtGain", "FIXED AFFINE PID"),
    "actuator_biastype": ("mjtBias", "NONE AFFINE"),
    "eq_type": ("mjtEq", "CONNECT WELD JOINT TENDON"),
    "eq_objtype": ("mjtObj", "UNKNOWN BODY SITE JOINT TENDON"),
    "wrap_type": ("mjtWrap", "JOINT"),
}
"""Fields whose values are members of an enum -> the enum, and the members that are computed or guarded."""

NUMBERS: Mapping[str, tuple[int, ...]] = {
    "actuator_ctrlnum": (1,),
    "actuator_outnum": (1,),
    "actuator_actnum": (0, 1),
    "geom_condim": (1, 3, 4, 6),
    "pair_dim": (1, 3, 4, 6),
}
"""Fields of other whole numbers -> those that are computed."""


CHOICES = (*FLAGS, *MEMBERS, *NUMBERS)
"""Fields of which single values are computed."""


def not_computed(field: str, value: int) -> str:
    """The name of what is not computed of a value of a field of `CHOICES`; empty if all is."""
    if field in NUMBERS:
        return "" if value in NUMBERS[field] else str(value)
    enum, words = {**FLAGS, **MEMBERS}[field]
    members = {int(member): name for name, member in getattr(mujoco, enum).__members__.items() if "_" in name}
    bits = [1 << k for k in range(value.bit_length()) if value >> k & 1] if field in FLAGS else [value]
    names = (members.get(bit, f"{enum} number {bit}") for bit in bits)
    return ", ".join(name for name in names if name.partition("_")[2] not in words.split())


def _names(table: Mapping[str, str]) -> frozenset[str]:
    return frozenset(f"{group}{field}" for group, fields in table.items() for field in fields.split())


VARYING = _names(
    {
        "body_": "mass subtreemass inertia ipos iquat pos quat invweight0",
        "geom_": "pos quat size friction solref solimp solmix margin",
        "jnt_": "axis pos range margin stiffness solref solimp actfrcrange",
        "dof_": "damping armature frictionloss invweight0 solref solimp",
        "actuator_": "gainprm biasprm dynprm gear ctrlrange forcerange actrange delay",
        "tendon_": "range margin frictionloss invweight0 length0 solref_lim solimp_lim solref_fri solimp_fri",
        "eq_": "data solref solimp",
        "site_": "pos quat",
        "opt.": "gravity wind density viscosity impratio",
        "": "qpos0 qpos_spring",
    }
)
"""Fields that are computed and may differ between worlds."""

_SAME = {*CHOICES} | _names(
    {
        "body_": "parentid rootid weldid mocapid jntnum jntadr dofnum dofadr treeid geomnum geomadr sameframe simple "
        "contype conaffinity gravcomp",
        "geom_": "contype conaffinity bodyid dataid priority sameframe gap fluid",
        "jnt_": "qposadr dofadr bodyid limited actfrclimited actgravcomp actuatorid",
        "dof_": "bodyid jntid parentid treeid Madr simplenum",
        "actuator_": "ctrladr outadr actadr trnid actlimited ctrllimited forcelimited history historyadr",
        "tendon_": "adr num limited stiffness damping lengthspring actuatorid treeid treenum",
        "eq_": "obj1id obj2id active0",
        "pair_": "geom1 geom2 signature solref solimp solreffriction friction margin gap adhesion",
        "exclude_": "signature",
        "wrap_": "objid prm",
        "site_": "bodyid sameframe",
        "opt.": "timestep",
    }
)
"""Fields that are computed, or guarded, and equal in all worlds."""

_SHAPES = ("mesh_", "hfield_")
"""Beginnings of the names of fields of shapes, for which bounds stand in guards."""

_WITHOUT_INFLUENCE = _names(
    {
        "body_": "margin bvhadr bvhnum",
        "geom_": "aabb rbound rgba matid group castshadow",
        "jnt_": "group",
        "dof_": "M0 length",
        "actuator_": "acc0 length0 lengthrange cranklength group",
        "tendon_": "width rgba matid group actfrcrange",
        "site_": "rgba matid group size type dataid",
        "opt.": "magnetic tolerance ls_tolerance ccd_tolerance noslip_tolerance sleep_tolerance iterations "
        "ls_iterations ccd_iterations sdf_iterations sdf_initpoints o_margin o_solref o_solimp o_friction",
        "": "names_map",
    }
)
"""Fields that do not influence the motion of a model that is not refused, or only through others."""

_SOLVER_PATTERNS = ("B_", "D_", "M_", "mapM2", "mapD2", "efm0_", "efmC_", "ten_J_", "tree_")
_DRAWN = ("cam_", "light_", "mat_", "tex_", "skin_", "name_", "bvh_", "oct_", "stat.", "vis.")
_READ = ("key_", "sensor_", "text_", "tuple_", "numeric_", "plugin_attr")
_GROUPS_WITHOUT_INFLUENCE = (*_SOLVER_PATTERNS, *_DRAWN, *_READ)
"""Beginnings of the names of such fields: patterns of sparse matrices, what is drawn, what is only read."""


def influences_motion(field: str) -> bool:
    """Whether a field may influence motion other than through fields that are derived from it; true if not known."""
    known = field in _WITHOUT_INFLUENCE or field.endswith("_user") or field.startswith(_GROUPS_WITHOUT_INFLUENCE)
    return not known


def may_differ(field: str, guards_geoms: bool) -> bool:
    """Whether worlds may differ in a field; those without influence may, and shapes where no geom is guarded."""
    if field.startswith(_SHAPES):
        return not (guards_geoms and field.startswith(("mesh_vert", "hfield_")))
    return field in VARYING or not influences_motion(field)


def base_field(model: mujoco.MjModel, field: str) -> np.ndarray:
    """A field of the model in float64; options are called "opt.<name>"."""
    owner = model.opt if field.startswith("opt.") else model
    return np.asarray(getattr(owner, field.removeprefix("opt.")), np.float64)


def not_plain(model: mujoco.MjModel) -> Iterator[tuple[str, int]]:
    """Fields that are in no table in which a model has an element that is not plain, and the number of the first one.

    Fields of a kind of element of which all is unknown are told once.
    """
    told: set[str] = set()
    for field, rows in _plain_rows().items():
        values = _elements(base_field(model, field))
        if not values.size:
            continue
        kind = field.partition("_")[0]
        if rows is None and kind not in told:
            told.add(kind)
            yield field, 0
        elif rows is not None:
            usual = [(values == row).all(1) for row in rows] if values.shape[1] == rows.shape[1] else []
            odd = np.flatnonzero(~np.any(usual, axis=0)) if usual else [0]
            if len(odd):
                yield field, int(odd[0])


def _elements(values: np.ndarray) -> np.ndarray:
    """Values of a field, (elements, k); an option is a single element."""
    values = values if values.ndim else values[None]
    return values.reshape(len(values), math.prod(values.shape[1:]))


@lru_cache(maxsize=1)
def _plain_rows() -> Mapping[str, np.ndarray | None]:
    """Field that is in no table -> its distinct values (n, k) of plain elements; None where there are no such."""
    plain = mujoco.MjModel.from_xml_string(_PLAIN)
    arrays = [name for name in dir(plain) if not name.startswith("_") and isinstance(getattr(plain, name), np.ndarray)]
    options = [f"opt.{name}" for name in dir(plain.opt) if not name.startswith("_")]
    table: dict[str, np.ndarray | None] = {}
    # Addresses come last: "springyield" tells a user more than where the compiler keeps the state that comes of it.
    for field in sorted(arrays + options, key=lambda name: name.endswith("adr")):
        if influences_motion(field) and field not in VARYING | _SAME and not field.startswith(_SHAPES):
            rows = np.unique(_elements(base_field(plain, field)), axis=0)
            table[field] = rows if rows.size else None
    return table


_PLAIN = """<mujoco><worldbody>
<body name="a"><joint name="a"/><geom name="a" size="1"/><site name="a"/></body>
<body name="b"><freejoint/><geom name="b" size="1"/></body></worldbody>
<contact><pair geom1="a" geom2="b"/><exclude body1="a" body2="b"/></contact>
<tendon><fixed name="a"><joint joint="a" coef="1"/></fixed></tendon>
<equality><joint joint1="a"/></equality>
<actuator><motor joint="a"/></actuator></mujoco>"""
"""Plain elements of every kind of which lanes computes something."""


_KINDS = {"jnt": "JOINT", "eq": "EQUALITY", "wrap": "TENDON"}
"""Beginnings of the names of fields, and the end of the name of their element's mjtObj where it is another word."""


def element_of(model: mujoco.MjModel, field: str, index: int) -> str:
    """The element of a field, " (joint 'knee')"; empty for options and for kinds of elements without names."""
    word = field.partition("_")[0]
    kind = getattr(mujoco.mjtObj, f"mjOBJ_{_KINDS.get(word, word.upper())}", None)
    if kind is None:
        return ""
    if field.startswith("wrap_"):
        index = next(t for t in range(model.ntendon) if index in wraps_of(model, t))
    return f" ({element_name(model, kind, index)})"


def element_name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """An element's kind and its name in quotes, or its number if it has none."""
    label = mujoco.mj_id2name(model, kind, int(index))
    word = kind.name.removeprefix("mjOBJ_").lower()
    return f"{word} {label!r}" if label else f"{word} number {index}"


def wraps_of(model: mujoco.MjModel, tendon: int) -> range:
    """Numbers of the wrap objects of a tendon."""
    return range(int(model.tendon_adr[tendon]), int(model.tendon_adr[tendon] + model.tendon_num[tendon]))
