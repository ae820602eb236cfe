"""Places where an effect may occur: joints, actuators, subtrees, bodies, geoms that can touch the ground, the world.

Labels as in results: `joint:<name>`, `actuator:<name>`, `body:<name>`, `geom:<name>`,
`subtree:<body>` (all joints of that body and its descendants), `all`, `each:<group>` (a number for each member of a
group), `world`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import driven_joint
from btr_mjx.models import part_names

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Place:
    """A place in a model.

    Attributes:
      label: its name in results.
      joints: ids of its joints.
      actuators: ids of its actuators.
      bodies: ids of its bodies.
      geoms: ids of its geoms.
      members: labels of the single places of a group; empty for a single place.
      parts: these single places, where each of them has a number of its own, see `per_member`.
    """

    label: str
    joints: tuple[int, ...] = ()
    actuators: tuple[int, ...] = ()
    bodies: tuple[int, ...] = ()
    geoms: tuple[int, ...] = ()
    members: tuple[str, ...] = ()
    parts: tuple["Place", ...] = ()

    def dofs(self, model: mujoco.MjModel) -> np.ndarray:
        """Addresses of the joints in qvel."""
        return model.jnt_dofadr[list(self.joints)].astype(int)

    def controls(self, model: mujoco.MjModel) -> np.ndarray:
        """Indices of the controls of the actuators."""
        first, count = model.actuator_ctrladr, model.actuator_ctrlnum
        return np.array([first[a] + k for a in self.actuators for k in range(int(count[a]))], int)


WORLD = Place("world")
"""The place of effects that act on the whole world: air, ground, gravity."""


def joint_of(model: mujoco.MjModel, actuator: int) -> int | None:
    """Id of the hinge or slide that an actuator drives; None for other transmissions."""
    joint = driven_joint(model, actuator)
    return joint if joint is not None and int(model.jnt_type[joint]) in _SCALAR else None


def actuator_count(model: mujoco.MjModel) -> int:
    """Number of actuators, which may be smaller than nu: an actuator may have several controls."""
    return len(model.actuator_trntype)


def joint_places(model: mujoco.MjModel, joints: Sequence[int] | None = None) -> list[Place]:
    """Single joints, subtrees of joints, and all joints.

    Args:
      model: the model.
      joints: ids of the joints to choose from; None for every hinge and slide.
    """
    names = part_names(model, "joint")
    scalar = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
    chosen = scalar if joints is None else [j for j in scalar if j in set(joints)]
    driven: dict[int, list[int]] = {j: [] for j in chosen}
    for a in range(actuator_count(model)):
        j = joint_of(model, a)
        if j in driven:
            driven[j].append(a)
    singles = [Place(f"joint:{names[j]}", joints=(j,), actuators=tuple(driven[j])) for j in chosen]
    return singles + _groups(model, singles)


def actuator_places(model: mujoco.MjModel, actuators: Sequence[int] | None = None) -> list[Place]:
    """Single actuators, subtrees of actuators, and all actuators.

    Args:
      model: the model.
      actuators: ids of the actuators to choose from; None for all.
    """
    names = part_names(model, "actuator")
    singles = []
    for a in range(actuator_count(model)) if actuators is None else actuators:
        joint = joint_of(model, a)
        singles.append(Place(f"actuator:{names[a]}", joints=() if joint is None else (joint,), actuators=(a,)))
    return singles + _groups(model, singles)


def _groups(model: mujoco.MjModel, singles: Sequence[Place]) -> list[Place]:
    """Subtrees with at least two actuated joints, and "all"; each set of members once.

    Where any joint is actuated, members are: joints without motors, such as those of a boom, are of another kind.
    """
    singles = [place for place in singles if place.actuators] or singles
    if len(singles) < 2:
        return []
    everything = _union("all", singles)
    groups, seen = [], {everything.members}
    bodies = part_names(model, "body")
    for body in range(1, model.nbody):
        is_inside = [_is_below(model, int(own), body) for own in model.jnt_bodyid]
        below = [place for place in singles if place.joints and all(is_inside[j] for j in place.joints)]
        actuated = {j for place in below if place.actuators for j in place.joints}
        group = _union(f"subtree:{bodies[body]}", below)
        if len(actuated) >= 2 and group.members not in seen:
            seen.add(group.members)
            groups.append(group)
    return [*groups, everything]


def _union(label: str, places: Sequence[Place]) -> Place:
    return Place(
        label,
        joints=tuple(dict.fromkeys(j for place in places for j in place.joints)),
        actuators=tuple(dict.fromkeys(a for place in places for a in place.actuators)),
        members=tuple(place.label for place in places),
    )


def _is_below(model: mujoco.MjModel, body: int, ancestor: int) -> bool:
    """Whether `body` is `ancestor` or a descendant of it."""
    while body > ancestor:
        body = int(model.body_parentid[body])
    return body == ancestor


def body_place(model: mujoco.MjModel, body: int) -> Place:
    """The place of a body."""
    return Place(f"body:{part_names(model, 'body')[body]}", bodies=(body,))


def trunks(model: mujoco.MjModel) -> list[int]:
    """Ids of bodies that float or have at least two branches."""
    return [b for b in _jointed(model) if _floats(model, b) or len(_branches(model, b)) >= 2]


def links(model: mujoco.MjModel) -> list[int]:
    """Ids of bodies with joints that are not trunks."""
    others = set(trunks(model))
    return [b for b in _jointed(model) if b not in others]


def leaf_links(model: mujoco.MjModel) -> list[int]:
    """Ids of links without child links."""
    return [b for b in links(model) if not _branches(model, b)]


def welded_bodies(model: mujoco.MjModel) -> list[int]:
    """Ids of bodies with mass that are welded to a moving body."""
    return [b for b in range(1, model.nbody) if model.body_weldid[b] not in (0, b) and model.body_mass[b] > 0]


def _jointed(model: mujoco.MjModel) -> list[int]:
    return [b for b in range(1, model.nbody) if model.body_weldid[b] == b and model.body_jntnum[b]]


def _floats(model: mujoco.MjModel, body: int) -> bool:
    first = int(model.body_jntadr[body])
    kinds = model.jnt_type[first : first + int(model.body_jntnum[body])]
    return bool((kinds < int(mujoco.mjtJoint.mjJNT_SLIDE)).any())


def _branches(model: mujoco.MjModel, body: int) -> list[int]:
    """Jointed bodies whose parent is welded to `body`."""
    return [
        b
        for b in range(1, model.nbody)
        if model.body_jntnum[b] and model.body_weldid[int(model.body_parentid[b])] == body
    ]


def ground_geoms(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Ids of geoms of moving bodies that can touch static geoms, and of these static geoms."""
    still = model.body_weldid[model.geom_bodyid] == 0
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    ground, feet = np.flatnonzero(still & solid), np.flatnonzero(~still & solid)
    paired = {frozenset(pair) for pair in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}

    def meet(a: int, b: int) -> bool:
        one, other = model.geom_contype[[a, b]] & model.geom_conaffinity[[b, a]]
        return bool(one or other) or frozenset((a, b)) in paired

    touching = [g for g in feet.tolist() if any(meet(g, other) for other in ground.tolist())]
    return touching, [g for g in ground.tolist() if any(meet(g, other) for other in touching)]


def geom_place(model: mujoco.MjModel, geom: int) -> Place:
    """The place of a geom."""
    return Place(f"geom:{part_names(model, 'geom')[geom]}", bodies=(int(model.geom_bodyid[geom]),), geoms=(geom,))
