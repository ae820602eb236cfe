"""Frames of LeRobot datasets: names in meta/info.json, numbers in Parquet files, by episode."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.files.frames import frame_table
from btr_mjx.gap.data.files.table import LogTable
from btr_mjx.gap.data.recordings.stretches import MAX_SAMPLES
from btr_mjx.models import nearest_names
from btr_mjx.runs import is_number, read_json, read_table

INFO = Path("meta") / "info.json"
STATE, ACTION = "observation.state", "action"


@dataclass(frozen=True, eq=False)
class Episode:
    """Frames of an episode: time (K,) [s], state (K, n) and action (K, m) in the dataset's units."""

    where: str
    number: int
    time: np.ndarray
    state: np.ndarray
    action: np.ndarray


def is_lerobot_folder(folder: str | Path) -> bool:
    """Whether a folder holds a LeRobot dataset."""
    return (Path(folder) / INFO).is_file()


def names_in(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the numbers of a state and of an action.

    Raises:
      InputError: another version of the format, or names that are absent or twice there.
      DamagedFile: meta/info.json does not parse.
    """
    path = folder / INFO
    info = read_json(path)
    version = info.get("codebase_version", "v3.0") if isinstance(info, Mapping) else None
    if not isinstance(version, str) or not version.startswith(("v2.", "v3.")):
        raise InputError(
            f"{path}: codebase_version is {version!r}, expected v2.0, v2.1 or v3.0; convert older datasets with LeRobot"
        )
    return _names(info, STATE, path), _names(info, ACTION, path)


def _names(info: Any, feature: str, path: Path) -> list[str]:
    """The names of the numbers of a feature."""
    names = info
    for key in ("features", feature, "names"):
        names = names.get(key) if isinstance(names, Mapping) else None
    while isinstance(names, Mapping) and names:  # {"motors": [...]} in older files
        names = next(iter(names.values()))
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise InputError(f"{path}: features.{feature!r} has no names; add the list of the joints' names, as texts")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{path}: features.{feature!r} names {twice!r} twice; name each number once")
    return names


def read_episodes(folder: Path, states: int, actions: int, notes: list[str]) -> list[Episode]:
    """Read the episodes, with so many numbers of a state and an action; of more than `MAX_SAMPLES` frames some.

    Raises:
      InputError: no files, a column that is absent or of another kind, or another count of numbers.
      DamagedFile: a file that does not parse.
    """
    episodes = list(_all_episodes(folder, states, actions))
    total = sum(len(episode.time) for episode in episodes)
    if total <= MAX_SAMPLES:
        return episodes
    count = max(2, len(episodes) * MAX_SAMPLES // total)
    chosen = np.unique(np.linspace(0, len(episodes) - 1, min(count, len(episodes))).round().astype(int))
    notes.append(
        f"{len(chosen)} of {len(episodes)} episodes are used, evenly chosen: all have {total} frames, more than "
        f"{MAX_SAMPLES}"
    )
    return [episodes[i] for i in chosen]


def _all_episodes(folder: Path, states: int, actions: int) -> Iterator[Episode]:
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{folder / 'data'}: there is no .parquet file")
    for file in files:
        frame = read_table(file)
        for column in (STATE, ACTION, "timestamp", "episode_index"):
            if column not in frame.columns:
                near = nearest_names(column, frame.columns)
                raise InputError(f"{file}: there is no column {column!r}; nearest: {near}")
        for rows in frame.partition_by("episode_index", maintain_order=True):
            number = rows["episode_index"][0]
            if not is_number(number) or number != int(number) or number < 0:
                raise InputError(f"{file}: episode_index holds {number!r}: expected whole numbers from 0 on")
            table = frame_table(file, rows.select("timestamp", STATE, ACTION))
            (time,) = _stacked(table, "timestamp", 1, file).T
            state, action = _stacked(table, STATE, states, file), _stacked(table, ACTION, actions, file)
            yield Episode(f"{file}, episode {int(number)}", int(number), time, state, action)


def _stacked(table: LogTable, feature: str, width: int, file: Path) -> np.ndarray:
    """Values (K, width) of a feature: lists of numbers, or numbers where the robot has one joint."""
    if feature in table.text:
        raise InputError(table.text[feature])
    own = [values for name, values in table.columns.items() if name.partition("/")[0] == feature]
    if len(own) != width:
        raise InputError(f"{file}: column {feature!r} holds {len(own)} numbers a row, meta/info.json names {width}")
    return np.stack(own, axis=1)
