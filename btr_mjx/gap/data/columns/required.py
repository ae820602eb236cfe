"""Whether the columns of a log are all that a model needs; what is missing is asked for at once."""

from collections.abc import Collection, Mapping, Sequence

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.matching import Matched, Tables
from btr_mjx.gap.data.columns.model_columns import (
    check_sensors,
    check_spelling,
    check_velocities,
    imu_columns,
    model_columns,
    sensor_columns,
    unmeasured_bases,
)
from btr_mjx.gap.data.columns.remedy import NO_FILE, Answer
from btr_mjx.gap.data.columns.units import ColumnUnit, commanded, quantity_of, stated_unit
from btr_mjx.gap.data.columns.words import OTHER, TIME, kind_of, words
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names


class CommandsMissing(InputError):
    """A log without commands that has measured forces of the same actuators."""


def check_matched(
    matched: Matched,
    tables: Tables,
    model: mujoco.MjModel,
    where: str,
    unmeasured: Collection[str] = (),
    answer: Answer = NO_FILE,
    units: Mapping[str, str] | None = None,
) -> None:
    """Check that every required column of a model was found, and no name misspelt.

    A hinge or slide without a column has no encoder only where that is said, or where no column of the log is left
    that may be its own. The pose of a free joint may be absent where its IMU was logged.

    Raises:
      CommandsMissing: only commands are absent, and forces of these actuators are there.
      InputError: required columns that are absent, all of them, with the lines of dataset.toml that name them; or a
        column of an unknown joint or actuator.
    """

    def near(targets: Sequence[str], columns: Sequence[str]) -> dict[str, list[str]]:
        return {target: [c for c in columns if may_be(c, target, model, (units or {}).get(c))] for target in targets}

    found = set(matched.names.values())
    known = [column for _, columns in tables for column in columns]
    for i, (_, columns) in enumerate(tables):
        check_spelling([column for column in columns if (i, column) not in matched.names], model, where)
        used = [target for (table, _), target in matched.names.items() if table == i]
        if used and "time" not in used:
            message = f"{where}: there is no column 'time' beside {listed(columns, quotes=True)}"
            raise answer.asked(message, near(["time"], columns))
    named = {column for _, column in matched.names}
    free = [name for name in known if name not in named]
    missing, hidden = [] if "time" in found else ["time"], list[str]()
    families, joints = model_columns(model), part_names(model, "joint")
    absent = [joints[joint] for joint in unmeasured_bases(found, model)]
    for column in [*families["qpos"], *families["ctrl"]]:
        kind, _, name = column.partition("/")
        if not {column, kind, f"{kind}/{name.rpartition('/')[0]}"} & found:
            if kind == "qpos" and "/" not in name:
                if name in unmeasured or not free:
                    continue
                hidden.append(name)
            if kind == "ctrl" or name.rpartition("/")[0] not in absent:
                missing.append(column)
    if missing and all(c.startswith("ctrl/") and c.replace("ctrl/", "force/", 1) in found for c in missing):
        raise CommandsMissing(f"{where}: there is no column {listed(missing, quotes=True)}")
    if missing:
        instead = [
            f" (in place of the pose of {joint!r}: {listed([c for c in own if c not in found], quotes=True)})"
            for i, joint in enumerate(joints)
            if f"qpos/{joint}/x" in missing and (own := imu_columns(sensor_columns(model), model, i))
        ]
        message = (
            f"{where}: there is no column {listed(missing, quotes=True)}{''.join(instead)}; columns of the file: "
            f"{listed(known, quotes=True)}"
        )
        raise answer.asked(message, near(missing, free), hidden)
    check_velocities(found, model, where)
    check_sensors(found, model, where)


def may_be(column: str, target: str, model: mujoco.MjModel, unit: str | None = None) -> bool:
    """Whether a column of a log may be one of a model, by the quantity and the unit that it, or its file, states."""
    name, own = stated_unit(column)
    said, quantity = frozenset(words(name)), quantity_of(target, model)
    stated = ColumnUnit.of(unit or own or "")
    if stated and quantity and stated.quantity != quantity:
        return False
    if target == "time" or said & set(TIME):
        return target == "time" and not any(kind_of(said))
    command, kind = kind_of(said)
    if target.startswith("ctrl/"):
        drive = commanded(model, target.removeprefix("ctrl/"))
        return kind in (None, drive) and (command or kind is None or drive == "effort") and not said & OTHER
    return not command and kind in (None, "position") and not said & OTHER
