"""Whether the columns of a log are all that a model needs; what is missing is asked for in one line."""

from collections.abc import Collection, Sequence

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import control_columns, state_columns
from btr_mjx.gap.data.names.matching import Matched, remedy
from btr_mjx.models import nearest_names, part_names


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
