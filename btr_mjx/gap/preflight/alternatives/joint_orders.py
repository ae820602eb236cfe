"""Orders in which programs list the joints of a robot."""

from collections.abc import Iterator, Sequence
from itertools import permutations

import mujoco

from btr_mjx.gap.data import listed
from btr_mjx.models import part_names

_MAX_LIMBS = 4
"""Most limbs of which every order is tried."""


def joint_orders(
    model: mujoco.MjModel, joints: Sequence[int], driven: Sequence[int]
) -> Iterator[tuple[str, list[int]]]:
    """Orders that logs may have instead of the model's, the usual ones first.

    Args:
      model: the model.
      joints: ids of its hinges and slides.
      driven: the driven ones, in the order of their actuators.

    Yields:
      Words, and the ids of `joints` in another order than theirs, or in theirs where that is not the order of `driven`.
    """
    names, parent = part_names(model, "joint"), _parents(model, joints)
    depth = {j: sum(1 for _ in _above(j, parent)) for j in joints}
    found = [
        ("level by level (breadth first)", sorted(joints, key=lambda j: depth[j])),
        ("in that of the actuators", [*driven, *(j for j in joints if j not in driven)]),
        ("in that of the alphabet", sorted(joints, key=lambda j: names[j])),
        ("in that of the model", list(joints)),
    ]
    limbs = _limbs(joints, parent)
    for order in permutations(limbs) if len(limbs) <= _MAX_LIMBS else ():
        if [len(limb) for limb in order] == [len(limb) for limb in limbs]:
            first = [j for j in joints if not any(j in limb for limb in limbs)]
            whole = [*first, *(j for limb in order for j in limb)]
            found.append(("limb by limb", whole))
            found.append(("level by level", sorted(whole, key=lambda j: depth[j])))
    seen = [] if list(driven) != [j for j in joints if j in driven] else [list(joints)]
    for words, one in found:
        if one not in seen:
            seen.append(one)
            yield f"{words}: {listed(names[j] for j in one)}", one


def _parents(model: mujoco.MjModel, joints: Sequence[int]) -> dict[int, int | None]:
    """The joint before each one on the way to the world."""
    last: dict[int, int] = {}
    out: dict[int, int | None] = {}
    for j in joints:  # joints of a model are in the order of its bodies, parents first
        body = int(model.jnt_bodyid[j])
        while body and body not in last:
            body = int(model.body_parentid[body])
        out[j] = last.get(body)
        last[int(model.jnt_bodyid[j])] = j
    return out


def _above(joint: int | None, parent: dict[int, int | None]) -> Iterator[int]:
    while joint is not None and (joint := parent[joint]) is not None:
        yield joint


def _limbs(joints: Sequence[int], parent: dict[int, int | None]) -> list[list[int]]:
    """The joints of each limb, from the first branching on."""
    root: int | None = None
    while len(heads := [j for j in joints if parent[j] == root]) == 1:
        root = heads[0]
    return [[j for j in joints if j == head or head in _above(j, parent)] for head in heads]
