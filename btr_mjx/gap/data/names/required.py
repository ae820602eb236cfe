"""Whether the columns of a log are all that a model needs; what is missing is asked for at once."""

from collections.abc import Collection, Sequence

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import control_columns, state_columns
from btr_mjx.gap.data.names.matching import Matched
from btr_mjx.gap.data.names.remedy import NO_FILE, Answer
from btr_mjx.models import nearest_names, part_names

_LISTED = 20
"""Columns that a message lists, at most."""


def check_matched(
    matched: Matched,
    tables: Sequence[tuple[str, Sequence[str]]],
    model: mujoco.MjModel,
    where: str,
    unmeasured: Collection[str] = (),
    answer: Answer = NO_FILE,
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
      answer: where a user says what columns are.

    Raises:
      InputError: required columns that are absent, all of them, with the lines of dataset.toml that name them; or a
        column of an unknown joint or actuator.
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
            where_time = f"{where}: there is no column 'time' beside {', '.join(map(repr, columns[:8]))}"
            raise answer.asked(where_time, ["time"], columns)
    free = [name for name in known if name not in {column for _, column in matched.names}]
    missing, hidden = [] if "time" in found else ["time"], list[str]()
    for column in [*positions, *controls]:
        kind, _, name = column.partition("/")
        if not {column, kind, f"{kind}/{name.rpartition('/')[0]}"} & found:
            if kind == "qpos" and "/" not in name:
                if name in unmeasured or not free:
                    continue
                hidden.append(name)
            missing.append(column)
    if missing:
        some = ", ".join(map(repr, known[:_LISTED])) + (", ..." if len(known) > _LISTED else "")
        message = f"{where}: there is no column {', '.join(map(repr, missing[:_LISTED]))}; columns of the file: {some}"
        raise answer.asked(message, missing, free or known, hidden)
    for name in part_names(model, "joint"):
        of_joint = [c for c in velocities if c == f"qvel/{name}" or c.startswith(f"qvel/{name}/")]
        left = [c for c in of_joint if c not in found]
        if 0 < len(left) < len(of_joint):
            raise InputError(f"{where}: there is no column {left[0]!r}; give all of a joint's velocities or none")
