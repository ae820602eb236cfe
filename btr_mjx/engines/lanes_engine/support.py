"""Check of which models the lanes engine supports; unsupported features raise an error that names them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.engines.base import UnsupportedModel
from btr_mjx.engines.computed import (
    CHOICES,
    base_field,
    element_name,
    element_of,
    not_computed,
    not_plain,
    wraps_of,
)
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
from btr_mjx.engines.lanes_engine.delays import CUBIC, HOLD, LINEAR
from btr_mjx.engines.lanes_engine.tree import BALL, FREE
from btr_mjx.engines.lanes_engine.tree_builder import active_equalities, is_free_body, make_plan, moving_tendons

MAX_DOFS = 32
"""Dofs of the plan above which native MuJoCo is about as fast, and the program takes minutes to compile."""

_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def refuse(feature: str) -> UnsupportedModel:
    """The error for a feature that this engine does not compute."""
    return UnsupportedModel(f'the lanes engine does not compute {feature}; use engine="native" for this model')


def disabled(model: mujoco.MjModel, flag: str) -> bool:
    """Whether a disable flag of the options is set, by its mjDSBL name."""
    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")))


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


def refusals(model: mujoco.MjModel, size: bool = True) -> Iterator[str]:
    """Features of a model that this engine does not compute, contacts aside, with the elements that use them.

    Without `size`, trees of too many dofs are accepted.
    """
    found = [
        *_check_tables(model),
        *_check_options(model),
        *_check_joints(model),
        *_check_actuators(model),
        *_check_tendons(model),
    ]
    yield from found or (_check_size(model) if size else ())


def _check_tables(m: mujoco.MjModel) -> Iterator[str]:
    """Whatever is not in the tables of what is computed."""
    for field in CHOICES:
        values = np.atleast_1d(base_field(m, field)).astype(int).tolist()
        reasons = {value: not_computed(field, value) for value in set(values)}
        for i in [i for i in _in_use(m, field, len(values)) if reasons[values[i]]][:1]:
            yield f"{field} {reasons[values[i]]}{element_of(m, field, i)}"
    for field, i in not_plain(m):
        yield f"{field} other than MuJoCo's default{element_of(m, field, i)}"


def _in_use(m: mujoco.MjModel, field: str, count: int) -> Iterable[int]:
    """Elements of a field that may influence motion: of equality constraints and tendons those that act."""
    if field.startswith("eq_"):
        return active_equalities(m)
    if field.startswith("wrap_"):
        return [w for t in moving_tendons(m) for w in wraps_of(m, t)]
    return range(count)


def _check_options(m: mujoco.MjModel) -> Iterator[str]:
    if m.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 and (m.na or np.any(m.actuator_history[:, 0])):
        yield f"the RK4 integrator together with activations or delays ({m.nactuator} actuators)"
    if (m.opt.density or m.opt.viscosity) and m.ngeom and np.any(m.geom_fluid[:, 0] > 0):
        geom = int(np.argmax(m.geom_fluid[:, 0] > 0))
        yield f"the ellipsoid fluid model ({element_name(m, mujoco.mjtObj.mjOBJ_GEOM, geom)})"


def turns_alone(m: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint is that of a single free body whose gyroscopic forces are integrated implicitly."""
    implicit = m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return implicit and is_free_body(m, int(m.jnt_bodyid[joint]))


def _check_joints(m: mujoco.MjModel) -> Iterator[str]:
    for j in range(m.njnt):
        where = element_name(m, mujoco.mjtObj.mjOBJ_JOINT, j)
        dofs = m.dof_jntid == j
        if m.jnt_actgravcomp[j] and m.flg_gravcomp:
            yield f"gravity compensation by actuators ({where})"
        if m.jnt_type[j] == BALL and m.jnt_limited[j]:
            if m.dof_frictionloss[dofs].any():
                yield f"friction loss of a ball joint with a limit ({where})"
            if np.ptp(m.dof_damping[dofs]) or np.ptp(m.dof_armature[dofs]):
                yield f"damping and armature that differ between the axes of a ball joint with a limit ({where})"
        if m.jnt_type[j] != FREE:
            continue
        if m.jnt_stiffness[j]:
            yield f"stiffness of a free joint ({where})"
        if m.dof_frictionloss[dofs].any():
            yield f"friction loss of a free joint ({where})"
        if turns_alone(m, j) and np.ptp(m.dof_armature[dofs][3:]):
            yield f"armature that differs between the axes in which a free body turns, implicitfast ({where})"


def _check_actuators(m: mujoco.MjModel) -> Iterator[str]:
    for a in range(m.nactuator):
        where = element_name(m, mujoco.mjtObj.mjOBJ_ACTUATOR, a)
        on_joint = m.actuator_trntype[a] in _JOINT_TRANSMISSIONS
        if on_joint and m.jnt_type[m.actuator_trnid[a, 0]] in (FREE, BALL):
            yield f"actuation of a free or ball joint ({where})"
        pid = m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_PID
        if pid and (m.actuator_ctrlspec[a] != mujoco.mjtCtrlInput.mjINPUT_POS or m.actuator_dynprm[a, 1] > 0):
            yield f"pid inputs other than the position, and slew limits ({where})"
        if m.actuator_history[a, 1] not in (HOLD, LINEAR, CUBIC):
            yield f"interpolation of delayed controls of order {m.actuator_history[a, 1]} ({where})"


def _check_tendons(m: mujoco.MjModel) -> Iterator[str]:
    implicit = m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for t in moving_tendons(m):
        where = element_name(m, mujoco.mjtObj.mjOBJ_TENDON, t)
        wraps = wraps_of(m, t)
        if np.any(m.wrap_type[wraps] != mujoco.mjtWrap.mjWRAP_JOINT):
            continue  # refused already
        if len(set(m.wrap_objid[wraps].tolist())) < m.tendon_num[t]:
            yield f"tendons that list a joint twice ({where})"  # dense and sparse Jacobians of MuJoCo differ
        if implicit and m.tendon_damping[t]:
            yield f"damping of tendons with the implicitfast integrator ({where})"
        driving = np.flatnonzero((m.actuator_trntype == _TENDON) & (m.actuator_trnid[:, 0] == t))
        if implicit and (np.any(m.actuator_gainprm[driving, 2]) or np.any(m.actuator_biasprm[driving, 2])):
            yield f"velocity gains of actuators on tendons with the implicitfast integrator ({where})"
        if len(driving) and np.any(m.jnt_actfrclimited[m.wrap_objid[wraps]]):
            yield f"force limits of joints on driven tendons ({where})"


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
    return f"{element_name(m, mujoco.mjtObj.mjOBJ_GEOM, g1)} and {element_name(m, mujoco.mjtObj.mjOBJ_GEOM, g2)}"


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
