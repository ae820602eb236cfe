"""Valid files that hostile inputs start from, and their parts."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.robots import read_asset
from hostile import mutations as mutate

XML = (
    read_asset("pendulum.xml")
    .replace("</body>", '<site name="tip" pos="0 0 -0.12"/></body>')
    .replace('forcerange="-0.8 0.8"', 'forcerange="-0.8 0.8" ctrlrange="-1 1"')
)
TEMPLATE = XML.replace('mass="0.4"', 'mass="{{ a }}"').replace('kp="1.6"', 'kp="{{ 2 * b + 1 }}"')
DATASET: Mapping[str, Any] = {
    "model": {"file": "model.xml"},
    "control": {"interpolation": "linear"},
    "tolerances": {"viscous_damping": 0.1},
    "noise": {"qpos": 0.001, "qvel": 0.05},
    "parameter": [{"name": "damping", "path": "joint:servo/damping", "bounds": [0.0, 2.0], "relative": False}],
    "recording": [
        {"file": "one.csv", "split": "fit", "overrides": {"body:arm/mass": 0.5}},
        {"file": "two.csv", "split": "test"},
    ],
}
ROBOT: Mapping[str, Any] = {
    "model": "robot.xml",
    "point": "tip",
    "duration": 0.2,
    "fitness": "distance",
    "target": [0.0, 0.0, 1.0],
    "speed_limit": 20.0,
    "parameter": [{"name": "damping", "path": ["joint:servo/damping"], "bounds": [0.0, 2.0], "unit": "N m s/rad"}],
    "controller": {"signal": "sinusoid", "frequency": 1.5, "group": [{"motors": ["servo"], "sign": [1], "name": "g"}]},
}
LEROBOT_INFO: Mapping[str, Any] = {
    "codebase_version": "v2.1",
    "fps": 50,
    "features": {"observation.state": {"names": ["servo.pos"]}, "action": {"names": {"motors": ["servo"]}}},
}
LEROBOT: Mapping[str, Any] = {
    "model": {"file": "model.xml"},
    "lerobot": {
        "unit": "deg",
        "folder": ".",
        "joints": {"servo.pos": {"joint": "servo", "unit": "deg", "sign": -1, "zero": 0.0}},
    },
}
SERVO: Mapping[str, Any] = {
    "servo": {"kt": 1.5, "resistance": 3.0, "error_gain": 0.15, "max_duty": 1.0, "armature": 0.003}
}


def base_columns(count: int = 60) -> Mapping[str, np.ndarray]:
    """A recording of the servo: (count,) arrays by column name."""
    time = 0.01 * np.arange(count)
    angle = 0.4 * np.sin(7 * time) + 0.05 * np.cos(31 * time)
    command = 0.5 * np.sin(7 * time + 0.1)
    return {"time": time, "ctrl/servo": command, "qpos/servo": angle, "qvel/servo": np.gradient(angle, time)}


def base_csv() -> bytes:
    """The recording as text."""
    return pl.DataFrame(dict(base_columns())).write_csv().encode()


def bytes_or(random: Random, data: bytes, structured: Callable[[], bytes]) -> bytes:
    """The content with changed bytes, or a structured mutation of it."""
    return mutate.mutate_bytes(data, random) if random.random() < 0.4 else structured()


def dataset_files(**changed: bytes) -> Mapping[str, bytes]:
    """Files of a valid dataset by name, some of them replaced: `toml`, `xml`, `one`, `two`."""
    names = {"toml": "dataset.toml", "xml": "model.xml", "one": "one.csv", "two": "two.csv"}
    files = {"toml": mutate.to_toml(dict(DATASET)).encode(), "xml": XML.encode(), "one": base_csv(), "two": base_csv()}
    return {names[key]: value for key, value in (files | changed).items()}


def toml_bytes(value: Any) -> bytes:
    """A value as a TOML file."""
    return (mutate.to_toml(value) if isinstance(value, dict) else f"a = {mutate.to_json(value)}").encode()


def with_recording(name: str, content: bytes) -> Mapping[str, bytes]:
    """A dataset whose first recording is another file."""
    files = dict(dataset_files(toml=mutate.to_toml(dict(DATASET)).replace("one.csv", name).encode()))
    del files["one.csv"]
    return files | {name: content}


@contextmanager
def input_folder() -> Iterator[Path]:
    """A folder for files that are made on the way, and are gone behind it."""
    with tempfile.TemporaryDirectory(prefix="btr_mjx-hostile-") as folder:
        yield Path(folder)
