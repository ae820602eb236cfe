"""What one column of a log may be: words that name a joint, a quantity or a command, and how explicitly they do."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco

from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.gap.data.names.units import stated_unit
from btr_mjx.gap.data.names.vocabulary import BASE, NEUTRAL, TIME, component, kind_of, says_nothing_else, words
from btr_mjx.models import part_names

Words = tuple[str, ...]


@dataclass
class Candidates:
    """Columns of the log by the column of the model that they may be.

    Attributes:
      ranked: rank (explicit ones are higher), table and name.
      numbered: those with a number in place of a joint's name, by number.
    """

    ranked: dict[str, list[tuple[int, int, str]]] = field(default_factory=lambda: defaultdict(list))
    numbered: dict[tuple[bool, str | None, int, Words], dict[int, str]] = field(
        default_factory=lambda: defaultdict(dict)
    )


def common_words(columns: Sequence[str]) -> Words:
    """Words at the beginning of all columns, such as the name of the robot."""
    named = [words(column) for column in columns if not set(words(column)) & set(TIME)]
    if len(named) < 2:
        return ()
    common: list[str] = []
    for group in zip(*named, strict=False):
        if len(set(group)) > 1 or any(kind_of(frozenset(group))):
            break
        common.append(group[0])
    return tuple(common)


def joint_prefix(columns: Sequence[str], aliases: "Aliases") -> Words:
    """Words before the name of a joint in all parts of paths that end with one: lbr in "position/lbr_joint1"."""
    found: set[Words] = set()
    for column in columns:
        for part in map(words, stated_unit(column)[0].split("/") if "/" in column else ()):
            ends = [len(form) for form in aliases if part[-len(form) :] == form]
            if ends:
                found.add(part[: len(part) - max(ends)])
    return found.pop() if len(found) == 1 else ()


Aliases = Mapping[Words, tuple[str | None, str | None]]
"""Joint and actuator by words that name them."""


def aliases_of(model: mujoco.MjModel) -> Aliases:
    """The words that name joints and actuators of a model, those that name one only."""
    joints, actuators = part_names(model, "joint"), part_names(model, "actuator")
    of_joint = _unique({name: _forms(name, joints) for name in joints})
    of_actuator = _unique({name: _forms(name, actuators) for name in actuators})
    for i, name in enumerate(actuators):  # a command may have the name of the joint that it moves
        if int(model.actuator_trntype[i]) == mujoco.mjtTrn.mjTRN_JOINT:
            joint = joints[int(model.actuator_trnid[i, 0])]
            for form, owner in of_joint.items():
                if owner == joint:
                    of_actuator.setdefault(form, name)
    return {form: (of_joint.get(form), of_actuator.get(form)) for form in {*of_joint, *of_actuator} if form}


def sensor_columns(model: mujoco.MjModel) -> Mapping[Words, str]:
    """Columns of the model that sensors of its joints read, by the words of the sensor's name."""
    kinds = {int(mujoco.mjtSensor.mjSENS_JOINTPOS): "qpos", int(mujoco.mjtSensor.mjSENS_JOINTVEL): "qvel"}
    joints = part_names(model, "joint")
    return {
        words(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, i) or ""): f"{kind}/{joints[joint]}"
        for i, (kind, joint) in enumerate(
            (kinds.get(int(kind)), int(joint))
            for kind, joint in zip(model.sensor_type, model.sensor_objid, strict=True)
        )
        if kind is not None
    }


def _forms(name: str, family: Sequence[str]) -> set[Words]:
    """Words that a name may be shortened to: without neutral words, and without what the whole family begins with."""
    full = words(name)
    shared = common_words(list(family))
    forms = {full, full[len(shared) :]}
    forms |= {tuple(word for word in form if word not in NEUTRAL) for form in forms}
    return {form for form in forms if form}


def _unique(forms: Mapping[str, set[Words]]) -> dict[Words, str]:
    owners: dict[Words, list[str]] = defaultdict(list)
    for name, own in forms.items():
        for form in own:
            owners[form].append(name)
    return {form: names[0] for form, names in owners.items() if len(names) == 1}


def match_one(
    i: int,
    column: str,
    label: Words,
    common: Words,
    prefix: Words,
    aliases: Aliases,
    model: mujoco.MjModel,
    finds: Candidates,
) -> None:
    """Add a column to the candidates of the column of the model that it may be."""
    said = words(stated_unit(column)[0])
    if _named_by(said, aliases, model) is None and said[: len(common)] == common:
        said = said[len(common) :]
    for at in range(len(said) - len(prefix) if prefix else 0):
        if _named_by(said, aliases, model) is None and said[at : at + len(prefix)] == prefix:
            said = said[:at] + said[at + len(prefix) :]
    if _named_by(said, aliases, model) is None and column.startswith("/") and column.count("/") > 2:
        space = words(column.split("/")[1])  # of a topic: the robot's, e.g. in /arm/commands/data.0
        said = said[len(space) :] if said[: len(space)] == space and not _speaks(space) else said
    hint = frozenset(label) if not _speaks(said) else frozenset[str]()
    best = _named_by(said, aliases, model)
    numbers = [word for word in said if word.isdigit()]
    rest = tuple(word for word in said if not word.isdigit())
    if len(numbers) == 1 and (best is None or best[0] == (numbers[0],)) and says_nothing_else(frozenset(rest)):
        command, quantity = kind_of(frozenset(rest) | hint)
        if command or quantity:
            finds.numbered[command, quantity, i, rest][int(numbers[0])] = column
            return
    if best is None:
        _match_base(i, column, said, label, model, finds)
        return
    joint, actuator = aliases[best[0]]
    if (part := _part_of(joint, best[1], model)) is not None:
        if part:
            finds.ranked[f"{'qvel' if part[0] in 'vw' else 'qpos'}/{joint}/{part}"].append((2, i, column))
        return
    command, quantity = kind_of(frozenset(best[1]) | hint)
    for target, rank in _targets(joint, actuator, command, quantity, model):
        finds.ranked[target].append((rank, i, column))


