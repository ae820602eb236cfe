"""Public recordings of an SO-101 as a LeRobot dataset, with the arm's MJCF beside it.

    uv run python benchmarks/lerobot_dataset.py --data copies --out so101
    uv run python -m btr_mjx.diagnose so101/so101_new_calib.xml so101/recordings

`--data` takes copies of isaac-sim2real/sage and TheRobotStudio/SO-ARM100 (both Apache-2.0), as benchmarks/decathlon.py
does. The follower's servos were logged at 50 Hz by NVIDIA's SAGE. They are written as LeRobot's recorder does: goals
and positions of five joints in degrees and of the gripper from 0 to 100, 32 bits, time stamps that are frame / fps.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl
import tyro

sys.path.insert(0, str(Path(__file__).parent / "decathlon"))

from machine import Copies
from so101 import JAW, MODEL, MODEL_REVISION, REPOSITORY, REVISION, ROOT, rows

from btr_mjx.errors import cli_errors

MODEL_FOLDER = "Simulation/SO101"
MODEL_FILE = "so101_new_calib.xml"
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
FPS = 50
DATA_PATHS = {
    "v3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
}


@dataclass(frozen=True)
class Settings:
    """What is written, and where."""

    data: Path
    """Folder with copies of the repositories."""
    out: Path
    """Folder that is written: the MJCF, its meshes, and the dataset in `recordings`."""
    version: Literal["v3.0", "v2.1"] = "v3.0"
    """Of LeRobot's format."""
    every: int = 4
    """Every so many motions become episodes."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Goals and positions (K, 6) of a motion, in degrees and per cent."""

    name: str
    action: np.ndarray
    state: np.ndarray


def motions(copies: Copies, every: int) -> list[Motion]:
    """Motions of the log, every so many of them."""
    found = []
    for name in copies.names(REPOSITORY, REVISION, ROOT)[::every]:
        files = (copies.text(REPOSITORY, REVISION, f"{ROOT}/{name}/{one}.csv") for one in ("control", "state_motor"))
        action, state = (follower(rows(text)[1]) for text in files)
        count = min(len(action), len(state))
        found.append(Motion(name, action[:count], state[:count]))
    return found


def follower(qpos: np.ndarray) -> np.ndarray:
    """Numbers (K, 6) of the follower from positions (K, 6) [rad]."""
    jaw = 100 * (qpos[:, 5:] - JAW[0]) / (JAW[1] - JAW[0])
    return np.hstack([np.degrees(qpos[:, :5]), jaw]).astype(np.float32)


def frames(episodes: Sequence[Motion]) -> list[pl.DataFrame]:
    """The frames of each episode, as LeRobot numbers them."""
    out, first = [], 0
    for number, motion in enumerate(episodes):
        count = len(motion.state)
        table = {
            "action": pl.Series(motion.action, dtype=pl.Array(pl.Float32, 6)),
            "observation.state": pl.Series(motion.state, dtype=pl.Array(pl.Float32, 6)),
            "timestamp": (np.arange(count) / FPS).astype(np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": first + np.arange(count),
            "task_index": np.full(count, number),
        }
        out.append(pl.DataFrame(table))
        first += count
    return out


def about(episodes: Sequence[Motion], version: str) -> Mapping[str, Any]:
    """Content of meta/info.json."""
    numbers = {"dtype": "float32", "shape": [len(NAMES)], "names": [f"{name}.pos" for name in NAMES]}
    single = {
        name: {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
        for name in ("timestamp", "frame_index", "episode_index", "index", "task_index")
    }
    return {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": len(episodes),
        "total_frames": sum(len(motion.state) for motion in episodes),
        "total_tasks": len(episodes),
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": DATA_PATHS[version],
        "video_path": None,
        "features": {"action": numbers, "observation.state": numbers, **single},
    }


def write(episodes: Sequence[Motion], folder: Path, version: str) -> None:
    """Write a dataset."""
    tables = frames(episodes)
    data, meta = folder / "data" / "chunk-000", folder / "meta"
    data.mkdir(parents=True, exist_ok=True)
    meta.mkdir(exist_ok=True)
    (meta / "info.json").write_text(json.dumps(about(episodes, version), indent=4))
    listed: list[dict[str, Any]] = [
        {"episode_index": i, "tasks": [motion.name], "length": len(motion.state)} for i, motion in enumerate(episodes)
    ]
    tasks = [{"task_index": i, "task": motion.name} for i, motion in enumerate(episodes)]
    if version == "v2.1":
        for number, table in enumerate(tables):
            table.write_parquet(data / f"episode_{number:06d}.parquet")
        for name, lines in (("episodes", listed), ("tasks", tasks)):
            (meta / f"{name}.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        return
    pl.concat(tables).write_parquet(data / "file-000.parquet")
    last = np.cumsum([len(table) for table in tables])
    places: dict[str, Any] = {"data/chunk_index": 0, "data/file_index": 0}
    rows_of = [
        row | places | {"dataset_from_index": int(end) - row["length"], "dataset_to_index": int(end)}
        for row, end in zip(listed, last, strict=True)
    ]
    (meta / "episodes" / "chunk-000").mkdir(parents=True, exist_ok=True)
    pl.DataFrame(rows_of).write_parquet(meta / "episodes" / "chunk-000" / "file-000.parquet")
    pl.DataFrame(tasks).write_parquet(meta / "tasks.parquet")


def write_model(copies: Copies, folder: Path) -> None:
    """Write the arm's MJCF as published, and its meshes."""
    (folder / "assets").mkdir(parents=True, exist_ok=True)
    for name in (MODEL_FILE, *(f"assets/{n}" for n in copies.names(MODEL, MODEL_REVISION, f"{MODEL_FOLDER}/assets"))):
        if name.endswith((".xml", ".stl")):
            (folder / name).write_bytes(copies.read(MODEL, MODEL_REVISION, f"{MODEL_FOLDER}/{name}"))


def main() -> None:
    """Write the dataset and the model."""
    settings = tyro.cli(Settings, description=__doc__)
    copies = Copies(settings.data)
    with cli_errors():
        episodes = motions(copies, settings.every)
        write_model(copies, settings.out)
        write(episodes, settings.out / "recordings", settings.version)
    print(f"{len(episodes)} episodes in {settings.out / 'recordings'}, model {settings.out / MODEL_FILE}")


if __name__ == "__main__":
    main()
