"""LeRobot datasets: Parquet files of frames, names in meta/info.json, together with a dataset.toml.

    dataset.toml            [model] file = "arm.xml"; [[parameter]], [control], ... as in `dataset`; no [[recording]]
    meta/info.json          features."observation.state".names and features.action.names
    data/**/*.parquet       columns observation.state, action (lists of numbers), timestamp [s], episode_index

Names are those of joints and actuators, with or without the suffix ".pos". Different names and angles in degrees are
declared in dataset.toml:

    [lerobot]
    degrees = true
    [lerobot.joints]
    shoulder_pan = "yaw"        # name in info.json = joint of the model
    [lerobot.actuators]
    shoulder_pan = "yaw_motor"
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars as pl

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.gap.data.dataset import Dataset, read_header
from btr_mjx.gap.data.recording import Recording, make_recordings
from btr_mjx.gap.data.splits import assign_splits
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import check_keys, check_parquet, is_number, read_json, read_table

INFO = Path("meta") / "info.json"
STATE, ACTION = "observation.state", "action"


def is_lerobot_folder(folder: str | Path) -> bool:
    """Whether a folder holds a LeRobot dataset."""
    return (Path(folder) / INFO).is_file()


def load_lerobot(folder: str | Path) -> Dataset:
    """Read a LeRobot dataset; the last third of the episodes is held out.

    Args:
      folder: the folder, or its dataset.toml.

    Returns:
      The dataset, one recording per episode.

    Raises:
      InputError: names that are not joints or actuators of the model, missing columns, no frames, or an error of
        `recording.make_recordings`.
      DamagedFile: a file that does not parse.
    """
    head, table = read_header(folder, more=("lerobot",))
    about, notes = table.get("lerobot", {}), list(head.notes)
    where = f"{head.folder / 'dataset.toml'}: [lerobot]"
    check_keys(about, ("degrees", "joints", "actuators"), where, notes)
    degrees = about.get("degrees", False)
    if not isinstance(degrees, bool):
        raise InputError(f"{where}: degrees = {degrees!r}: expected true or false")
    info_path = head.folder / INFO
    info = read_json(info_path)
    joints = _targets(info, STATE, head.model, "joint", _renamed(about, "joints", where), info_path)
    motors = _targets(info, ACTION, head.model, "actuator", _renamed(about, "actuators", where), info_path)
    files = sorted((head.folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{head.folder / 'data'}: there is no .parquet file")
    check_parquet(files)
    recordings: list[Recording] = []
    for file in files:
        recordings += _episodes(file, head.model, joints, motors, degrees)
    parts = assign_splits(recordings, [None] * len(recordings), str(head.folder))
    return replace(head, recordings=tuple(parts), notes=tuple(notes))


def _renamed(about: Mapping[str, Any], key: str, where: str) -> Mapping[str, str]:
    table = about.get(key, {})
    if not isinstance(table, Mapping) or not all(isinstance(name, str) for name in table.values()):
        raise InputError(f'{where}: {key} = {table!r}: expected a table of NAME = "NAME OF THE MODEL"')
    return table


def _targets(
    info: Any, feature: str, model: mujoco.MjModel, kind: str, renamed: Mapping[str, str], path: Path
) -> list[str]:
    """The joint or actuator of each number of a feature."""
    names = info
    for key in ("features", feature, "names"):
        names = names.get(key) if isinstance(names, Mapping) else None
    while isinstance(names, Mapping) and names:  # {"motors": [...]} in older files
        names = next(iter(names.values()))
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"{path}: features.{feature!r} has no names; add the list of {kind} names, as texts")
    known, found = part_names(model, kind), list[str]()
    for name in names:
        short = name.removesuffix(".pos")
        target = renamed.get(name, renamed.get(short, name if name in known else short))
        if target not in known:
            raise InputError(
                f"{path}: {feature} holds {name!r}, the model has no {kind} {target!r}; nearest: "
                f"{nearest_names(target, known)}; name it in [lerobot.{kind}s] of dataset.toml"
            )
        if target in found:
            raise InputError(f"{path}: {feature} names the {kind} {target!r} twice; name each once")
        found.append(target)
    return found


def _episodes(
    file: Path, model: mujoco.MjModel, joints: Sequence[str], motors: Sequence[str], degrees: bool
) -> list[Recording]:
    frame = read_table(file, checked=True)
    for column in (STATE, ACTION, "timestamp", "episode_index"):
        if column not in frame.columns:
            raise InputError(f"{file}: there is no column {column!r}; nearest: {nearest_names(column, frame.columns)}")
    if not frame["timestamp"].dtype.is_numeric():
        raise InputError(f"{file}: column 'timestamp' holds {frame['timestamp'].dtype}, expected seconds")
    recordings = []
    for rows in frame.partition_by("episode_index", maintain_order=True):
        episode = _episode_number(rows["episode_index"][0], file)
        columns = {"time": rows["timestamp"].cast(pl.Float64).fill_null(np.nan).to_numpy()}
        columns |= _columns(rows, STATE, [f"qpos/{name}" for name in joints], file)
        columns |= _columns(rows, ACTION, [f"ctrl/{name}" for name in motors], file)
        if degrees:
            _to_radians(columns, model)
        recordings += make_recordings([columns], model, f"{file}, episode {episode}", f"episode_{episode:06d}")
    return recordings


def _episode_number(value: Any, file: Path) -> int:
    if not is_number(value) or value != int(value) or value < 0:
        raise InputError(f"{file}: episode_index holds {value!r}: expected whole numbers from 0 on")
    return int(value)


def _columns(rows: pl.DataFrame, feature: str, names: Sequence[str], file: Path) -> dict[str, np.ndarray]:
    """The columns of a feature: lists of numbers, or numbers where the robot has one joint or motor."""
    series, kind = rows[feature], rows[feature].dtype
    inner = kind.inner if isinstance(kind, pl.List | pl.Array) else kind
    if not (isinstance(inner, pl.DataType) and inner.is_numeric()):
        raise InputError(f"{file}: column {feature!r} holds {kind}, expected a list of numbers a row")
    lists = [value if isinstance(value, list) else [value] for value in series.to_list()]
    widths = {len(value) for value in lists}
    if widths != {len(names)}:
        raise InputError(
            f"{file}: column {feature!r} holds {', '.join(map(str, sorted(widths)[:5]))} numbers a row, meta/info.json "
            f"names {len(names)}"
        )
    return dict(zip(names, np.array(lists, float).T, strict=True))


def _to_radians(columns: dict[str, np.ndarray], model: mujoco.MjModel) -> None:
    """Convert, in place, angles of hinges and commands of the position actuators that drive them."""
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    joints = part_names(model, "joint")
    for i, name in enumerate(joints):
        if model.jnt_type[i] == hinge and int(model.jnt_type[i]) not in SUFFIXES:
            columns[f"qpos/{name}"] = np.radians(columns[f"qpos/{name}"])
    for i, name in enumerate(part_names(model, "actuator")):
        drives_hinge = (
            model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            and model.jnt_type[int(model.actuator_trnid[i, 0])] == hinge
        )
        if drives_hinge and model.actuator_biasprm[i, 1] != 0 and f"ctrl/{name}" in columns:
            columns[f"ctrl/{name}"] = np.radians(columns[f"ctrl/{name}"])
