"""LeRobot datasets: Parquet files of frames, names in meta/info.json, of a follower arm with position servos.

    meta/info.json                        features."observation.state".names and features.action.names
    data/chunk-000/file-000.parquet       v3: many episodes in a file
    data/chunk-000/episode_000000.parquet v2: one
                                          columns observation.state, action (lists of numbers), timestamp [s],
                                          episode_index; others are not used

An action is the goal position that the servo holds until the next one. Which joint each number belongs to is found by
`joints`, its unit, sign and zero by `scales`, and declared in dataset.toml: in [lerobot] the folder and the unit of all
but grippers, in tables [lerobot.joints.NAME] the keys `scales.JOINT_KEYS` of a joint.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES, driven_joint
from btr_mjx.gap.data.columns.remedy import Answer
from btr_mjx.gap.data.dataset import Dataset
from btr_mjx.gap.data.lerobot.frames import (
    ACTION,
    INFO,
    STATE,
    Episode,
    is_lerobot_folder,
    names_in,
    read_episodes,
)
from btr_mjx.gap.data.lerobot.joints import heading, joints_of, short
from btr_mjx.gap.data.lerobot.scales import FACTORS, SPANS, JointScale, check_scale, find_scales
from btr_mjx.gap.data.recordings.recording import Recording, make_recordings
from btr_mjx.gap.data.recordings.splits import assign_splits
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import check_keys, file_inside


def load_lerobot(head: Dataset, table: Mapping[str, Any], answer: Answer) -> Dataset:
    """Read a LeRobot dataset whose dataset.toml was read: a recording per episode, the last third of them held out."""
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
    states, actions = names_in(folder)
    tables = _tables(about, list(dict.fromkeys([*states, *actions])), model, where, notes)
    given = {name: own["joint"] for name, own in tables.items() if "joint" in own}
    places = [f"{folder / INFO}: {feature}" for feature in (STATE, ACTION)]
    joints = joints_of(states, model, given, places[0], answer, notes)
    goals = joints if actions == states else joints_of(actions, model, given, places[1], answer, notes)
    episodes = read_episodes(folder, len(states), len(actions), notes)
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
        name = f"episode_{episode.number:06d}"
        shift = head.control.shift_of(name)
        recordings += make_recordings([columns], model, episode.where, name, shift=shift)
    parts = assign_splits(recordings, [None] * len(recordings), str(folder))
    head.control.check_names([one.log for one in parts], str(answer.file))
    said = [head.control.interpolation_of(one.log) for one in parts]
    if None in said:
        notes.append('a servo holds its goal until the next one: interpolation = "hold"')
    return replace(
        head,
        recordings=tuple(replace(one, interpolation=own or "hold") for one, own in zip(parts, said, strict=True)),
        notes=tuple(notes),
        scales={scale.joint: scale for scale in scales.values()},
    )


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
    pairs = zip(episode.state.T, joints, strict=True)
    columns |= {f"qpos/{names[joint]}": scales[joint](values) for values, joint in pairs if joint is not None}
    for values, joint in zip(episode.action.T, goals, strict=True):
        if joint is None:
            continue
        if joint not in scales:
            raise InputError(
                f"{folder / INFO}: {ACTION} names the joint {names[joint]!r}, {STATE} does not; name it in both"
            )
        actuators = [a for a in range(model.nu) if driven_joint(model, a) == joint]
        if len(actuators) != 1 or not model.actuator_biasprm[actuators[0], 1] < 0:
            what = {0: "no actuator", 1: "one that is no position servo"}.get(len(actuators), "several")
            raise InputError(
                f"{head.model_file}: the joint {names[joint]!r} has {what}; actions of LeRobot are goal positions: "
                f'give it one <position joint="{names[joint]}" kp="..."/>'
            )
        columns[f"ctrl/{part_names(model, 'actuator')[actuators[0]]}"] = scales[joint](values)
    return columns
