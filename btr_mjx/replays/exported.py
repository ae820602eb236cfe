"""What a diagnosis compares, as files for viewers of recordings: Rerun, and Foxglove (MCAP)."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.exports import RecordedCurves, RecordedPoses, recorded_poses, write_mcap, write_rerun
from btr_mjx.gap.data import state_columns
from btr_mjx.plotting import attempt
from btr_mjx.replays.diagnosis_motions import compared_worlds, open_loop_positions
from btr_mjx.replays.replay_records import hold_last_valid
from btr_mjx.runs import read_arrays

WriteMotions = Callable[[Path, Sequence[RecordedCurves], Sequence[RecordedPoses]], None]
"""Writes a file of curves and poses."""

EXPORTS: Mapping[str, tuple[str, WriteMotions]] = {
    "rerun": ("diagnosis.rrd", write_rerun),
    "mcap": ("diagnosis.mcap", write_mcap),
}
"""File by kind of export, and what writes it."""

POSES_PER_SECOND = 30
"""Rate of the poses of bodies; curves have all samples."""

_UNITS: Mapping[int, Sequence[str]] = {
    int(mujoco.mjtJoint.mjJNT_FREE): ("m",) * 3 + ("1",) * 4,
    int(mujoco.mjtJoint.mjJNT_BALL): ("1",) * 4,
    int(mujoco.mjtJoint.mjJNT_SLIDE): ("m",),
    int(mujoco.mjtJoint.mjJNT_HINGE): ("rad",),
}
"""Units of the positions of a joint by its type."""


def export_diagnosis_motions(folder: Path, kinds: Sequence[str]) -> list[Path]:
    """Write exports of a diagnosis.

    Args:
      folder: the run folder.
      kinds: keys of `EXPORTS`.

    Returns:
      The files; those that fail are left out, which one line each on stderr says.
    """
    motions = attempt(" and ".join(EXPORTS[kind][0] for kind in kinds), lambda: _motions(folder))
    if motions is None:
        return []

    def written(name: str, write: WriteMotions) -> Path:
        write(folder / name, *motions)
        return folder / name

    paths = [attempt(EXPORTS[kind][0], partial(written, *EXPORTS[kind])) for kind in kinds]
    return [path for path in paths if path is not None]


def _motions(folder: Path) -> tuple[list[RecordedCurves], list[RecordedPoses]]:
    """The first held-out recording, measured and simulated from its first sample, and the stretches of the page."""
    _, recording, worlds = compared_worlds(folder)
    model, time = recording.model, recording.time
    qpos = {"measured": recording.qpos}
    for title, world in worlds.items():
        simulated = open_loop_positions(world, recording, time - time[0])
        qpos[title.removesuffix(" model")] = simulated
    names = [name.removeprefix("qpos/") for name in state_columns(model)[0]]
    units = dict(zip(names, (unit for kind in model.jnt_type for unit in _UNITS[int(kind)]), strict=True))
    # Without an encoder there is an estimate, which is no measurement.
    encoders = np.repeat(recording.seen[model.jnt_dofadr], np.diff([*model.jnt_qposadr, model.nq]))
    curves = []
    for name, values in qpos.items():
        shown = zip(units, values.T, encoders | (name != "measured"), strict=True)
        own = {coordinate: column for coordinate, column, is_shown in shown if is_shown}
        curves.append(RecordedCurves("recording", name, time, own, units))
    rows = np.unique(np.searchsorted(time, np.arange(time[0], time[-1], 1 / POSES_PER_SECOND)))
    poses = [recorded_poses(name, model, time[rows], hold_last_valid(values[rows])) for name, values in qpos.items()]
    return curves + _stretches(folder), poses


def _stretches(folder: Path) -> list[RecordedCurves]:
    """The held-out stretches of the page, in which each simulation starts from a measured state."""
    data = read_arrays(folder / "overlays.npz")
    keys = {"measured": "measured", "before": "believed", "after": "mended"}
    curves = []
    joints = [str(name).removeprefix("joint ") for name in data["names"]]
    for n, (joint, unit) in enumerate(zip(joints, data["units"].tolist(), strict=True)):
        same = np.array_equal(data[f"before_{n}"], data[f"after_{n}"])
        for key, name in keys.items():
            if key != "after" or not same:
                values = {joint: data[f"{key}_{n}"]}
                curves.append(RecordedCurves(f"stretch_{n + 1}", name, data[f"time_{n}"], values, {joint: unit}))
    return curves
