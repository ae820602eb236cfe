"""Column names of measurement tables: which column of a file is which coordinate of a model.

    time                                                     [s], increasing, not necessarily even
    ctrl/<actuator>                                          command, in the actuator's own unit
    qpos/<joint>, qvel/<joint>                               hinge [rad], [rad/s] or slide [m], [m/s]
    qpos/<joint>/x y z qw qx qy qz                           free joint: position [m] and orientation in the world
    qvel/<joint>/vx vy vz wx wy wz                           free joint: velocity in the world [m/s], angular velocity
                                                             in the body's frame [rad/s], as MuJoCo has them
    qpos/<joint>/qw qx qy qz, qvel/<joint>/wx wy wz          ball joint
    force/<actuator>, sensor/<name>                          optional

CSV, Parquet and NPZ files hold these columns. In NPZ, arrays `qpos` (K, nq), `qvel` (K, nv) and `ctrl` (K, nu) may
stand for all columns of their kind, and `qpos/<joint>` (K, 7) for those of a free joint.
"""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import polars as pl

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data.formats.delimited import read_text_table
from btr_mjx.gap.data.plausible import check_column_count
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import read_arrays, read_table

FORMATS = (".csv", ".parquet", ".npz")
MISSING_TEXTS = ("", "-", "--", "na", "n/a", "nan", "null", "none")
"""Texts, in lower case, that stand for a missing value."""
_QUAT, _SPIN = ("qw", "qx", "qy", "qz"), ("wx", "wy", "wz")
_FREE, _BALL = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL
SUFFIXES: Mapping[int, tuple[tuple[str, ...], tuple[str, ...]]] = {
    int(_FREE): (("x", "y", "z", *_QUAT), ("vx", "vy", "vz", *_SPIN)),
    int(_BALL): (_QUAT, _SPIN),
}
"""Suffixes of the position and velocity columns by joint type; hinges and slides have one column without suffix."""


def state_columns(model: mujoco.MjModel) -> tuple[list[str], list[str]]:
    """Names of the nq columns of qpos and of the nv columns of qvel, in the model's order."""
    positions, velocities = [], []
    for name, kind in zip(part_names(model, "joint"), model.jnt_type, strict=True):
        q, v = SUFFIXES.get(int(kind), ((), ()))
        positions += [f"qpos/{name}/{part}" for part in q] or [f"qpos/{name}"]
        velocities += [f"qvel/{name}/{part}" for part in v] or [f"qvel/{name}"]
    return positions, velocities


def control_columns(model: mujoco.MjModel) -> list[str]:
    """Names of the nu columns of ctrl, in the model's order."""
    return [f"ctrl/{name}" for name in part_names(model, "actuator")]


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Read a table of measurements.

    Args:
      path: a .csv, .parquet or .npz file.

    Returns:
      Arrays by column name, (K,) float64 each, or (K, n) for the grouped columns of an NPZ file. Empty fields are NaN.

    Raises:
      InputError: unknown suffix, no rows, duplicate column, text instead of numbers, columns of different lengths.
      DamagedFile: the content does not parse.
      OSError: the file cannot be read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: a recording is a {', '.join(FORMATS)} file, got {path.suffix or 'no suffix'!r}")
    if path.is_file() and path.stat().st_size == 0:
        raise DamagedFile(f"{path}: the file is empty")
    if suffix == ".npz":
        columns = {name: _numbers(path, name, array) for name, array in read_arrays(path).items()}
    else:
        frame = read_text_table(path)[0] if suffix == ".csv" else read_table(path)
        columns = {name.strip(): numbers_of(path, frame[name]) for name in frame.columns}
    check_column_count(len(columns), path)
    lengths = {name: len(array) for name, array in columns.items()}
    if not lengths or max(lengths.values()) == 0:
        raise InputError(f"{path}: it holds no rows")
    if len(set(lengths.values())) > 1:
        short, long = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        raise InputError(
            f"{path}: columns differ in length ({short!r} has {lengths[short]} rows, {long!r} {lengths[long]}); "
            "sample all of them at the same times"
        )
    return columns


