"""The readers of files, each with a valid seed, a mutation and a way to run it."""

import io
import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.errors import is_bad_input, one_line
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.fitness_only import load_fitness, preflight_fitness
from btr_mjx.gap.preflight import preflight
from btr_mjx.models import check_robot, load_robot
from btr_mjx.robots import Box, Robot, Sinusoids, read_template
from btr_mjx.runs import read_checkpoint, save_checkpoint, unreadable_parquet, write_arrays, write_table
from btr_mjx.testing.hostile import mutations as mutate

XML = """<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="servo" axis="0 -1 0" damping="0.04" armature="0.002"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.12" size="0.008" mass="0.03" contype="0" conaffinity="0"/>
      <geom name="weight" type="sphere" pos="0 0 -0.12" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
      <site name="tip" pos="0 0 -0.12"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="servo" kp="1.6" forcerange="-0.8 0.8" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
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
    "lerobot": {"degrees": True, "joints": {"servo": "servo"}, "actuators": {"servo.pos": "servo"}},
}
SERVO: Mapping[str, Any] = {
    "servo": {"kt": 1.5, "resistance": 3.0, "error_gain": 0.15, "max_duty": 1.0, "armature": 0.003}
}


@dataclass(frozen=True)
class Parser:
    """A reader of files.

    Attributes:
      make: the files of an input, by name, from a source of random numbers.
      run: reads the folder that holds them.
      screened: file that a child process reads before the reader does; many inputs share one child.
    """

    make: Callable[[Random], Mapping[str, bytes]]
    run: Callable[[Path], object]
    screened: str = ""


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


@cache
def _columns(count: int = 60) -> Mapping[str, np.ndarray]:
    time = 0.01 * np.arange(count)
    angle = 0.4 * np.sin(7 * time) + 0.05 * np.cos(31 * time)
    command = 0.5 * np.sin(7 * time + 0.1)
    return {"time": time, "ctrl/servo": command, "qpos/servo": angle, "qvel/servo": np.gradient(angle, time)}


@cache
def _csv() -> bytes:
    return pl.DataFrame(dict(_columns())).write_csv().encode()


def _bytes_or(random: Random, data: bytes, structured: Callable[[], bytes]) -> bytes:
    return mutate.mutate_bytes(data, random) if random.random() < 0.4 else structured()


def _dataset(**changed: bytes) -> Mapping[str, bytes]:
    names = {"toml": "dataset.toml", "xml": "model.xml", "one": "one.csv", "two": "two.csv"}
    files = {"toml": mutate.to_toml(dict(DATASET)).encode(), "xml": XML.encode(), "one": _csv(), "two": _csv()}
    return {names[key]: value for key, value in (files | changed).items()}


def _make_mjcf(random: Random) -> Mapping[str, bytes]:
    return _dataset(xml=_bytes_or(random, XML.encode(), lambda: mutate.mutate_mjcf(XML, random).encode()))


def _make_dataset_toml(random: Random) -> Mapping[str, bytes]:
    plain = mutate.to_toml(dict(DATASET)).encode()
    return _dataset(toml=_bytes_or(random, plain, lambda: _toml(mutate.mutate_value(dict(DATASET), random))))


def _toml(value: Any) -> bytes:
    return (mutate.to_toml(value) if isinstance(value, dict) else f"a = {mutate.to_json(value)}").encode()


def _make_csv(random: Random) -> Mapping[str, bytes]:
    def structured() -> bytes:
        rows = [line.split(",") for line in _csv().decode().splitlines()]
        for _ in range(random.choice((1, 2, 5))):
            row = random.choice(rows) if random.random() < 0.7 else rows[0]
            kind = random.randrange(6)
            if kind == 0 and row:
                del row[random.randrange(len(row))]
            elif kind == 1:
                rows.insert(random.randrange(len(rows)), list(row))
            elif kind == 2:
                row += ["x"] * random.choice((1, 6000))
            elif kind == 3:
                rows[random.randrange(len(rows))] = []
            elif row:
                words = (
                    *mutate.WORDS,
                    '"',
                    "1,5",
                    "#",
                    "1_000",
                    "0x1",
                    "1e400",
                    "nan",
                    "-inf",
                    "\x00",
                    "17" + "0" * 17,
                )
                row[random.randrange(len(row))] = random.choice(words)
        separator = random.choice((",", ",", ",", ";", "\t"))
        return random.choice(("\n", "\r\n", "\r", "\n\n")).join(separator.join(row) for row in rows).encode()

    return _dataset(one=_bytes_or(random, _csv(), structured))


def _with_recording(name: str, content: bytes) -> Mapping[str, bytes]:
    files = dict(_dataset(toml=mutate.to_toml(dict(DATASET)).replace("one.csv", name).encode()))
    del files["one.csv"]
    return files | {name: content}


def _odd_columns(random: Random) -> dict[str, Any]:
    columns: dict[str, Any] = dict(_columns())
    for _ in range(random.choice((1, 1, 2))):
        name = random.choice(list(columns) or ["x"])
        values = np.array(columns.get(name, [1.0]))
        kind = random.randrange(12)
        if kind == 0:
            columns.pop(name, None)
        elif kind == 1:
            columns[f"{name}/x"] = values
        elif kind == 2 and values.dtype.kind in "biuf":
            columns[name] = values.astype(random.choice(("int8", "bool", "float16", "U8", "complex64")))
        elif kind == 3:
            columns[name] = values[: random.randrange(len(values) + 1)] if values.ndim else values
        elif kind == 4:
            columns[name] = np.full(values.shape, random.choice((np.nan, np.inf, 1e308, -1.0, 0.0)))
        elif kind == 5 and values.dtype.kind == "f" and values.size:
            values = values.copy()
            values.flat[random.randrange(values.size)] = random.choice((np.nan, np.inf, 1e308, 1e6, -1e300, 1e18))
            columns[name] = values
        elif kind == 6:
            columns[name] = values.reshape(1, -1) if random.random() < 0.5 else np.float64(1)
        elif kind == 7 and values.dtype.kind == "f":
            columns[name] = values * random.choice((1e3, 1e6, 1e9, 1e18, 1e-12, 0.0, -1.0))
        elif kind == 8:
            columns |= {f"sensor/{i}": values for i in range(random.choice((3, 6000)))}
        elif kind == 9 and values.size:
            columns[name] = np.repeat(values, 2)
        elif kind == 10:
            columns[name] = values.astype("datetime64[s]" if values.dtype.kind == "i" else object)
        else:
            columns[random.choice(("qpos", "qvel", "ctrl", "time"))] = np.zeros((len(values) if values.ndim else 1, 3))
    return columns


def _make_npz(random: Random) -> Mapping[str, bytes]:
    def structured() -> bytes:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **_odd_columns(random))
        data = buffer.getvalue()
        if random.random() < 0.3:  # further members: text, promises of what is not there
            with zipfile.ZipFile(buffer, "a") as archive:
                head = (
                    f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10 ** random.randrange(19)},), }}".encode()
                )
                promise = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
                member = random.choice((("x.npy", b"no array"), ("x.txt", b"x"), ("x.npy", promise), ("x.npy", b"")))
                archive.writestr(*member)
            data = buffer.getvalue()
        return data

    buffer = io.BytesIO()
    np.savez(buffer, **dict[str, Any](_columns()))
    return _with_recording("one.npz", _bytes_or(random, buffer.getvalue(), structured))


def _make_parquet(random: Random) -> Mapping[str, bytes]:
    def plain(columns: Mapping[str, Any]) -> bytes:
        lists = {name: np.atleast_1d(np.asarray(array)).tolist() for name, array in columns.items()}
        buffer = io.BytesIO()
        try:
            frame = pl.DataFrame(lists)
            frame.write_parquet(buffer, compression=random.choice(("zstd", "snappy", "uncompressed", "gzip")))
        except Exception:
            return plain(_columns())
        return buffer.getvalue()

    data = plain(_columns())
    content = mutate.mutate_bytes(data, random) if random.random() < 0.7 else plain(_odd_columns(random))
    return _with_recording("one.parquet", content)


def _make_robot_toml(random: Random) -> Mapping[str, bytes]:
    plain = mutate.to_toml(dict(ROBOT)).encode()
    text = _bytes_or(random, plain, lambda: _toml(mutate.mutate_value(dict(ROBOT), random)))
    return {"robot.toml": text, "robot.xml": XML.encode()}


def _make_template(random: Random) -> Mapping[str, bytes]:
    plain = TEMPLATE.encode()
    return {"robot.xml.j2": _bytes_or(random, plain, lambda: mutate.mutate_template(TEMPLATE, random).encode())}


def _run_template(folder: Path) -> None:
    file = folder / "robot.xml.j2"
    signal = Sinusoids((0,), (1,), (), -1, 1.0, (0.0,), (1.0,), (0.0,))
    box = Box(["amplitude", "phase"], 0.0, 1.0)
    text = read_template(file)
    robot = Robot("r", text, str(file), Box(["a", "b"], 0.1, 1.0), box, signal, (0.5, 0.5), point="tip")
    check_robot(robot)


def _make_checkpoint(random: Random) -> Mapping[str, bytes]:
    buffer_folder = _scratch()
    path = save_checkpoint(buffer_folder, 3, {"x": np.arange(5.0)}, {"rng": [1, 2**100], "best": float("nan")})
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


@cache
def _scratch() -> Path:
    import tempfile

    return Path(tempfile.mkdtemp(prefix="btr_mjx-hostile-"))


@cache
def _lerobot_frames() -> bytes:
    columns = _columns()
    rows = len(columns["time"])
    frame = pl.DataFrame(
        {
            "timestamp": [*columns["time"], *columns["time"]],
            "episode_index": [0] * rows + [1] * rows,
            "observation.state": [[q] for q in np.degrees([*columns["qpos/servo"]] * 2)],
            "action": [[u] for u in np.degrees([*columns["ctrl/servo"]] * 2)],
        }
    )
    path = _scratch() / "frames.parquet"
    write_table(path, frame)
    return path.read_bytes()


def _make_lerobot(random: Random) -> Mapping[str, bytes]:
    info, toml = json.dumps(LEROBOT_INFO).encode(), mutate.to_toml(dict(LEROBOT)).encode()
    if random.random() < 0.7:
        info = _bytes_or(random, info, lambda: mutate.to_json(mutate.mutate_value(dict(LEROBOT_INFO), random)).encode())
    else:
        toml = _bytes_or(random, toml, lambda: _toml(mutate.mutate_value(dict(LEROBOT), random)))
    files = {"dataset.toml": toml, "model.xml": XML.encode(), "meta/info.json": info}
    return files | {"data/frames.parquet": _lerobot_frames()}


def _make_servo(random: Random) -> Mapping[str, bytes]:
    columns = _columns()
    entries = [
        {
            "timestamp": float(t),
            "goal_position": float(u),
            "position": float(q),
            "speed": float(v),
            "torque_enable": True,
        }
        for t, u, q, v in zip(*columns.values(), strict=True)
    ]
    record: dict[str, Any] = {"mass": 0.5, "length": 0.1, "kp": 32, "vin": 15.0, "entries": entries}
    files = {f"{i}.json": json.dumps(record).encode() for i in range(3)}
    toml = mutate.to_toml(dict(SERVO)).encode()
    if random.random() < 0.7:
        plain = files["0.json"]
        files["0.json"] = _bytes_or(random, plain, lambda: mutate.to_json(mutate.mutate_value(record, random)).encode())
    else:
        toml = _bytes_or(random, toml, lambda: _toml(mutate.mutate_value(dict(SERVO), random)))
    return files | {"servo.toml": toml}


def _make_fitness(random: Random) -> Mapping[str, bytes]:
    about = {"file": "one.csv", "body": "arm", "function": "distance", "duration": 0.2, "omega": 60.0}
    table = {"model": {"file": "model.xml"}, "fitness": about}
    head = "fitness,amplitude/servo,phase/servo,split\n"
    rows = "".join(f"{0.01 * i},{0.1 + 0.01 * i},{0.3 * i},{'fit' if i % 2 else 'test'}\n" for i in range(20))
    csv, toml = (head + rows).encode(), mutate.to_toml(table).encode()
    if random.random() < 0.5:
        csv = mutate.mutate_bytes(csv, random)
    else:
        toml = _bytes_or(random, toml, lambda: _toml(mutate.mutate_value(table, random)))
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
    "csv": Parser(_make_csv, _run_dataset),
    "parquet": Parser(_make_parquet, _run_dataset, screened="one.parquet"),
    "npz": Parser(_make_npz, _run_dataset),
    "checkpoint": Parser(_make_checkpoint, _run_checkpoint),
    "lerobot": Parser(_make_lerobot, _run_dataset),
    "servo": Parser(_make_servo, _run_dataset),
    "fitness": Parser(_make_fitness, _run_fitness),
}
"""Readers by name."""


def read_in_child(parser: Parser, folders: Sequence[Path]) -> Mapping[Path, str]:
    """What the child process refuses of many inputs, by folder; see `Parser.screened`.

    Returns:
      Messages by folder.
    """
    if not parser.screened:
        return {}
    return {
        path.parent: problem for path, problem in unreadable_parquet([f / parser.screened for f in folders]).items()
    }


def write_input(files: Mapping[str, bytes], folder: Path) -> None:
    """Write the files of an input into an empty folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
