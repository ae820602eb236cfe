"""What one column of a log may be: words that name a joint, a quantity or a command, and how explicitly they do."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco

from btr_mjx.gap.data.columns.imu_names import ImuNames
from btr_mjx.gap.data.columns.model_columns import SUFFIXES
from btr_mjx.gap.data.columns.units import commanded, stated_unit
from btr_mjx.gap.data.columns.words import BASE, NEUTRAL, OTHER, TIME, component, kind_of, unknown_words, words
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names

Words = tuple[str, ...]
_MOST_WORDS = 30
"""Words of a name up to which some of them may be left out."""


@dataclass
class Candidates:
    """Columns of the log by the column of the model that they may be.

    Attributes:
      ranked: rank (explicit ones are higher), table and name.
      numbered: those with a number in place of a joint's name, by number.
      undecided: columns of an IMU by the names of the sensors that they may be of.
    """

    ranked: dict[str, list[tuple[int, int, str]]] = field(default_factory=lambda: defaultdict(list))
    numbered: dict[tuple[bool, str | None, int, Words], dict[int, str]] = field(
        default_factory=lambda: defaultdict(dict)
    )
    undecided: dict[Words, list[str]] = field(default_factory=lambda: defaultdict(list))


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


@dataclass(frozen=True)
class ModelNames:
    """Words that name the parts of a model.

    Attributes:
      model: the model.
      aliases: joint and actuator by words that name them. Those of the only joint need no words.
      sensors: columns of the model that sensors of its joints read, by the words of the sensor's name.
      imu: words of the sensors of IMUs.
      forces: whether measured forces of the actuators are what drives the model, and commands have no use.
    """

    model: mujoco.MjModel
    aliases: Mapping[Words, tuple[str | None, str | None]]
    sensors: Mapping[Words, str]
    imu: ImuNames
    forces: bool = False

    @staticmethod
    def of(model: mujoco.MjModel, forces: bool = False) -> "ModelNames":
        """The words that name joints and actuators of a model, those that name one only."""
        joints, actuators = part_names(model, "joint"), part_names(model, "actuator")
        of_joint, of_actuator = _unique(joints), _unique(actuators)
        tendons, sites = part_names(model, "tendon"), part_names(model, "site")
        parts = {
            int(mujoco.mjtTrn.mjTRN_JOINT): (joints, of_joint),
            int(mujoco.mjtTrn.mjTRN_TENDON): (tendons, _unique(tendons)),
            int(mujoco.mjtTrn.mjTRN_SITE): (sites, _unique(sites)),
        }
        moved = list(zip(model.actuator_trntype.tolist(), model.actuator_trnid[:, 0].tolist(), strict=True))
        for name, (kind, part) in zip(actuators, moved, strict=False):  # a command may have the name of what it moves
            own, forms = parts.get(kind, ([], {}))
            if own and (own is joints or moved.count((kind, part)) == 1):
                for form in [form for form, owner in forms.items() if owner == own[part]]:
                    of_actuator.setdefault(form, name)
        aliases = {form: (of_joint.get(form), of_actuator.get(form)) for form in {*of_joint, *of_actuator} if form}
        if model.njnt == 1 and model.nu <= 1 and int(model.jnt_type[0]) not in SUFFIXES:
            aliases[()] = joints[0], actuators[0] if actuators else None
        kinds = {int(mujoco.mjtSensor.mjSENS_JOINTPOS): "qpos", int(mujoco.mjtSensor.mjSENS_JOINTVEL): "qvel"}
        sensors = {
            words(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, i) or ""): f"{kinds[kind]}/{joints[joint]}"
            for i, (kind, joint) in enumerate(zip(model.sensor_type.tolist(), model.sensor_objid.tolist(), strict=True))
            if kind in kinds
        }
        return ModelNames(model, aliases, sensors, ImuNames.of(model), forces)

    def driving(self, column: str) -> str | None:
        """The column that one with a model's own name is; None for a command where forces drive the model."""
        kind, _, part = column.partition("/")
        if not self.forces or kind not in ("ctrl", "force"):
            return column
        return f"ctrl/{part}".rstrip("/") if kind == "force" else None

    def named_by(self, said: Words) -> tuple[Words, Words] | None:
        """The longest alias among words whose other words are all known, and these others."""
        found = [
            (form, rest)
            for form, rest in self.occurrences(said)
            if self.part_of(form, rest) or (not unknown_words(rest) and (form or any(kind_of(frozenset(rest)))))
        ]
        return max(found, key=lambda one: (len(one[0]), sum(map(len, one[0]))), default=None)

    def occurrences(self, said: Words) -> Iterator[tuple[Words, Words]]:
        """Aliases that occur in words, each with the other words."""
        for size in range(min(len(said), max(map(len, self.aliases), default=0)) + 1):
            for at in range(len(said) - size + 1 if size else 1):
                if (form := said[at : at + size]) in self.aliases:
                    yield form, said[:at] + said[at + size :]

    def part_of(self, form: Words, rest: Words) -> str | None:
        """The suffix of a column of a free or ball joint, "" if there is none; None for other parts."""
        joint = self.aliases[form][0]
        if joint is None:
            return None
        kind = int(self.model.jnt_type[part_names(self.model, "joint").index(joint)])
        if kind not in SUFFIXES:
            return None
        part = component(rest) or ""
        return part if any(part in parts for parts in SUFFIXES[kind]) else ""


