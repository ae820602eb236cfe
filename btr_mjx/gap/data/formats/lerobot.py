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
from btr_mjx.gap.data.recording import Recording, assign_splits, make_recording
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import check_keys, read_json, read_table

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
        `recording.make_recording`.
      DamagedFile: a file that does not parse.
    """
    head, table = read_header(folder, more=("lerobot",))
    about, notes = table.get("lerobot", {}), list(head.notes)
    where = f"{head.folder / 'dataset.toml'}: [lerobot]"
    check_keys(about, ("degrees", "joints", "actuators"), where, notes)
    info_path = head.folder / INFO
    info = read_json(info_path)
    joints = _targets(info, STATE, head.model, "joint", about.get("joints", {}), info_path)
    motors = _targets(info, ACTION, head.model, "actuator", about.get("actuators", {}), info_path)
    files = sorted((head.folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{head.folder / 'data'}: there is no .parquet file")
    recordings: list[Recording] = []
    for file in files:
        recordings += _episodes(file, head.model, joints, motors, bool(about.get("degrees", False)))
    parts = assign_splits(recordings, [None] * len(recordings), str(head.folder))
    return replace(head, recordings=tuple(parts), notes=tuple(notes))


def _targets(
    info: Any, feature: str, model: mujoco.MjModel, kind: str, renamed: Mapping[str, str], path: Path
) -> list[str]:
    """The joint or actuator of each number of a feature."""
    names = info.get("features", {}).get(feature, {}).get("names") if isinstance(info, Mapping) else None
    while isinstance(names, Mapping) and names:  # {"motors": [...]} in older files
        names = next(iter(names.values()))
    if not isinstance(names, list) or not names:
        raise InputError(f"{path}: features.{feature!r} has no names; add the list of {kind} names")
    known, found = part_names(model, kind), []
    for name in map(str, names):
        short = name.removesuffix(".pos")
        target = renamed.get(name, renamed.get(short, name if name in known else short))
        if target not in known:
            raise InputError(
                f"{path}: {feature} holds {name!r}, the model has no {kind} {target!r}; nearest: "
                f"{nearest_names(target, known)}; name it in [lerobot.{kind}s] of dataset.toml"
            )
        found.append(target)
    return found


def _episodes(
    file: Path, model: mujoco.MjModel, joints: Sequence[str], motors: Sequence[str], degrees: bool
) -> list[Recording]:
    frame = read_table(file)
    for column in (STATE, ACTION, "timestamp", "episode_index"):
        if column not in frame.columns:
            raise InputError(f"{file}: there is no column {column!r}; nearest: {nearest_names(column, frame.columns)}")
    recordings = []
    for episode in frame["episode_index"].unique(maintain_order=True):
        rows = frame.filter(pl.col("episode_index") == episode)
        columns = {"time": rows["timestamp"].cast(pl.Float64).to_numpy()}
        columns |= _columns(rows, STATE, [f"qpos/{name}" for name in joints], file)
        columns |= _columns(rows, ACTION, [f"ctrl/{name}" for name in motors], file)
        if degrees:
            _to_radians(columns, model)
        recordings.append(make_recording(columns, model, f"{file}, episode {episode}", f"episode_{int(episode):06d}"))
    return recordings


def _columns(rows: pl.DataFrame, feature: str, names: Sequence[str], file: Path) -> dict[str, np.ndarray]:
    try:
        values = np.array(rows[feature].to_list(), float)
    except (TypeError, ValueError):
        raise InputError(f"{file}: column {feature!r} holds rows of different lengths or no numbers") from None
    if values.ndim != 2 or values.shape[1] != len(names):
        raise InputError(
            f"{file}: column {feature!r} holds {values.shape[1:]} numbers a row, meta/info.json names {len(names)}"
        )
    return dict(zip(names, values.T, strict=True))


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
