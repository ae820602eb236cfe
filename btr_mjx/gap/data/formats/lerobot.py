"""LeRobot datasets: Parquet files of frames, names in meta/info.json, of a follower arm with position servos.

    meta/info.json                        features."observation.state".names and features.action.names
    data/chunk-000/file-000.parquet       v3: many episodes in a file
    data/chunk-000/episode_000000.parquet v2: one
                                          columns observation.state, action (lists of numbers), timestamp [s],
                                          episode_index; others are not used

An action is the goal position that the servo holds until the next one. Which joint each number belongs to is found by
`lerobot_names`, its unit, sign and zero by `lerobot_scales`. dataset.toml says what is otherwise found:

    [model]
    file = "arm.xml"
    [lerobot]
    folder = "recordings"           # that holds meta and data; without it, the folder of dataset.toml
    unit = "deg"                    # of all joints: deg, rad, m, range (-100 to 100), percent (0 to 100)
    [lerobot.joints."shoulder_pan.pos"]
    joint = "yaw"                   # of the model; "" for none
    unit = "deg"                    # of this joint
    sign = -1                       # the numbers count the other way round
    zero = 90.0                     # value at which the model's joint is at 0 (deg, rad, m)
    range = [-1.9, 1.9]             # positions [rad], [m] at the ends (range, percent)
"""

import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns import SUFFIXES
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, header_of, read_header
from btr_mjx.gap.data.formats.lerobot_names import driven_joint, heading, joints_of, short
from btr_mjx.gap.data.formats.lerobot_scales import FACTORS, SPANS, JointScale, check_scale, find_scales
from btr_mjx.gap.data.long_files import MAX_SAMPLES
from btr_mjx.gap.data.names.remedy import Answer, quoted
from btr_mjx.gap.data.recording import Recording, make_recordings
from btr_mjx.gap.data.splits import assign_splits
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import check_keys, check_parquet, file_inside, is_number, read_json, read_table

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


def load_lerobot(folder: str | Path) -> Dataset:
    """Read a LeRobot dataset with a dataset.toml; the last third of the episodes is held out.

    Args:
      folder: that holds dataset.toml, or this file.

    Returns:
      The dataset, one recording per episode.

    Raises:
      InputError: names that are not joints of the model, units that do not fit, missing columns, no frames, or an error
        of `recording.make_recordings`.
      DamagedFile: a file that does not parse.
    """
    head, table = read_header(folder, more=("lerobot",))
    return _read(head, table, Answer(head.folder / DATASET_FILE))


def open_lerobot(model: str | Path, recordings: str | Path) -> Dataset:
    """Read a LeRobot dataset without a dataset.toml.

    Args:
      model: MJCF file of the believed model.
      recordings: folder of the dataset.

    Returns:
      The dataset; `Dataset.inferred` is the dataset.toml that says the same.

    Raises:
      InputError, DamagedFile: see `load_lerobot`.
    """
    model, recordings = Path(model), Path(recordings)
    if not model.is_file():
        raise InputError(f"{model}: there is no such model file")
    folder = Path(os.path.commonpath([model.resolve().parent, recordings.resolve()]))
    names = [str(path.resolve().relative_to(folder)) for path in (model, recordings)]
    text = f"[model]\nfile = {quoted(names[0])}\n\n[lerobot]\nfolder = {quoted(names[1])}\n"
    table = tomllib.loads(text)
    where = folder / DATASET_FILE
    data = _read(header_of(table, folder, where, ("lerobot",)), table, Answer(where, text))
    told = [line for one in data.recordings for line in one.notes]
    lines = [
        f"# Inferred from the files. To change it, copy it to {folder} and give that folder to diagnose.",
        *(f"# {line}" for line in dict.fromkeys([*data.notes, *told])),
        "",
        *text.partition("\n\n")[0].splitlines(),
        "",
        "[control]",
        f"interpolation = {quoted(data.interpolation)}",
        "",
        *text.partition("\n\n")[2].splitlines(),
        *(line for scale in data.scales.values() for line in ("", *scale.lines())),
    ]
    first = f"{where} was not read; to use it, give {folder}" if where.is_file() else f"there is no {DATASET_FILE}"
    notes = (
        f"{first}; what was found is listed here, and written as {DATASET_FILE} into the folder of a run",
        *data.notes,
    )
    return replace(data, notes=notes, inferred="\n".join(lines) + "\n")