def _unique(names: Sequence[str]) -> dict[Words, str]:
    """Names by the words that one may be shortened to: without neutral words, without what all names begin with."""
    owners, shared = defaultdict(set), common_words(names)
    for name in names:
        full = words(name)
        for form in (full, full[len(shared) :]):
            owners[form].add(name)
            owners[tuple(word for word in form if word not in NEUTRAL)].add(name)
    return {form: owned.pop() for form, owned in owners.items() if form and len(owned) == 1}


def fillers(said: Words, names: ModelNames) -> set[Words]:
    """Unknown words of a column without which it would be the position, velocity, effort or command of a part."""
    if len(said) > _MOST_WORDS:
        return set()
    found = {rest for _, rest in names.occurrences(said)}
    found |= {said[:at] + said[at + 1 :] for at, word in enumerate(said) if word.isdigit()}
    return {unknown_words(rest) for rest in found if any(kind_of(frozenset(rest))) and not OTHER & set(rest)}


def without(said: Words, filler: Words) -> Words:
    """The words without those of a filler, in its order; all of them where the filler is not in them."""
    left, rest = list(filler), []
    for word in said:
        if left and word == left[0]:
            left.pop(0)
        else:
            rest.append(word)
    return said if left else tuple(rest)


def match_one(
    i: int, column: str, label: Words, common: Words, filler: Words, names: ModelNames, finds: Candidates
) -> None:
    """Add a column of table `i` to the candidates of the column of the model that it may be.

    Words of the table's label count where the column says of no quantity. Words that are `common` to the columns, and
    those of a `filler` in columns that speak of a quantity, may be left out.
    """
    whole = said = words(stated_unit(column)[0])
    if names.named_by(said) is None and said[: len(common)] == common:
        said = said[len(common) :]
    if filler and names.named_by(said) is None and any(kind_of(frozenset(without(said, filler)))):
        said = without(said, filler)
    hint = frozenset(label) if not any(kind_of(frozenset(said))) else frozenset[str]()
    best = names.named_by(said)
    if best is None or names.part_of(*best) is not None:
        for own in dict.fromkeys((whole, said)):
            sensors, rank = names.imu.columns(own, label)
            if len(sensors) == 1:
                finds.ranked[sensors[0]].append((rank, i, column))
            elif sensors:
                finds.undecided[tuple(one[7:].rpartition("/")[0] for one in sensors)].append(column)
            if sensors:
                return
    numbers = [word for word in said if word.isdigit()]
    rest = tuple(word for word in said if not word.isdigit())
    if len(numbers) == 1 and (best is None or best[0] == (numbers[0],)) and not unknown_words(rest):
        command, quantity = kind_of(frozenset(rest) | hint)
        if command or quantity:
            # Words that all columns share were left out above only of numbers that are no joint's.
            own = tuple(word for word in rest if word not in common)
            finds.numbered[command, quantity, i, own][int(numbers[0])] = column
            return
    if best is None:
        _match_base(i, column, said, label, names.model, finds)
        return
    joint, actuator = names.aliases[best[0]]
    if (part := names.part_of(*best)) is not None:
        if part:
            finds.ranked[f"{'qvel' if part[0] in 'vw' else 'qpos'}/{joint}/{part}"].append((2, i, column))
        return
    command, quantity = kind_of(frozenset(best[1]) | hint)
    for target, rank in _targets(joint, actuator, command, quantity, names):
        finds.ranked[target].append((rank, i, column))


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
    joint: str | None, actuator: str | None, command: bool, quantity: str | None, names: ModelNames
) -> Iterable[tuple[str, int]]:
    """Columns of the model that a column with these words may be, and how explicitly it is that one."""
    driven = None if actuator is None else commanded(names.model, actuator)
    if command:
        if not names.forces and actuator is not None and (quantity is None or driven in (None, quantity)):
            yield f"ctrl/{actuator}", 2 + (quantity is not None)
    elif quantity == "effort":
        if actuator is not None and names.forces:
            yield f"ctrl/{actuator}", 2
        elif actuator is not None and driven == "effort":  # a motor's torque, if no command is named as such
            yield f"ctrl/{actuator}", 1
        elif actuator is not None:
            yield f"force/{actuator}", 2
    elif joint is not None:
        yield f"{'qvel' if quantity == 'velocity' else 'qpos'}/{joint}", 2 if quantity else 1
    elif actuator is not None and quantity is None and not names.forces:
        yield f"ctrl/{actuator}", 1


def match_numbers(names: ModelNames, finds: Candidates, taken: set[str], notes: list[str]) -> None:
    """Columns with a number: joints with these numbers in their names, else as many joints in the model's order."""
    model = names.model
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
            notes.append(f"{said} were taken in the order of the model: {listed(family)}")
        else:
            continue
        for number, name in chosen.items():
            joint, actuator = (None, name) if command or effort else (name, None)
            for target, rank in _targets(joint, actuator, command, quantity, names):
                if target not in taken:
                    finds.ranked[target].append((rank, i, columns[number]))
