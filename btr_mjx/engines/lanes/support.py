"""Check of which models the lanes engine supports; unsupported features raise an error that names them."""

import mujoco
import numpy as np

from btr_mjx.engines.base import UnsupportedModel

SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)

_JOINT, _DYN, _GAIN, _BIAS = mujoco.mjtJoint, mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit


def refuse(feature: str) -> UnsupportedModel:
    """The error for a feature that this engine does not compute."""
    return UnsupportedModel(f'the lanes engine does not compute {feature}; use engine="mjx" for this model')


def name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """An element's name in quotes, or its number if it has none."""
    label = mujoco.mj_id2name(model, kind, int(index))
    word = kind.name.removeprefix("mjOBJ_").lower()
    return f"{word} {label!r}" if label else f"{word} number {index}"


def disabled(model: mujoco.MjModel, flag: str) -> bool:
    """Whether a disable flag of the options is set, by its mjDSBL name."""
    return bool(model.opt.disableflags & int(getattr(_DISABLE, f"mjDSBL_{flag}")))


def require_supported(model: mujoco.MjModel) -> dict[int, list[tuple[int, int]]]:
    """Check that this engine supports a model.

    Returns:
      Geom -> (plane geom, condim) of each possible contact.

    Raises:
      UnsupportedModel: the message names the feature and the element that uses it.
    """
    _check_options(model)
    _check_elements(model)
    _check_joints(model)
    _check_actuators(model)
    return _contact_pairs(model)


def _check_options(m: mujoco.MjModel) -> None:
    integrators = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
    if m.opt.integrator not in integrators:
        raise refuse(f"the {mujoco.mjtIntegrator(m.opt.integrator).name} integrator (only Euler and implicitfast)")
    for flag in ("OVERRIDE", "SLEEP", "DIAGEXACT", "IPC"):
        bit = getattr(_ENABLE, f"mjENBL_{flag}", None)
        if bit is not None and m.opt.enableflags & int(bit):
            raise refuse(f"the enable flag {flag.lower()}")
    if m.opt.noslip_iterations > 0:
        raise refuse("the noslip solver (option noslip_iterations)")
    if m.opt.disableactuator:
        raise refuse("disabled actuator groups (option actuatorgroupdisable)")
    if (m.opt.density or m.opt.viscosity) and m.ngeom and np.any(m.geom_fluid[:, 0] > 0):
        geom = int(np.argmax(m.geom_fluid[:, 0] > 0))
        raise refuse(f"the ellipsoid fluid model ({name(m, mujoco.mjtObj.mjOBJ_GEOM, geom)})")


def _check_elements(m: mujoco.MjModel) -> None:
    obj = mujoco.mjtObj
    for count, kind, what in (
        (m.ntendon, obj.mjOBJ_TENDON, "tendons"),
        (m.neq, obj.mjOBJ_EQUALITY, "equality constraints"),
        (m.npair, obj.mjOBJ_PAIR, "explicit contact pairs"),
        (m.nflex, obj.mjOBJ_FLEX, "flexes"),
        (m.nplugin, obj.mjOBJ_PLUGIN, "plugins"),
    ):
        if count:
            raise refuse(f"{what} ({name(m, kind, 0)})")
    if m.nmocap:
        raise refuse(f"mocap bodies ({name(m, obj.mjOBJ_BODY, int(np.argmax(m.body_mocapid >= 0)))})")
    for field, kind, what in (
        ("body_gravcomp", obj.mjOBJ_BODY, "gravity compensation"),
        ("geom_adhesion", obj.mjOBJ_GEOM, "adhesion"),
        ("geom_surfacevel", obj.mjOBJ_GEOM, "surface velocities"),
        ("jnt_stiffnesspoly", obj.mjOBJ_JOINT, "polynomial stiffness"),
        ("dof_dampingpoly", obj.mjOBJ_DOF, "polynomial damping"),
        ("actuator_damping", obj.mjOBJ_ACTUATOR, "actuator damping"),
        ("actuator_dampingpoly", obj.mjOBJ_ACTUATOR, "polynomial actuator damping"),
        ("actuator_armature", obj.mjOBJ_ACTUATOR, "actuator armature"),
    ):
        values = np.asarray(getattr(m, field, np.zeros(0)))
        bad: np.ndarray = (
            np.flatnonzero(values.reshape(values.shape[0], -1).any(axis=1)) if values.size else np.zeros(0, int)
        )
        if len(bad):
            where = f"dof number {bad[0]}" if kind == obj.mjOBJ_DOF else name(m, kind, bad[0])
            raise refuse(f"{what} ({where})")


def _check_joints(m: mujoco.MjModel) -> None:
    for j in range(m.njnt):
        where = name(m, mujoco.mjtObj.mjOBJ_JOINT, j)
        if m.jnt_type[j] == _JOINT.mjJNT_BALL:
            raise refuse(f"ball joints ({where})")
        if m.jnt_type[j] != _JOINT.mjJNT_FREE:
            continue
        dofs = slice(int(m.jnt_dofadr[j]), int(m.jnt_dofadr[j]) + 6)
        if m.jnt_stiffness[j]:
            raise refuse(f"stiffness of a free joint ({where})")
        if m.dof_frictionloss[dofs].any():
            raise refuse(f"friction loss of a free joint ({where})")