def _named_by(said: Words, aliases: Aliases, model: mujoco.MjModel) -> tuple[Words, Words] | None:
    """The longest alias among words whose other words are all known, and these others."""
    best: tuple[Words, Words] | None = None
    for form in aliases:
        for at in range(len(said) - len(form) + 1):
            rest = said[:at] + said[at + len(form) :]
            longer = best is None or (len(form), sum(map(len, form))) > (len(best[0]), sum(map(len, best[0])))
            if said[at : at + len(form)] == form and longer and _explained(rest, model, aliases[form][0]):
                best = form, rest
    return best


def _speaks(said: Words) -> bool:
    return any(kind_of(frozenset(said)))


def _explained(rest: Words, model: mujoco.MjModel, joint: str | None) -> bool:
    return says_nothing_else(frozenset(rest)) or bool(_part_of(joint, rest, model))


def _part_of(joint: str | None, rest: Words, model: mujoco.MjModel) -> str | None:
    """The suffix of a column of a free or ball joint, "" if there is none; None for other joints."""
    if joint is None:
        return None
    kind = int(model.jnt_type[part_names(model, "joint").index(joint)])
    if kind not in SUFFIXES:
        return None
    part = component(rest) or ""
    return part if any(part in parts for parts in SUFFIXES[kind]) else ""


def _match_base(i: int, column: str, said: Words, label: Words, model: mujoco.MjModel, finds: Candidates) -> None:
    """A column of the only free joint, named by a word for the base, by its body, or by its component alone."""
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        return
    body = words(part_names(model, "body")[int(model.jnt_bodyid[free[0]])])
    rest = tuple(word for word in said if word not in body)
    part = component(rest) or component((*label, *rest))
    if part:
        joint = part_names(model, "joint")[free[0]]
        named = bool(set(said) & (BASE | set(body)))
        finds.ranked[f"{'qvel' if part[0] in 'vw' else 'qpos'}/{joint}/{part}"].append((1 + named, i, column))


def _targets(
    joint: str | None, actuator: str | None, command: bool, quantity: str | None, model: mujoco.MjModel
) -> Iterable[tuple[str, int]]:
    """Columns of the model that a column with these words may be, and how explicitly it is that one."""
    driven = None if actuator is None else _commanded(model, actuator)
    if command:
        if actuator is not None and (quantity is None or driven in (None, quantity)):
            yield f"ctrl/{actuator}", 2 + (quantity is not None)
    elif quantity == "effort":
        if actuator is not None and driven == "effort":  # a motor's torque, if no command is named as such
            yield f"ctrl/{actuator}", 1
        elif actuator is not None:
            yield f"force/{actuator}", 2
    elif joint is not None:
        yield f"{'qvel' if quantity == 'velocity' else 'qpos'}/{joint}", 2 if quantity else 1
    elif actuator is not None and quantity is None:
        yield f"ctrl/{actuator}", 1


def _commanded(model: mujoco.MjModel, actuator: str) -> str | None:
    """The quantity that an actuator is commanded: of a servo its position or velocity, else an effort."""
    i = part_names(model, "actuator").index(actuator)
    if model.actuator_biasprm[i, 1] != 0:
        return "position"
    return "velocity" if model.actuator_biasprm[i, 2] != 0 else "effort"


def match_numbers(model: mujoco.MjModel, finds: Candidates, taken: set[str], notes: list[str]) -> None:
    """Columns with a number: joints with these numbers in their names, else as many joints in the model's order."""
    scalar = [n for n, k in zip(part_names(model, "joint"), model.jnt_type, strict=True) if int(k) not in SUFFIXES]
    actuators = part_names(model, "actuator")
    for (command, quantity, i, _), columns in finds.numbered.items():
        effort = quantity == "effort" and not command
        family = actuators if command or effort else scalar
        order = sorted(columns)
        by_number = {int(n[0]): name for name in family if len(n := [w for w in words(name) if w.isdigit()]) == 1}
        if len(by_number) == len(family) and set(order) <= set(by_number) and len(order) > 1:
            chosen = {number: by_number[number] for number in order}
        elif len(order) == len(family) and order in (list(range(len(order))), list(range(1, len(order) + 1))):
            chosen = dict(zip(order, family, strict=True))
            said = f"{columns[order[0]]!r} to {columns[order[-1]]!r}" if len(order) > 1 else repr(columns[order[0]])
            notes.append(f"{said} were taken in the order of the model: {', '.join(family[:8])}")
        else:
            continue
        for number, name in chosen.items():
            joint, actuator = (None, name) if command or effort else (name, None)
            for target, rank in _targets(joint, actuator, command, quantity, model):
                if target not in taken:
                    finds.ranked[target].append((rank, i, columns[number]))
