"""Which joint of a model each number of a LeRobot dataset belongs to.

A name is compared word by word with those of joints and actuators; ".pos" and words that all names begin with ("main")
do not count. Where some names are not those of the model, all of them are taken in the order of its joints if there are
as many, and if no name contradicts that. Whatever is left is asked for.
"""

from collections.abc import Mapping, Sequence

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES, driven_joint
from btr_mjx.gap.data.columns.one_column import ModelNames, common_words
from btr_mjx.gap.data.columns.remedy import Answer, quoted
from btr_mjx.gap.data.columns.words import EFFORT, NEUTRAL, OTHER, POSITION, VELOCITY, words
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import nearest_names, part_names

_NO_POSITION = VELOCITY | EFFORT | OTHER
"""Last words of names of numbers that are no positions."""


def heading(name: str) -> str:
    """The line of dataset.toml that begins the table of a number."""
    return f"[lerobot.joints.{quoted(name)}]"


def short(name: str) -> str:
    """A name without the suffix for positions."""
    return name.removesuffix(".pos")


def joints_of(
    names: Sequence[str],
    model: mujoco.MjModel,
    given: Mapping[str, str],
    where: str,
    answer: Answer,
    notes: list[str],
) -> list[int | None]:
    """The hinge or slide of each number; `given` has joints by `short` name, "" for none.

    Returns:
      Ids of joints; None for numbers that are no positions, or that are said to be of no joint.

    Raises:
      InputError: names of no joint, all of them, with the lines of dataset.toml; or a joint that is named twice.
    """
    joints = part_names(model, "joint")
    scalar = [j for j in range(model.njnt) if int(model.jnt_type[j]) not in SUFFIXES]
    found: dict[str, int | None] = {}
    for name in names:
        if short(name) in given:
            found[name] = joints.index(given[short(name)]) if given[short(name)] else None
        elif words(name) and words(name)[-1] in _NO_POSITION:
            found[name] = None
    rest = [name for name in names if name not in found]
    left = [j for j in scalar if j not in found.values()]
    matched = _by_name(rest, model)
    unknown = [name for name in rest if name not in matched]
    if unknown and len(rest) == len(left) and all(matched.get(n, j) == j for n, j in zip(rest, left, strict=True)):
        pairs = ", ".join(f"{n} = {joints[j]}" for n, j in zip(rest, left, strict=True))
        notes.append(
            f"assumed: numbers of the dataset are the joints of the model in its order, as names differ: {pairs}; to "
            f'say something else, write joint = "..." below {heading(unknown[0])} in dataset.toml'
        )
        matched, unknown = dict(zip(rest, left, strict=True)), []
    if unknown:
        asked = list[str]()
        for i, name in enumerate(unknown, 1):
            near = nearest_names(short(name), joints)
            asked += [heading(name), f'joint = "NAME {i}"  # nearest: {near}; "" if it is none of the model\'s']
        lines = answer.lines(asked, "with names of the model")
        raise InputError(
            f"{where}: the model has no joint {listed(unknown, quotes=True)}; name the joints in {answer.file}",
            lines=lines,
        )
    found |= matched
    taken = [found[name] for name in names]
    for name, joint in zip(names, taken, strict=True):
        if joint is not None and taken.count(joint) > 1:
            raise InputError(
                f"{where}: {name!r} and another number both are the joint {joints[joint]!r}; "
                f'write joint = "..." below {heading(name)} in {answer.file}'
            )
    left_out = [name for name in names if found[name] is None]
    if left_out:
        notes.append(f"numbers of the dataset without a use: {listed(left_out)}")
    return taken


def _by_name(names: Sequence[str], model: mujoco.MjModel) -> dict[str, int]:
    """Joints whose names have the same words."""
    aliases, joints, actuators = ModelNames.of(model).aliases, part_names(model, "joint"), part_names(model, "actuator")
    common, found = common_words(names), dict[str, int]()
    for name in names:
        own = words(name)
        while len(own) > 1 and own[-1] in POSITION | NEUTRAL and own not in aliases:
            own = own[:-1]
        joint, actuator = aliases.get(own, aliases.get(own[len(common) :], (None, None)))
        if joint is not None:
            found[name] = joints.index(joint)
        elif actuator is not None and (driven := driven_joint(model, actuators.index(actuator))) is not None:
            found[name] = driven
    return found
