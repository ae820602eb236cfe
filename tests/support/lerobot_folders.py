"""LeRobot datasets of a small arm, in the units and layouts that LeRobot writes."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars as pl

from btr_mjx.gap.data import Recording
from tests.support.convention_logs import log, sines

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "gripper")
FPS = 50
XML = """<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.002" integrator="implicitfast"/>
<default><geom type="capsule" contype="0" conaffinity="0"/><joint damping="0.2" armature="0.01"/></default><worldbody>
<body><joint name="shoulder_pan" axis="0 0 1" range="-1.9 1.9"/><geom fromto="0 0 0 0 0 0.1" size="0.03" mass="0.3"/>
<body pos="0 0 0.1"><joint name="shoulder_lift" axis="0 1 0" range="-1.7 1.7"/>
<geom fromto="0 0 0 0.05 0 0.3" size="0.02" mass="0.8"/>
<body pos="0.05 0 0.3"><joint name="elbow_flex" axis="0 1 0" range="-1.6 1.6"/>
<geom fromto="0 0 0 0.25 0 0" size="0.018" mass="0.5"/>
<body pos="0.25 0 0"><joint name="gripper" axis="0 0 1" range="-0.2 1.6"/>
<geom fromto="0 0 0 0.08 0.01 0" size="0.01" mass="0.05"/></body></body></body></body></worldbody><actuator>
<position name="shoulder_pan" joint="shoulder_pan" kp="15" kv="1"/>
<position name="shoulder_lift" joint="shoulder_lift" kp="20" kv="1.5"/>
<position name="elbow_flex" joint="elbow_flex" kp="12" kv="0.8"/>
<position name="gripper" joint="gripper" kp="4" kv="0.1"/></actuator></mujoco>"""


def motions(count: int = 3, seconds: float = 5.0) -> list[Recording]:
    """Recordings of random motions at 50 Hz, without noise of their time stamps."""
    waves = [sines(np.random.default_rng(i), [0.8, 1.0, 1.0, 0.4], 2.0, 6.0) for i in range(count)]
    lifted = [
        lambda time, own=own: own(time) + [0.0, 0.0, 0.0, 0.6] * (1 - np.exp(-8 * time[:, None])) for own in waves
    ]
    return [log(XML, wave, i, seconds, FPS) for i, wave in enumerate(lifted)]


def counted(values: np.ndarray, step: float | np.ndarray) -> np.ndarray:
    """Values as multiples of a step, from half a step on, as LeRobot's zeros between two counts are."""
    return (np.round(values / step) + 0.5) * step


def degrees(qpos: np.ndarray) -> np.ndarray:
    """Numbers (N, 4) of a follower with use_degrees: three joints in counts of 360/4096, the gripper in per cent."""
    low, high = mujoco.MjModel.from_xml_string(XML).jnt_range[3]
    jaw = 100 * (qpos[:, 3:] - low) / (high - low)
    return np.hstack([counted(np.degrees(qpos[:, :3]), 360 / 4096), counted(jaw, 100 / 1173)])


def shares(qpos: np.ndarray, counts: Sequence[float] = (2500, 2200, 2000)) -> np.ndarray:
    """Numbers (N, 4) of a follower that counts calibrated ranges from -100 to 100."""
    half = np.array(counts) / 4096 * np.pi
    return np.hstack([counted(100 * qpos[:, :3] / half, 200 / np.array(counts)), degrees(qpos)[:, 3:]])


def write_lerobot(
    folder: Path,
    episodes: Sequence[tuple[np.ndarray, np.ndarray]],
    names: Any = tuple(f"{name}.pos" for name in NAMES),
    version: str = "v3.0",
) -> Path:
    """Write states and actions (K, n) of episodes.

    Args:
      folder: created.
      episodes: pairs of states and actions.
      names: of the numbers, as info.json has them.
      version: of the format.

    Returns:
      The folder.
    """
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    (folder / "meta").mkdir()
    features = {
        "observation.state": {"dtype": "float32", "names": names},
        "action": {"dtype": "float32", "names": names},
        "observation.images.front": {"dtype": "video", "names": ["height", "width", "channels"]},
    }
    info = {"codebase_version": version, "robot_type": "so101_follower", "fps": FPS, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for number, (state, action) in enumerate(episodes):
        count = len(state)
        columns = {
            "action": pl.Series(action.astype(np.float32), dtype=pl.Array(pl.Float32, action.shape[1])),
            "observation.state": pl.Series(state.astype(np.float32), dtype=pl.Array(pl.Float32, state.shape[1])),
            "timestamp": (np.arange(count) / FPS).astype(np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "task_index": np.zeros(count, int),
            "next.done": np.arange(count) == count - 1,
        }
        tables.append(pl.DataFrame(columns))
    if version == "v3.0":
        pl.concat(tables).write_parquet(data / "file-000.parquet")
    else:
        for number, table in enumerate(tables):
            table.write_parquet(data / f"episode_{number:06d}.parquet")
    return folder
