"""The plan of a model: its kinematic tree, traversed once, and what of its tendons and constraints is active."""

import hashlib
from collections.abc import Mapping
from typing import Literal

import mujoco
import numpy as np

from btr_mjx.engines.lanes_engine.field_access import rigid_root
from btr_mjx.engines.lanes_engine.tree import (
    FREE,
    WIDTHS,
    Actuator,
    Closure,
    Equality,
    Joint,
    Link,
    Path,
    Tendon,
    Touch,
    TreePlan,
)

_JOINS: dict[int, Literal["connect", "weld"]] = {
    int(mujoco.mjtEq.mjEQ_CONNECT): "connect",
    int(mujoco.mjtEq.mjEQ_WELD): "weld",
}


def rigid_members(model: mujoco.MjModel, body: int) -> list[int]:
    """The body and its descendants that move rigidly with it."""
    members = [body]
    for b in range(body + 1, model.nbody):
        if model.body_jntnum[b] == 0 and model.body_parentid[b] in members:
            members.append(b)
    return members


def massive_members(model: mujoco.MjModel, body: int) -> list[int]:
    """Members of a rigid link that have mass."""
    return [b for b in rigid_members(model, body) if model.body_mass[b] >= 1e-15]


def is_free_body(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is a single free body, whose gyroscopic forces MuJoCo integrates implicitly (mj_isFreeBody)."""
    alone = model.body_jntnum[body] == 1 and model.jnt_type[model.body_jntadr[body]] == FREE
    return bool(alone and model.body_subtreemass[body] == model.body_mass[body] and not has_joints_below(model, body))


def has_joints_below(model: mujoco.MjModel, body: int) -> bool:
    """Whether a descendant of this body has joints."""
    below = [body]
    for b in range(body + 1, model.nbody):
        if model.body_parentid[b] in below:
            below.append(b)
    return any(model.body_jntnum[b] for b in below[1:])


def has_constraints(m: mujoco.MjModel, kind: str) -> bool:
    """Whether constraints of a kind are enabled, by the end of its mjDSBL name: EQUALITY, LIMIT or FRICTIONLOSS."""
    flags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | getattr(mujoco.mjtDisableBit, f"mjDSBL_{kind}")
    return not m.opt.disableflags & int(flags)


def active_equalities(m: mujoco.MjModel) -> list[int]:
    """Equality constraints that are active from the start."""
    return np.flatnonzero(m.eq_active0).tolist() if has_constraints(m, "EQUALITY") else []


def moving_tendons(m: mujoco.MjModel) -> list[int]:
    """Tendons that exert forces; the others have no influence on motion."""
    if not m.ntendon:
        return []
    own = (m.tendon_limited != 0) | (m.tendon_frictionloss != 0) | (m.tendon_armature != 0)
    own |= (m.tendon_stiffness != 0) | (m.tendon_damping != 0)
    for field in ("tendon_stiffnesspoly", "tendon_dampingpoly"):
        own |= np.any(getattr(m, field).reshape(m.ntendon, -1) != 0, axis=1)
    driven = m.actuator_trnid[m.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0]
    coupled = {
        int(t)
        for e in active_equalities(m)
        if m.eq_type[e] == mujoco.mjtEq.mjEQ_TENDON
        for t in (m.eq_obj1id[e], m.eq_obj2id[e])
        if t >= 0
    }
    return sorted(set(np.flatnonzero(own).tolist()) | set(driven.tolist()) | coupled)


class _Builder:
    """Traverses the kinematic tree once; `build` returns the plan."""

    def __init__(
        self,
        model: mujoco.MjModel,
        pairs: Mapping[int, list[tuple[int, int]]],
        friction: np.ndarray,
        tendon_friction: np.ndarray,
    ):
        """Collect the actuators and the signature of every subtree; arguments as of `make_plan`."""
        self.model, self.pairs, self.friction, self.tendon_friction = model, pairs, friction, tendon_friction
        self.limited, self.tendon_limited = (
            has_constraints(model, "LIMIT") & (np.asarray(field) != 0)
            for field in (model.jnt_limited, model.tendon_limited)
        )
        self.links: list[Link] = []
        self.dof_size: list[int] = []
        self.states = 0
        self.histories: list[tuple[int, int]] = []
        self.members = {b: rigid_members(model, b) for b in range(model.nbody) if b == 0 or model.body_jntnum[b]}
        joint_actuators: dict[int, list[int]] = {}
        for a in np.flatnonzero(model.actuator_trntype != mujoco.mjtTrn.mjTRN_TENDON).tolist():
            joint_actuators.setdefault(int(model.actuator_trnid[a, 0]), []).append(a)
        self.actuators = joint_actuators
        self.signatures: dict[int, str] = {}
        for b in reversed(sorted(self.members)):
            self.signatures[b] = self._signature(b)

    def _children(self, body: int) -> list[int]:
        """Child links of a link, sorted by signature, then in MuJoCo's order."""
        m = self.model
        below = [b for b in range(body + 1, m.nbody) if m.body_jntnum[b] and m.body_parentid[b] in self.members[body]]
        return sorted(below, key=lambda b: (self.signatures[b], b))

    def _joints(self, body: int) -> range:
        start = int(self.model.body_jntadr[body])
        return range(start, start + int(self.model.body_jntnum[body])) if body else range(0)

    def _touching(self, body: int) -> list[int]:
        return [
            g for g in range(self.model.ngeom) if self.model.geom_bodyid[g] in self.members[body] and g in self.pairs
        ]

    def _has_friction(self, joint: int) -> bool:
        return bool(self.friction[self.model.dof_jntid == joint].any())

    def _signature(self, body: int) -> str:
        """Text that is equal for subtrees that can form a group: a digest, since it contains those of the children."""
        m = self.model
        joints = []
        for j in self._joints(body):
            acts = [
                (
                    int(m.actuator_dyntype[a]),
                    int(m.actuator_gaintype[a]),
                    int(m.actuator_biastype[a]),
                    bool(m.actuator_ctrllimited[a]),
                    bool(m.actuator_forcelimited[a]),
                    bool(m.actuator_actlimited[a]),
                    int(m.actuator_actnum[a]),
                    tuple(m.actuator_history[a].tolist()),
                    m.actuator_dynprm[a, 0].item() > 0,
                )
                for a in self.actuators.get(j, [])
            ]
            joints.append(
                (
                    int(m.jnt_type[j]),
                    bool(self.limited[j]),
                    bool(m.jnt_actfrclimited[j]),
                    self._has_friction(j),
                    acts,
                )
            )
        touches = [(int(m.geom_type[g]), self.pairs[g]) for g in self._touching(body)] if body else []
        own = (is_free_body(m, body), len(massive_members(m, body))) if body else ()
        whole = repr((joints, touches, own, [self.signatures[b] for b in self._children(body)]))
        return hashlib.sha256(whole.encode()).hexdigest()

    def _add(self, parent: int, bodies: tuple[int, ...]) -> None:
        """Append the link of the bodies of a group, then its descendants."""
        m, size, index = self.model, len(bodies), len(self.links)
        joints = []
        for slot in zip(*(self._joints(b) for b in bodies), strict=True):
            kind = int(m.jnt_type[slot[0]])
            dofs = []
            for _ in range(WIDTHS.get(kind, (1, 1))[1]):
                dofs.append(len(self.dof_size))
                self.dof_size.append(size)
            actuators = tuple(
                self._actuator(ids) for ids in zip(*(self.actuators.get(j, []) for j in slot), strict=True)
            )
            limited, friction = bool(self.limited[slot[0]]), self._has_friction(slot[0])
            joints.append(Joint(kind, slot, tuple(dofs), limited, friction, actuators))
        touches = [
            Touch(plane, geoms, int(m.geom_type[geoms[0]]), condim)
            for geoms in zip(*(self._touching(b) for b in bodies), strict=True)
            for plane, condim in self.pairs[geoms[0]]
        ]
        self.links.append(Link(index, parent, size, bodies, tuple(joints), tuple(touches), is_free_body(m, bodies[0])))
        self._descend(index, bodies)

    def _actuator(self, ids: tuple[int, ...]) -> Actuator:
        """The actuators of a group, with places for their states and controls."""
        stateful = self.model.actuator_actnum[ids[0]] > 0
        samples = int(self.model.actuator_history[ids[0], 0])
        history = len(self.histories) if samples else -1
        actuator = Actuator(ids, self.states if stateful else -1, history)
        self.histories += [(samples, len(ids))] if samples else []
        self.states += int(stateful)
        return actuator

    def _descend(self, index: int, bodies: tuple[int, ...]) -> None:
        if len(bodies) > 1:  # already a group: children are grouped across its members
            for children in zip(*(self._children(b) for b in bodies), strict=True):
                self._add(index, children)
            return
        alike: dict[str, list[int]] = {}
        for child in self._children(bodies[0]):
            alike.setdefault(self.signatures[child], []).append(child)
        for group in sorted(alike.values()):
            self._add(index, tuple(group))

    def build(self) -> TreePlan:
        self._descend(-1, (0,))
        tendons = tuple(self._tendon(t) for t in moving_tendons(self.model))
        active = active_equalities(self.model)
        joins = {e: kind for e in active if (kind := _JOINS.get(int(self.model.eq_type[e])))}
        closures = tuple(self._closure(e, kind) for e, kind in joins.items())
        equalities = tuple(self._equality(e) for e in active if e not in joins)
        sizes, histories = tuple(self.dof_size), tuple(self.histories)
        return TreePlan(tuple(self.links), sizes, self.states, histories, tendons, equalities, closures)

    def _tendon(self, t: int) -> Tendon:
        m = self.model
        driving = (m.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON) & (m.actuator_trnid[:, 0] == t)
        actuators = tuple(self._actuator((a,)) for a in np.flatnonzero(driving).tolist())
        limited, friction = bool(self.tendon_limited[t]), bool(self.tendon_friction[t])
        return Tendon(t, self._path(t), limited, friction, actuators)

    def _path(self, t: int) -> Path:
        m = self.model
        wraps = range(int(m.tendon_adr[t]), int(m.tendon_adr[t] + m.tendon_num[t]))
        return tuple((int(m.wrap_objid[w]), float(m.wrap_prm[w])) for w in wraps)

    def _closure(self, e: int, kind: Literal["connect", "weld"]) -> Closure:
        m = self.model
        one, other = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
            one, other = int(m.site_bodyid[one]), int(m.site_bodyid[other])
        return Closure(e, kind, (one, other), (rigid_root(m, one), rigid_root(m, other)))

    def _equality(self, e: int) -> Equality:
        m = self.model
        elements = [int(i) for i in (m.eq_obj1id[e], m.eq_obj2id[e]) if i >= 0]
        joints = m.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT
        return Equality(e, tuple(((i, 1.0),) if joints else self._path(i) for i in elements))


def make_plan(
    model: mujoco.MjModel,
    pairs: Mapping[int, list[tuple[int, int]]],
    friction: np.ndarray,
    tendon_friction: np.ndarray,
) -> TreePlan:
    """The static plan of a model that has passed `support.refusals`; links are in depth-first order.

    `pairs` has (plane geom, condim) of all possible contacts of a geom. `friction` (nv,) and `tendon_friction`
    (ntendon,) say which dofs and tendons have or may have friction loss.
    """
    return _Builder(model, pairs, friction, tendon_friction).build()
