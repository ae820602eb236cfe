"""Columns of a log matched to joints and actuators of a model, by name.

Case, separators, units and words for the quantity do not count: "q_hip [deg]", "hip.position", "joint_states/hip/pos"
and "HipPos" all are the position of the joint "hip", "hip_cmd" and "des_pos_hip" the command of its actuator. Every
word of a name has to be known, so that "hip_temperature" is none of them. Columns with numbers instead of names are
taken in the order of the model, if there are as many. Whatever stays ambiguous is asked for.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import SUFFIXES, control_columns, state_columns
from btr_mjx.gap.data.units import stated_unit
from btr_mjx.gap.data.vocabulary import BASE, NEUTRAL, TIME, component, kind_of, says_nothing_else, words
from btr_mjx.models import nearest_names, part_names

Words = tuple[str, ...]


@dataclass(frozen=True)
class Matched:
    """Which column of a log is which column of a model.

    Attributes:
      names: column of the model, by number of the table and name in the table.
      notes: choices that were made.
    """

    names: Mapping[tuple[int, str], str]
    notes: Sequence[str] = ()


@dataclass
class _Finds:
    """Candidates by column of the model: their rank (explicit ones are higher), table and name."""

    ranked: dict[str, list[tuple[int, int, str]]] = field(default_factory=lambda: defaultdict(list))
    numbered: dict[tuple[bool, str | None, int, Words], dict[int, str]] = field(
        default_factory=lambda: defaultdict(dict)
    )


def match_columns(
    tables: Sequence[tuple[str, Sequence[str]]],
    model: mujoco.MjModel,
    given: Mapping[str, str],
    where: str,
    hint: str = "",
    labelled: bool = False,
) -> Matched:
    """Match the columns of the tables of one recording.

    Args:
      tables: label and column names of each table.
      model: the model.
      given: names of the model by name in the log, as stated in dataset.toml; these win.
      where: file, for messages.
      hint: lines of dataset.toml that a remedy has to name besides.
      labelled: whether the labels of the tables say what they hold.

    Returns:
      The matches. Columns of the log that are none of the model's are left out.

    Raises:
      InputError: two columns that could be the same one of the model, or a name in `given` that is none.
    """
    positions, velocities = state_columns(model)
    controls = control_columns(model)
    forces = [name.replace("ctrl/", "force/", 1) for name in controls]
    exact = {"time", "qpos", "qvel", "ctrl", *positions, *velocities, *controls, *forces}
    exact |= {f"{kind}/{name}" for kind in ("qpos", "qvel") for name in part_names(model, "joint")}
    _check_given(given, tables, exact, where)
    aliases, sensors = _aliases(model), _sensors(model)
    finds, notes = _Finds(), list[str]()
    names: dict[tuple[int, str], str] = {}
    for i, (label, columns) in enumerate(tables):
        common = _common_words([c for c in columns if c not in exact])
        for column in columns:
            if column in given:
                names[i, column] = given[column]
            elif column in exact or column.startswith("sensor/"):
                names[i, column] = column
            elif words(stated_unit(column)[0]) in sensors:
                finds.ranked[sensors[words(stated_unit(column)[0])]].append((3, i, column))
            elif column.split("/", 1)[0] not in ("qpos", "qvel", "ctrl", "force"):  # a misspelt name stays an error
                _match_one(i, column, words(label) if labelled else (), common, aliases, model, finds)
        _match_time(i, columns, names, notes)
    taken = {names[key] for key in names}
    _match_numbers(model, finds, taken, notes)
    for target, found in sorted(finds.ranked.items()):
        if target in taken:
            continue
        best = max(rank for rank, _, _ in found)
        chosen = [(i, column) for rank, i, column in found if rank == best]
        if len(chosen) > 1:
            raise InputError(
                f"{where}: {', '.join(repr(column) for _, column in chosen[:4])} may all be {target!r}; "
                f"{remedy(chosen[0][1], target, hint)}"
            )
        names[chosen[0]] = target
        if best == 1 and target.startswith("ctrl/"):
            notes.append(f"no column is named a command of {target[5:]!r}; {chosen[0][1]!r} is taken as its command")
    _drop_partial_velocities(names, velocities, notes)
    notes += _spoken(names)
    return Matched(names, notes)


def _drop_partial_velocities(names: dict[tuple[int, str], str], velocities: Sequence[str], notes: list[str]) -> None:
    """A gyroscope alone is not the velocity of a free joint; it is left out, unless it has MuJoCo's own names."""
    joints = {column.split("/")[1] for column in velocities}
    for joint in joints:
        needed = {column for column in velocities if column.startswith(f"qvel/{joint}/")}
        found = {key: target for key, target in names.items() if target in needed}
        if 0 < len(set(found.values())) < len(needed) and all(key[1] != target for key, target in found.items()):
            for key in found:
                del names[key]
            missing = ", ".join(sorted(needed - set(found.values())))
            notes.append(f"velocities of {joint} are estimated: there are {len(found)} columns, without {missing}")


def remedy(column: str, target: str, hint: str) -> str:
    """The lines of dataset.toml that match a column: three, separated by bars, where there is no such file yet."""
    if hint:
        return f'say which in a file dataset.toml beside it: {hint} | columns = {{ "{column}" = "{target}" }}'
    return f'say which in dataset.toml: [columns] "{column}" = "{target}"'