def _check_actuators(m: mujoco.MjModel) -> None:
    for a in range(m.nu):
        where = name(m, mujoco.mjtObj.mjOBJ_ACTUATOR, a)
        if m.actuator_trntype[a] not in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
            raise refuse(f"transmission {mujoco.mjtTrn(m.actuator_trntype[a]).name} ({where})")
        if m.jnt_type[m.actuator_trnid[a, 0]] == _JOINT.mjJNT_FREE:
            raise refuse(f"actuation of a free joint ({where})")
        dynamics, gain, bias = int(m.actuator_dyntype[a]), int(m.actuator_gaintype[a]), int(m.actuator_biastype[a])
        if dynamics not in (
            _DYN.mjDYN_NONE,
            _DYN.mjDYN_INTEGRATOR,
            _DYN.mjDYN_FILTER,
            _DYN.mjDYN_FILTEREXACT,
            _DYN.mjDYN_PID,
        ):
            raise refuse(f"actuator dynamics {_DYN(dynamics).name} ({where})")
        if gain not in (_GAIN.mjGAIN_FIXED, _GAIN.mjGAIN_AFFINE, _GAIN.mjGAIN_PID):
            raise refuse(f"actuator gain {_GAIN(gain).name} ({where})")
        if bias not in (_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_AFFINE):
            raise refuse(f"actuator bias {_BIAS(bias).name} ({where})")
        if gain == _GAIN.mjGAIN_PID and (m.actuator_ctrlspec[a] != 1 or m.actuator_dynprm[a, 1] > 0):
            raise refuse(f"pid inputs other than the position, and slew limits ({where})")
        if m.actuator_ctrlnum[a] != 1 or m.actuator_outnum[a] != 1 or m.actuator_actnum[a] > 1:
            raise refuse(f"actuators with several inputs, outputs or states ({where})")
        if m.actuator_actearly[a]:
            raise refuse(f"actearly ({where})")


def _contact_pairs(m: mujoco.MjModel) -> dict[int, list[tuple[int, int]]]:
    """Possible contacts of moving geoms with fixed planes; all other possible contacts raise UnsupportedModel."""
    pairs: dict[int, list[tuple[int, int]]] = {}
    if disabled(m, "CONTACT") or disabled(m, "CONSTRAINT"):
        return pairs
    excluded = {int(s) for s in np.asarray(m.exclude_signature)}
    for g1 in range(m.ngeom):
        for g2 in range(g1 + 1, m.ngeom):
            if not _may_touch(m, g1, g2, excluded):
                continue
            plane, geom = (g1, g2) if m.geom_type[g1] == PLANE else (g2, g1)
            _check_pair(m, plane, geom)
            if m.geom_priority[plane] != m.geom_priority[geom]:
                condim = int(m.geom_condim[plane if m.geom_priority[plane] > m.geom_priority[geom] else geom])
            else:
                condim = int(max(m.geom_condim[plane], m.geom_condim[geom]))
            if condim not in (1, 3):
                raise refuse(f"condim {condim}, torsional and rolling friction ({_both(m, plane, geom)})")
            pairs.setdefault(geom, []).append((plane, condim))
    return pairs


def _both(m: mujoco.MjModel, g1: int, g2: int) -> str:
    return f"{name(m, mujoco.mjtObj.mjOBJ_GEOM, g1)} and {name(m, mujoco.mjtObj.mjOBJ_GEOM, g2)}"


def _may_touch(m: mujoco.MjModel, g1: int, g2: int, excluded: set[int]) -> bool:
    """MuJoCo's collision filters: contype and conaffinity, welded bodies, parent and child, excluded body pairs."""
    affine = (m.geom_contype[g1] & m.geom_conaffinity[g2]) or (m.geom_contype[g2] & m.geom_conaffinity[g1])
    b1, b2 = int(m.geom_bodyid[g1]), int(m.geom_bodyid[g2])
    w1, w2 = int(m.body_weldid[b1]), int(m.body_weldid[b2])
    if not affine or w1 == w2:
        return False
    if (min(b1, b2) << 16) + max(b1, b2) in excluded:
        return False
    up1, up2 = (int(m.body_weldid[m.body_parentid[w]]) for w in (w1, w2))
    return disabled(m, "FILTERPARENT") or w1 == 0 or w2 == 0 or (w1 != up2 and w2 != up1)


def _check_pair(m: mujoco.MjModel, plane: int, geom: int) -> None:
    if m.geom_type[plane] != PLANE or m.body_weldid[m.geom_bodyid[plane]] != 0:
        raise refuse(f"contact other than with a plane fixed to the world ({_both(m, plane, geom)})")
    if m.geom_type[geom] not in (SPHERE, CAPSULE, BOX):
        kind = mujoco.mjtGeom(m.geom_type[geom]).name
        raise refuse(f"contact of {kind} with a plane, only sphere, capsule and box ({_both(m, plane, geom)})")
