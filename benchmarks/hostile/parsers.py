"""The readers of files, each with a valid seed, a mutation and a way to run it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np

from btr_mjx.errors import is_bad_input, one_line
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.fitness_only import load_fitness, preflight_fitness
from btr_mjx.gap.preflight import preflight
from btr_mjx.models import check_robot, load_robot
from btr_mjx.robots import Box, Robot, Sinusoids, read_template
from btr_mjx.runs import read_checkpoint, write_arrays
from btr_mjx.runs.checkpoints import save_checkpoint
from hostile import mutations as mutate
from hostile.inputs import (
    DATASET,
    ROBOT,
    TEMPLATE,
    XML,
    bytes_or,
    dataset_files,
    input_folder,
    toml_bytes,
)
from hostile.logs import make_csv, make_lerobot, make_npz, make_parquet, make_servo
from hostile.robot_logs import make_hdf5, make_mcap, make_rosbag, make_torch


@dataclass(frozen=True)
class Parser:
    """A reader of files.

    Attributes:
      make: the files of an input, by name, from a source of random numbers.
      run: reads the folder that holds them.
    """

    make: Callable[[Random], Mapping[str, bytes]]
    run: Callable[[Path], object]


def run_input(parser: Parser, folder: Path) -> str:
    """Read an input as a command does.

    Returns:
      "accepted", or the message of a refusal.

    Raises:
      BaseException: what a command would not report in one line.
    """
    try:
        parser.run(folder)
    except Exception as error:
        if not is_bad_input(error):
            raise
        line = one_line(error)
        if len(line) > 2000 or not line.isprintable():
            raise AssertionError(f"the message is no line to be read: {line[:200]!r}...") from error
        return line
    return "accepted"


def _make_mjcf(random: Random) -> Mapping[str, bytes]:
    return dataset_files(xml=bytes_or(random, XML.encode(), lambda: mutate.mutate_mjcf(XML, random).encode()))


def _make_dataset_toml(random: Random) -> Mapping[str, bytes]:
    plain = mutate.to_toml(dict(DATASET)).encode()
    return dataset_files(toml=bytes_or(random, plain, lambda: toml_bytes(mutate.mutate_value(dict(DATASET), random))))


def _make_robot_toml(random: Random) -> Mapping[str, bytes]:
    plain = mutate.to_toml(dict(ROBOT)).encode()
    text = bytes_or(random, plain, lambda: toml_bytes(mutate.mutate_value(dict(ROBOT), random)))
    return {"robot.toml": text, "robot.xml": XML.encode()}


def _make_template(random: Random) -> Mapping[str, bytes]:
    plain = TEMPLATE.encode()
    return {"robot.xml.j2": bytes_or(random, plain, lambda: mutate.mutate_template(TEMPLATE, random).encode())}


def _run_template(folder: Path) -> None:
    file = folder / "robot.xml.j2"
    signal = Sinusoids((0,), (1,), (), -1, 1.0, (0.0,), (1.0,), (0.0,))
    box = Box(["amplitude", "phase"], 0.0, 1.0)
    text = read_template(file)
    robot = Robot("r", text, str(file), Box(["a", "b"], 0.1, 1.0), box, signal, (0.5, 0.5), point="tip")
    check_robot(robot)


def _make_checkpoint(random: Random) -> Mapping[str, bytes]:
    with input_folder() as folder:
        return _broken_checkpoint(random, folder)


def _broken_checkpoint(random: Random, folder: Path) -> Mapping[str, bytes]:
    path = save_checkpoint(folder, 3, {"x": np.arange(5.0)}, {"rng": [1, 2**100], "best": float("nan")})
    data = path.read_bytes()
    if random.random() < 0.5:
        return {path.name: mutate.mutate_bytes(data, random)}
    header = {"format": 1, "step": 3, "meta": {"a": [1, {"b": None}]}, "rows": {"generations": 3}}
    changed = mutate.to_json(mutate.mutate_value(header, random)).encode()
    if random.random() < 0.2:
        changed = mutate.mutate_bytes(changed, random)
    arrays = {"__meta__": np.frombuffer(changed, np.uint8), "x": np.arange(5.0)}
    if random.random() < 0.2:
        arrays["__meta__"] = np.zeros(3, random.choice(("f8", "U3", "i2")))
    write_arrays(path, arrays)
    return {path.name: path.read_bytes()}


def _make_fitness(random: Random) -> Mapping[str, bytes]:
    about = {"file": "one.csv", "body": "arm", "function": "distance", "duration": 0.2, "omega": 60.0}
    table = {"model": {"file": "model.xml"}, "fitness": about}
    head = "fitness,amplitude/servo,phase/servo,split\n"
    rows = "".join(f"{0.01 * i},{0.1 + 0.01 * i},{0.3 * i},{'fit' if i % 2 else 'test'}\n" for i in range(20))
    csv, toml = (head + rows).encode(), mutate.to_toml(table).encode()
    if random.random() < 0.5:
        csv = mutate.mutate_bytes(csv, random)
    else:
        toml = bytes_or(random, toml, lambda: toml_bytes(mutate.mutate_value(table, random)))
    return {"dataset.toml": toml, "model.xml": XML.encode(), "one.csv": csv}


def _run_dataset(folder: Path) -> None:
    preflight(open_dataset(folder))


def _run_robot(folder: Path) -> None:
    check_robot(load_robot(folder))


def _run_checkpoint(folder: Path) -> None:
    read_checkpoint(next(iter(folder.glob("*.npz"))))


def _run_fitness(folder: Path) -> None:
    preflight_fitness(load_fitness(folder))


PARSERS: Mapping[str, Parser] = {
    "template": Parser(_make_template, _run_template),
    "mjcf": Parser(_make_mjcf, _run_dataset),
    "robot": Parser(_make_robot_toml, _run_robot),
    "dataset": Parser(_make_dataset_toml, _run_dataset),
    "csv": Parser(make_csv, _run_dataset),
    "parquet": Parser(make_parquet, _run_dataset),
    "npz": Parser(make_npz, _run_dataset),
    "mcap": Parser(make_mcap, _run_dataset),
    "rosbag": Parser(make_rosbag, _run_dataset),
    "hdf5": Parser(make_hdf5, _run_dataset),
    "torch": Parser(make_torch, _run_dataset),
    "checkpoint": Parser(_make_checkpoint, _run_checkpoint),
    "lerobot": Parser(make_lerobot, _run_dataset),
    "servo": Parser(make_servo, _run_dataset),
    "fitness": Parser(_make_fitness, _run_fitness),
}
"""Readers by name."""


def write_input(files: Mapping[str, bytes], folder: Path) -> None:
    """Write the files of an input into an empty folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