def check_matched(
    matched: Matched,
    tables: Sequence[tuple[str, Sequence[str]]],
    model: mujoco.MjModel,
    where: str,
    unmeasured: Collection[str] = (),
    hint: str = "",
) -> None:
    """Check that every required column of a model was found, and no name misspelt.

    A hinge or slide without a column has no encoder only where that is said, or where no column of the log is left
    that may be its own.

    Args:
      matched: the matches.
      tables: label and column names of each table.
      model: the model.
      where: file, for messages.
      unmeasured: names of joints that are said to have no encoder.
      hint: lines of dataset.toml that a remedy has to name besides.

    Raises:
      InputError: a required column that is absent, or a column of an unknown joint or actuator; the message lists the
        nearest names.
    """
    found = set(matched.names.values())
    known = [column for _, columns in tables for column in columns]
    positions, velocities = state_columns(model)
    controls = control_columns(model)
    forces = [name.replace("ctrl/", "force/", 1) for name in controls]
    families = {"qpos": positions, "qvel": velocities, "ctrl": controls, "force": forces}
    for i, (_, columns) in enumerate(tables):
        for column in columns:
            kind = column.partition("/")[0]
            if "/" in column and kind in families and (i, column) not in matched.names:
                what = "actuator" if kind in ("ctrl", "force") else "joint"
                near = nearest_names(column, families[kind])
                raise InputError(f"{where}: column {column!r} names no {what} of the model; nearest: {near}")
        used = [target for (table, _), target in matched.names.items() if table == i]
        if used and "time" not in used:
            raise InputError(
                f"{where}: there is no column 'time'; nearest in the file: {nearest_names('time', list(columns))}; "
                f"{remedy('NAME', 'time', hint)}"
            )
    free = [name for name in known if name not in {column for _, column in matched.names}]
    for column in [*positions, *controls]:
        kind, _, name = column.partition("/")
        if not {column, kind, f"{kind}/{name.rpartition('/')[0]}"} & found:
            if kind == "qpos" and "/" not in name and (name in unmeasured or not free):
                continue
            near = nearest_names(name, free or known)
            hidden = f'a joint without an encoder is named by [model] unmeasured = ["{name}"]; else '
            raise InputError(
                f"{where}: there is no column {column!r}; nearest in the file: {near}; "
                f"{hidden if kind == 'qpos' and '/' not in name else ''}{remedy('NAME', column, hint)}"
            )
    for name in part_names(model, "joint"):
        of_joint = [c for c in velocities if c == f"qvel/{name}" or c.startswith(f"qvel/{name}/")]
        missing = [c for c in of_joint if c not in found]
        if 0 < len(missing) < len(of_joint):
            raise InputError(f"{where}: there is no column {missing[0]!r}; give all of a joint's velocities or none")


def _check_given(
    given: Mapping[str, str], tables: Sequence[tuple[str, Sequence[str]]], exact: set[str], where: str
) -> None:
    known = [column for _, columns in tables for column in columns]
    for column, target in given.items():
        if target not in exact and not target.startswith("sensor/"):
            near = nearest_names(target, sorted(exact))
            raise InputError(f"{where}: [columns] {column!r} = {target!r}: is no column of the model; nearest: {near}")
        if column not in known:
            near = nearest_names(column, known)
            raise InputError(f"{where}: [columns] {column!r}: there is no such column; nearest in the file: {near}")


def _match_time(i: int, columns: Sequence[str], names: dict[tuple[int, str], str], notes: list[str]) -> None:
    """Find the column of time, unless one is named already."""
    if any(names.get((i, column)) == "time" for column in columns):
        return
    found = []
    for place, column in enumerate(columns):
        named = [word for word in words(stated_unit(column)[0]) if word not in ("header", "s", "sec", "ros", "log")]
        if named and (i, column) not in names and named[-1] in TIME:
            found.append((len(named), TIME.index(named[-1]), place, column))
    if found:
        column = min(found)[-1]
        names[i, column] = "time"
        if len(found) > 1:
            others = ", ".join(repr(one[-1]) for one in sorted(found)[1:4])
            notes.append(f"time is column {column!r}, not {others}")


def _common_words(columns: Sequence[str]) -> Words:
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


Aliases = Mapping[Words, tuple[str | None, str | None]]
"""Joint and actuator by words that name them."""


def _aliases(model: mujoco.MjModel) -> Aliases:
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


def _sensors(model: mujoco.MjModel) -> Mapping[Words, str]:
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
    shared = _common_words(list(family))
    forms = {full, full[len(shared) :]}
    forms |= {tuple(word for word in form if word not in NEUTRAL) for form in forms}
    return {form for form in forms if form}


def _unique(forms: Mapping[str, set[Words]]) -> dict[Words, str]:
    owners: dict[Words, list[str]] = defaultdict(list)
    for name, own in forms.items():
        for form in own:
            owners[form].append(name)
    return {form: names[0] for form, names in owners.items() if len(names) == 1}


def _match_one(
    i: int, column: str, label: Words, common: Words, aliases: Aliases, model: mujoco.MjModel, finds: _Finds
) -> None:
    """Add a column to the candidates of the column of the model that it may be."""
    said = words(stated_unit(column)[0])
    if _named_by(said, aliases, model) is None and said[: len(common)] == common:
        said = said[len(common) :]
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


def _match_base(i: int, column: str, said: Words, label: Words, model: mujoco.MjModel, finds: _Finds) -> None:
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


def _match_numbers(model: mujoco.MjModel, finds: _Finds, taken: set[str], notes: list[str]) -> None:
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


def _spoken(names: Mapping[tuple[int, str], str]) -> list[str]:
    """A note that lists the choices of columns whose name is another than the model's."""
    lines = [f"{column} = {target}" for (_, column), target in names.items() if column != target]
    lines = lines[:40] + ([f"and {len(lines) - 40} more"] if len(lines) > 40 else [])
    return [f"columns matched by name: {', '.join(lines)}"] if lines else []
