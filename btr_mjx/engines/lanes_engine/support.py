"""Check of which models the lanes engine supports; unsupported features raise an error that names them."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.engines.base import UnsupportedModel
from btr_mjx.engines.guards.pairs import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    GeomPair,
    contact_condim,
    explicit_pairs,
    geom_pairs,
)
from btr_mjx.engines.lanes_engine.tree import BALL, FREE
from btr_mjx.engines.lanes_engine.tree_builder import active_equalities, make_plan, moving_tendons

MAX_DOFS = 32
"""Dofs of the plan above which native MuJoCo is about as fast, and the program takes minutes to compile."""

_DYN, _GAIN, _BIAS = mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
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


@dataclass(frozen=True)
class Guarded:
    """A pair of geoms whose contact this engine does not compute."""

    pair: GeomPair
    reason: str
    """What is not computed, and the names of both geoms."""


@dataclass(frozen=True)
class Contacts:
    """The pairs of geoms that MuJoCo can collide."""

    computed: dict[int, list[tuple[int, int]]]
    """Geom -> (plane geom, condim) of each contact with a plane that this engine computes."""
    between: list[GeomPair]
    """Other pairs whose contact this engine computes."""
    guarded: list[Guarded]


def require_supported(model: mujoco.MjModel, guards: bool = False) -> Contacts:
    """The possible contacts of a model that this engine supports.

    Without guards, native MuJoCo cannot take over the worlds that the engine marks: contacts that may have to be marked
    are refused.

    Raises:
      UnsupportedModel: the message names the feature and the element that uses it.
    """
    for feature in refusals(model):
        raise refuse(feature)
    contacts = possible_contacts(model)
    if not guards:
        for guarded in contacts.guarded:
            raise refuse(guarded.reason)
        for pair in contacts.between:  # many of them at a time, or parallel capsules, are left to native MuJoCo
            raise refuse(f"every contact between bodies ({_both(model, pair.first, pair.second)})")
    return contacts


def refusals(model: mujoco.MjModel) -> Iterator[str]:
    """Features of a model that this engine does not compute, contacts aside, with the elements that use them."""
    found = [
        *_check_options(model),
        *_check_elements(model),
        *_check_joints(model),
        *_check_actuators(model),
        *_check_tendons(model),
        *_check_equalities(model),
    ]
    yield from found or _check_size(model)


def _check_options(m: mujoco.MjModel) -> Iterator[str]:
    if m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICIT:
        yield f"the {mujoco.mjtIntegrator(m.opt.integrator).name} integrator (only Euler, implicitfast and RK4)"
    if m.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 and (m.na or np.any(m.actuator_history[:, 0])):
        yield f"the RK4 integrator together with activations or delays ({m.nu} actuators)"
    for flag in ("OVERRIDE", "SLEEP", "DIAGEXACT", "IPC", "SPECULATIVE"):
        bit = getattr(_ENABLE, f"mjENBL_{flag}", None)
        if bit is not None and m.opt.enableflags & int(bit):
            yield f"the enable flag {flag.lower()}"
    if m.opt.noslip_iterations > 0:
        yield "the noslip solver (option noslip_iterations)"
    if m.opt.disableactuator:
        yield "disabled actuator groups (option actuatorgroupdisable)"
    if (m.opt.density or m.opt.viscosity) and m.ngeom and np.any(m.geom_fluid[:, 0] > 0):
        geom = int(np.argmax(m.geom_fluid[:, 0] > 0))
        yield f"the ellipsoid fluid model ({name(m, mujoco.mjtObj.mjOBJ_GEOM, geom)})"


def _check_elements(m: mujoco.MjModel) -> Iterator[str]:
    obj = mujoco.mjtObj
    for count, kind, what in (
        (m.nflex, obj.mjOBJ_FLEX, "flexes"),
        (m.nplugin, obj.mjOBJ_PLUGIN, "plugins"),
    ):
        if count:
            yield f"{what} ({name(m, kind, 0)})"
    for field, kind, what in (
        ("geom_adhesion", obj.mjOBJ_GEOM, "adhesion"),
        ("geom_surfacevel", obj.mjOBJ_GEOM, "surface velocities"),
        ("jnt_stiffnesspoly", obj.mjOBJ_JOINT, "polynomial stiffness"),
        ("jnt_springyield", obj.mjOBJ_JOINT, "plastic springs"),
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
            yield f"{what} ({where})"


def _check_joints(m: mujoco.MjModel) -> Iterator[str]:
    for j in range(m.njnt):
        where = name(m, mujoco.mjtObj.mjOBJ_JOINT, j)
        dofs = m.dof_jntid == j
        if m.jnt_actgravcomp[j] and m.body_gravcomp.any():
            yield f"gravity compensation by actuators ({where})"
        if m.jnt_type[j] == BALL and m.jnt_limited[j] and m.dof_frictionloss[dofs].any():
            yield f"friction loss of a ball joint with a limit ({where})"
        if m.jnt_type[j] != FREE:
            continue
        if m.jnt_stiffness[j]:
            yield f"stiffness of a free joint ({where})"
        if m.dof_frictionloss[dofs].any():
            yield f"friction loss of a free joint ({where})"


def _check_actuators(m: mujoco.MjModel) -> Iterator[str]:
    for a in range(m.nu):
        where = name(m, mujoco.mjtObj.mjOBJ_ACTUATOR, a)
        if m.actuator_trntype[a] not in (*_JOINT_TRANSMISSIONS, _TENDON):
            yield f"transmission {mujoco.mjtTrn(m.actuator_trntype[a]).name} ({where})"
            continue
        on_joint = m.actuator_trntype[a] != _TENDON
        if on_joint and m.jnt_type[m.actuator_trnid[a, 0]] in (FREE, BALL):
            yield f"actuation of a free or ball joint ({where})"
        dynamics, gain, bias = int(m.actuator_dyntype[a]), int(m.actuator_gaintype[a]), int(m.actuator_biastype[a])
        if dynamics not in (
            _DYN.mjDYN_NONE,
            _DYN.mjDYN_INTEGRATOR,
            _DYN.mjDYN_FILTER,
            _DYN.mjDYN_FILTEREXACT,
            _DYN.mjDYN_PID,
        ):
            yield f"actuator dynamics {_DYN(dynamics).name} ({where})"
        if gain not in (_GAIN.mjGAIN_FIXED, _GAIN.mjGAIN_AFFINE, _GAIN.mjGAIN_PID):
            yield f"actuator gain {_GAIN(gain).name} ({where})"
        if bias not in (_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_AFFINE):
            yield f"actuator bias {_BIAS(bias).name} ({where})"
        if gain == _GAIN.mjGAIN_PID and (m.actuator_ctrlspec[a] != 1 or m.actuator_dynprm[a, 1] > 0):
            yield f"pid inputs other than the position, and slew limits ({where})"
        if m.actuator_ctrlnum[a] != 1 or m.actuator_outnum[a] != 1 or m.actuator_actnum[a] > 1:
            yield f"actuators with several inputs, outputs or states ({where})"
        if m.actuator_actearly[a]:
            yield f"actearly ({where})"


def _check_tendons(m: mujoco.MjModel) -> Iterator[str]:
    implicit = m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for t in moving_tendons(m):
        where = name(m, mujoco.mjtObj.mjOBJ_TENDON, t)
        wraps = slice(int(m.tendon_adr[t]), int(m.tendon_adr[t] + m.tendon_num[t]))
        if np.any(m.wrap_type[wraps] != mujoco.mjtWrap.mjWRAP_JOINT):
            yield f"spatial tendons ({where})"
            continue
        if len(set(m.wrap_objid[wraps].tolist())) < m.tendon_num[t]:
            yield f"tendons that list a joint twice ({where})"  # dense and sparse Jacobians of MuJoCo differ
        for field, what in (
            ("armature", "armature"),
            ("stiffnesspoly", "polynomial stiffness"),
            ("springyield", "plastic springs"),
            ("dampingpoly", "polynomial damping"),
            ("actfrclimited", "force limits"),
        ):
            if np.any(getattr(m, f"tendon_{field}", np.zeros(m.ntendon))[t]):
                yield f"{what} of tendons ({where})"
        if implicit and m.tendon_damping[t]:
            yield f"damping of tendons with the implicitfast integrator ({where})"
        driving = np.flatnonzero((m.actuator_trntype == _TENDON) & (m.actuator_trnid[:, 0] == t))
        if implicit and (np.any(m.actuator_gainprm[driving, 2]) or np.any(m.actuator_biasprm[driving, 2])):
            yield f"velocity gains of actuators on tendons with the implicitfast integrator ({where})"
        if len(driving) and np.any(m.jnt_actfrclimited[m.wrap_objid[wraps]]):
            yield f"force limits of joints on driven tendons ({where})"


def _check_equalities(m: mujoco.MjModel) -> Iterator[str]:
    kinds = mujoco.mjtEq
    for e in active_equalities(m):
        if int(m.eq_type[e]) not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD, kinds.mjEQ_JOINT, kinds.mjEQ_TENDON):
            where = name(m, mujoco.mjtObj.mjOBJ_EQUALITY, e)
            yield f"equality constraints other than of bodies, joints and fixed tendons ({where})"


def _check_size(m: mujoco.MjModel) -> Iterator[str]:
    friction = m.dof_frictionloss != 0, m.tendon_frictionloss != 0
    dofs = len(make_plan(m, possible_contacts(m).computed, *friction).dof_size)
    if dofs > MAX_DOFS:
        yield f"trees of more than {MAX_DOFS} dofs, alike branches counted once (this one has {dofs})"


def possible_contacts(m: mujoco.MjModel) -> Contacts:
    """The pairs of geoms that MuJoCo can collide, with what this engine does with them."""
    found = Contacts({}, [], [])
    for pair in geom_pairs(m):
        condim = contact_condim(m, pair)
        reason = _not_computed(m, pair)
        if reason:
            found.guarded.append(Guarded(pair, f"{reason} ({_both(m, pair.first, pair.second)})"))
        elif m.geom_type[pair.first] == PLANE:
            found.computed.setdefault(pair.second, []).append((pair.first, condim))
        else:
            found.between.append(pair)
    return found


def _both(m: mujoco.MjModel, g1: int, g2: int) -> str:
    return f"{name(m, mujoco.mjtObj.mjOBJ_GEOM, g1)} and {name(m, mujoco.mjtObj.mjOBJ_GEOM, g2)}"


def _not_computed(m: mujoco.MjModel, pair: GeomPair) -> str:
    """Why a contact is not computed; empty if it is."""
    own = pair.explicit
    if own >= 0:
        slide, across, _, roll, over = m.pair_friction[own]
        if slide != across or roll != over or m.pair_solreffriction[own].any() or m.pair_adhesion[own]:
            return "explicit contact pairs with friction that depends on the direction, solreffriction or adhesion"
        if len(explicit_pairs(m, pair.first, pair.second)) > 1:
            return "several explicit contact pairs of the same geoms"
    kinds = {int(m.geom_type[g]) for g in (pair.first, pair.second)}
    if PLANE in kinds:
        if m.body_weldid[m.geom_bodyid[pair.first]] != 0:
            return "contact with a plane that moves"
        if m.geom_type[pair.second] not in (SPHERE, CAPSULE, BOX, CYLINDER, ELLIPSOID):
            return f"contact of {mujoco.mjtGeom(m.geom_type[pair.second]).name} with a plane"
    elif not kinds <= {SPHERE, CAPSULE}:
        return "contact between geoms other than spheres, capsules and planes"
    return ""
