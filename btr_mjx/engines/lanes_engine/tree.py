"""Static plan of a model's kinematic tree: rigid links, groups of identical subtrees, dofs; `planning` makes it.

Bodies without joints are merged into the nearest ancestor with joints. Sibling subtrees with the same structure (such
as the legs of a robot) become one *group*: a single chain of links whose scalars have a leading axis G. Groups are not
nested; inside a group every link has the same G.
"""

from dataclasses import dataclass
from typing import Literal

import mujoco

FREE = int(mujoco.mjtJoint.mjJNT_FREE)
BALL = int(mujoco.mjtJoint.mjJNT_BALL)
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
WIDTHS = {FREE: (7, 6), BALL: (4, 3)}
"""Coordinates and dofs of a kind of joint; others have one of each."""

type Path = tuple[tuple[int, float], ...]
"""MuJoCo joints and their weights: the length of a fixed tendon is the weighted sum of their coordinates."""


@dataclass(frozen=True)
class Actuator:
    """The actuator on the same joint of every member of a group, or on a tendon."""

    ids: tuple[int, ...]
    """MuJoCo actuator of each member."""
    state: int
    """Index into the activation list of the state, -1 if the actuator has none."""
    history: int
    """Index into the list of control histories, -1 if the actuator keeps none."""


@dataclass(frozen=True)
class Joint:
    """The same joint of every member of a group."""

    kind: int
    """mujoco.mjtJoint."""
    ids: tuple[int, ...]
    """MuJoCo joint of each member."""
    dofs: tuple[int, ...]
    """Dofs of the plan."""
    limited: bool
    friction: bool
    """Whether some member has, or may have, friction loss."""
    actuators: tuple[Actuator, ...]

    @property
    def coordinates(self) -> int:
        """Number of coordinates of one member."""
        return WIDTHS.get(self.kind, (1, 1))[0]

    @property
    def turned(self) -> bool:
        """Whether this is a ball joint with a limit.

        The first of the solver's dofs is then along the axis of the rotation, so that the limit acts on a single dof.
        """
        return self.kind == BALL and self.limited


@dataclass(frozen=True)
class Touch:
    """A geom of every member of a group against one plane of the world."""

    plane: int
    """MuJoCo geom of the plane."""
    geoms: tuple[int, ...]
    """MuJoCo geom of each member."""
    kind: int
    """mujoco.mjtGeom: sphere, capsule, box, cylinder or ellipsoid."""
    condim: int
    """After MuJoCo's mixing of both geoms."""


@dataclass(frozen=True)
class Link:
    """A rigid body with at least one joint, in each of `size` subtrees of the same structure."""

    index: int
    parent: int
    """Index of the parent link, -1 for the world; parents come before children."""
    size: int
    """Members of the group; 1 means no group axis."""
    bodies: tuple[int, ...]
    """The MuJoCo body that carries the joints, of each member."""
    joints: tuple[Joint, ...]
    touches: tuple[Touch, ...]
    free_body: bool
    """Whether this is a single free body, without descendants that move relative to it."""

    @property
    def dofs(self) -> tuple[int, ...]:
        """Dofs of the plan that move this link relative to its parent."""
        return tuple(k for joint in self.joints for k in joint.dofs)


@dataclass(frozen=True)
class Tendon:
    """A fixed tendon."""

    id: int
    path: Path
    limited: bool
    friction: bool
    """Whether it has, or may have, friction loss."""
    actuators: tuple[Actuator, ...]


@dataclass(frozen=True)
class Equality:
    """An equality constraint of two joints or tendons, or of one with a constant."""

    id: int
    sides: tuple[Path, ...]
    """One or two."""


@dataclass(frozen=True)
class Closure:
    """An equality constraint that connects or welds two bodies, which may close a loop."""

    id: int
    kind: Literal["connect", "weld"]
    bodies: tuple[int, int]
    """MuJoCo bodies, 0 for the world."""
    roots: tuple[int, int]
    """The bodies with joints, or the world, that these move with."""


@dataclass(frozen=True)
class TreePlan:
    """Static structure of all trees of a model. One dof of the plan stands for `dof_size` dofs of MuJoCo."""

    links: tuple[Link, ...]
    dof_size: tuple[int, ...]
    states: int
    """Number of activation states of the plan."""
    histories: tuple[tuple[int, int], ...]
    """Number of samples and group size of every history of controls."""
    tendons: tuple[Tendon, ...] = ()
    """Fixed tendons that exert forces."""
    equalities: tuple[Equality, ...] = ()
    closures: tuple[Closure, ...] = ()

    @property
    def joints(self) -> list[Joint]:
        """All joints, in link order."""
        return [joint for link in self.links for joint in link.joints]

    @property
    def actuators(self) -> list[Actuator]:
        """All actuators."""
        own = [actuator for joint in self.joints for actuator in joint.actuators]
        return own + [actuator for tendon in self.tendons for actuator in tendon.actuators]

    def place(self, body: int) -> tuple[int, int] | None:
        """Index of the link whose joints a MuJoCo body carries, and the member of its group; None for the world."""
        for link in self.links:
            if body in link.bodies:
                return link.index, link.bodies.index(body)
        return None