def _numbers(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
        raise InputError(
            f"{path}: array {name!r} has type {array.dtype} and shape {array.shape}; expected numbers, one row a sample"
        )
    return array.astype(np.float64)


def numbers_of(path: Path, series: pl.Series, first_row: int = 0) -> np.ndarray:
    """Values (K,) of a column, NaN where there are none.

    Args:
      path: file, for messages.
      series: the column.
      first_row: number of rows of the file before it, for messages.

    Raises:
      InputError: it holds something else than numbers.
    """
    if series.dtype.is_numeric() or series.dtype in (pl.Boolean, pl.Null):
        return series.cast(pl.Float64).fill_null(np.nan).to_numpy()
    if series.dtype != pl.String:
        raise InputError(f"{path}: column {series.name!r} holds {series.dtype}, expected numbers")
    values = series.str.strip_chars().cast(pl.Float64, strict=False)
    bad = values.is_null() & series.is_not_null() & ~series.str.strip_chars().str.to_lowercase().is_in(MISSING_TEXTS)
    if bad.any():
        row = int(bad.arg_true()[0])
        raise InputError(
            f"{path}: column {series.name!r} holds {series[row]!r} in row {first_row + row + 1} of the data; expected "
            "a number (units belong into the documentation, not into a row)"
        )
    return values.fill_null(np.nan).to_numpy()


def ungroup_columns(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str) -> dict[str, np.ndarray]:
    """Split grouped arrays (K, n) into single columns (K,).

    Args:
      columns: arrays by name, as `read_columns` returns them.
      model: the model.
      where: file, for messages.

    Returns:
      Arrays (K,) by column name.

    Raises:
      InputError: the width of a group differs from the number of coordinates of the model.
    """
    positions, velocities = state_columns(model)
    groups = {"qpos": positions, "qvel": velocities, "ctrl": control_columns(model)}
    flat: dict[str, np.ndarray] = {}
    for name, array in columns.items():
        if array.ndim == 1 and name not in groups:
            flat[name] = array
            continue
        members = groups.get(name) or [c for c in positions + velocities if c.startswith(f"{name}/")] or [name]
        array = array.reshape(len(array), -1)
        if array.shape[1] != len(members):
            if name.startswith("sensor/"):
                members = [f"{name}/{i}" for i in range(array.shape[1])]
            else:
                raise InputError(
                    f"{where}: array {name!r} has {array.shape[1]} columns, the model needs {len(members)}: "
                    f"{', '.join(members[:8])}{', ...' if len(members) > 8 else ''}"
                )
        flat |= dict(zip(members, array.T, strict=True))
    return flat


def check_names(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str) -> list[str]:
    """Check the columns of a file against the joints and actuators of a model.

    Args:
      columns: (K,) arrays by column name.
      model: the model.
      where: file, for messages.

    Returns:
      Names of columns that are not used.

    Raises:
      InputError: a column of an unknown joint or actuator, or a required column that is absent; the message lists the
        nearest names.
    """
    positions, velocities = state_columns(model)
    controls = control_columns(model)
    forces = [c.replace("ctrl/", "force/", 1) for c in controls]
    known = {"qpos": positions, "qvel": velocities, "ctrl": controls, "force": forces}
    for column in columns:
        kind, _, name = column.partition("/")
        if kind in known and column not in known[kind]:
            what = "actuator" if kind in ("ctrl", "force") else "joint"
            near = nearest_names(column, known[kind])
            raise InputError(f"{where}: column {column!r} names no {what} of the model; nearest: {near}")
    # A joint without any column has no encoder, see `unmeasured`.
    joints = part_names(model, "joint")
    begun = {name for name in joints if any(c == f"qpos/{name}" or c.startswith(f"qpos/{name}/") for c in columns)}
    needed = [c for c in positions if any(c == f"qpos/{name}" or c.startswith(f"qpos/{name}/") for name in begun)]
    for column in ["time", *needed, *controls]:
        if column not in columns:
            raise InputError(f"{where}: there is no column {column!r}; nearest in the file: {_near(column, columns)}")
    for name in joints:
        of_joint = [c for c in velocities if c == f"qvel/{name}" or c.startswith(f"qvel/{name}/")]
        missing = [c for c in of_joint if c not in columns]
        if 0 < len(missing) < len(of_joint):
            raise InputError(f"{where}: there is no column {missing[0]!r}; give all of a joint's velocities or none")
    useful = {"time", *positions, *velocities, *controls, *forces}
    return [c for c in columns if c not in useful and not c.startswith("sensor/")]


def _near(column: str, columns: Mapping[str, np.ndarray]) -> str:
    return nearest_names(column, list(columns))