def _read(head: Dataset, table: Mapping[str, Any], answer: Answer) -> Dataset:
    """The dataset of a header and the table [lerobot]."""
    about, notes, model = table.get("lerobot", {}), list(head.notes), head.model
    where = f"{answer.file}: [lerobot]"
    check_keys(about, ("folder", "unit", "joints"), where, notes)
    folder = head.folder
    if about.get("folder", ".") != ".":
        folder = file_inside(about, "folder", head.folder, where)
    if not is_lerobot_folder(folder):
        raise InputError(f"{where}: there is no {folder / INFO}; write folder = the one that holds meta and data")
    unit, known = about.get("unit"), (*FACTORS, *SPANS)
    if unit is not None and unit not in known:
        raise InputError(f"{where}: unit = {unit!r}: expected one of {', '.join(known)}")
    info = read_json(folder / INFO)
    _check_version(info, folder / INFO)
    states, actions = (_names(info, feature, folder / INFO) for feature in (STATE, ACTION))
    tables = _tables(about, list(dict.fromkeys([*states, *actions])), model, where, notes)
    given = {name: own["joint"] for name, own in tables.items() if "joint" in own}
    places = [f"{folder / INFO}: {feature}" for feature in (STATE, ACTION)]
    joints = joints_of(states, model, given, places[0], answer, notes)
    goals = joints if actions == states else joints_of(actions, model, given, places[1], answer, notes)
    episodes = list(_thinned(list(_episodes(folder, len(states), len(actions))), notes))
    owners = {name: joint for name, joint in zip(states, joints, strict=True) if joint is not None}
    values = {name: np.concatenate([e.state[:, states.index(name)] for e in episodes]) for name in owners}
    values = {name: own[np.isfinite(own)] for name, own in values.items()}
    for name, own in values.items():
        if not len(own):
            raise InputError(f"{folder}: {name!r} of {STATE} holds no number")
    scales = find_scales(values, owners, model, tables, unit, str(answer.file), notes)
    by_joint = {owners[name]: scale for name, scale in scales.items()}
    recordings: list[Recording] = []
    for episode in episodes:
        columns = _columns(episode, joints, goals, by_joint, head, folder)
        recordings += make_recordings([columns], model, episode.where, f"episode_{episode.number:06d}")
    parts = assign_splits(recordings, [None] * len(recordings), str(folder))
    stated = "interpolation" in table.get("control", {})
    if not stated:
        notes.append('a servo holds its goal until the next one: interpolation = "hold"')
    return replace(
        head,
        recordings=tuple(parts),
        notes=tuple(notes),
        interpolation=head.interpolation if stated else "hold",
        scales={scale.joint: scale for scale in scales.values()},
    )


def _check_version(info: Any, path: Path) -> None:
    version = info.get("codebase_version", "v3.0") if isinstance(info, Mapping) else None
    if not isinstance(version, str) or not version.startswith(("v2.", "v3.")):
        raise InputError(
            f"{path}: codebase_version is {version!r}, expected v2.0, v2.1 or v3.0; convert older datasets with LeRobot"
        )


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


def _tables(
    about: Mapping[str, Any], names: Sequence[str], model: Any, where: str, notes: list[str]
) -> dict[str, Mapping[str, Any]]:
    """The tables [lerobot.joints.NAME] by `short` name."""
    tables, joints = about.get("joints", {}), part_names(model, "joint")
    if not isinstance(tables, Mapping):
        raise InputError(f"{where}: joints = {tables!r}: expected tables {heading(names[0])}")
    for name, table in tables.items():
        place = f"{where.removesuffix(' [lerobot]')} {heading(name)}"
        if short(name) not in map(short, names):
            raise InputError(f"{place}: there is no such number in the dataset; nearest: {nearest_names(name, names)}")
        check_scale(table, place, notes)
        joint = table.get("joint", "")
        if joint and (joint not in joints or int(model.jnt_type[joints.index(joint)]) in SUFFIXES):
            raise InputError(
                f"{place} joint = {joint!r}: the model has no such hinge or slide; nearest: "
                f"{nearest_names(joint, joints)}"
            )
    return {short(name): table for name, table in tables.items()}


def _episodes(folder: Path, states: int, actions: int) -> Iterator[Episode]:
    """The episodes of all files, with the numbers of values a frame that meta/info.json names."""
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{folder / 'data'}: there is no .parquet file")
    check_parquet(files)
    for file in files:
        frame = read_table(file, checked=True)
        for column in (STATE, ACTION, "timestamp", "episode_index"):
            if column not in frame.columns:
                near = nearest_names(column, frame.columns)
                raise InputError(f"{file}: there is no column {column!r}; nearest: {near}")
        if not frame["timestamp"].dtype.is_numeric():
            raise InputError(f"{file}: column 'timestamp' holds {frame['timestamp'].dtype}, expected seconds")
        for rows in frame.partition_by("episode_index", maintain_order=True):
            number = rows["episode_index"][0]
            if not is_number(number) or number != int(number) or number < 0:
                raise InputError(f"{file}: episode_index holds {number!r}: expected whole numbers from 0 on")
            time = rows["timestamp"].cast(pl.Float64).fill_null(np.nan).to_numpy()
            where = f"{file}, episode {int(number)}"
            yield Episode(
                where, int(number), time, _stacked(rows, STATE, states, file), _stacked(rows, ACTION, actions, file)
            )


def _stacked(rows: pl.DataFrame, feature: str, width: int, file: Path) -> np.ndarray:
    """Values (K, width) of a feature: lists of numbers, or numbers where the robot has one joint."""
    series, kind = rows[feature], rows[feature].dtype
    inner = kind.inner if isinstance(kind, pl.List | pl.Array) else kind
    if not (isinstance(inner, pl.DataType) and inner.is_numeric()):
        raise InputError(f"{file}: column {feature!r} holds {kind}, expected a list of numbers a row")
    lists = [value if isinstance(value, list) else [value] for value in series.to_list()]
    widths = {len(value) for value in lists}
    if widths != {width}:
        raise InputError(
            f"{file}: column {feature!r} holds {', '.join(map(str, sorted(widths)[:5]))} numbers a row, meta/info.json "
            f"names {width}"
        )
    return np.array(lists, float)


def _thinned(episodes: Sequence[Episode], notes: list[str]) -> Iterator[Episode]:
    """Episodes with `MAX_SAMPLES` frames together, evenly chosen."""
    total = sum(len(episode.time) for episode in episodes)
    if total <= MAX_SAMPLES:
        yield from episodes
        return
    count = max(2, len(episodes) * MAX_SAMPLES // total)
    chosen = np.unique(np.linspace(0, len(episodes) - 1, min(count, len(episodes))).round().astype(int))
    notes.append(
        f"{len(chosen)} of {len(episodes)} episodes are used, evenly chosen: all have {total} frames, more than "
        f"{MAX_SAMPLES}"
    )
    yield from (episodes[i] for i in chosen)


def _columns(
    episode: Episode,
    joints: Sequence[int | None],
    goals: Sequence[int | None],
    scales: Mapping[int, JointScale],
    head: Dataset,
    folder: Path,
) -> dict[str, np.ndarray]:
    """Columns of the model."""
    model, names = head.model, part_names(head.model, "joint")
    columns = {"time": episode.time}
    for values, joint in zip(episode.state.T, joints, strict=True):
        if joint is not None:
            columns[f"qpos/{names[joint]}"] = scales[joint](values)
    for values, joint in zip(episode.action.T, goals, strict=True):
        if joint is None:
            continue
        if joint not in scales:
            raise InputError(
                f"{folder / INFO}: {ACTION} names the joint {names[joint]!r}, {STATE} does not; name it in both"
            )
        actuators = [a for a in range(model.nu) if driven_joint(model, a) == joint]
        if len(actuators) != 1 or not model.actuator_biasprm[actuators[0], 1] < 0:
            what = (
                "no actuator"
                if not actuators
                else "one that is no position servo"
                if len(actuators) == 1
                else "several"
            )
            raise InputError(
                f"{head.model_file}: the joint {names[joint]!r} has {what}; actions of LeRobot are goal positions: "
                f'give it one <position joint="{names[joint]}" kp="..."/>'
            )
        columns[f"ctrl/{part_names(model, 'actuator')[actuators[0]]}"] = scales[joint](values)
    return columns
