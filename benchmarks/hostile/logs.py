"""Recordings of every format as hostile inputs."""

import io
import json
import zipfile
from collections.abc import Mapping
from random import Random
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.runs import write_table
from hostile import mutations as mutate
from hostile.inputs import (
    LEROBOT,
    LEROBOT_INFO,
    SERVO,
    XML,
    base_columns,
    base_csv,
    bytes_or,
    dataset_files,
    input_folder,
    toml_bytes,
    with_recording,
)


def make_csv(random: Random) -> Mapping[str, bytes]:
    """Text with changed bytes, cells, rows or separators."""

    def structured() -> bytes:
        rows = [line.split(",") for line in base_csv().decode().splitlines()]
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

    return dataset_files(one=bytes_or(random, base_csv(), structured))


def odd_columns(random: Random) -> dict[str, Any]:
    """Columns of a recording, some of them absent, of another type, length or size."""
    columns: dict[str, Any] = dict(base_columns())
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


def make_npz(random: Random) -> Mapping[str, bytes]:
    """An .npz file with changed bytes, arrays or members."""

    def structured() -> bytes:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **odd_columns(random))
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
    np.savez(buffer, **dict[str, Any](base_columns()))
    return with_recording("one.npz", bytes_or(random, buffer.getvalue(), structured))


def make_parquet(random: Random) -> Mapping[str, bytes]:
    """A Parquet file with changed bytes or columns."""

    def plain(columns: Mapping[str, Any]) -> bytes:
        lists = {name: np.atleast_1d(np.asarray(array)).tolist() for name, array in columns.items()}
        buffer = io.BytesIO()
        try:
            frame = pl.DataFrame(lists)
            frame.write_parquet(buffer, compression=random.choice(("zstd", "snappy", "uncompressed", "gzip")))
        except Exception:
            return plain(base_columns())
        return buffer.getvalue()

    data = plain(base_columns())
    content = mutate.mutate_bytes(data, random) if random.random() < 0.7 else plain(odd_columns(random))
    return with_recording("one.parquet", content)


def _lerobot_frames() -> bytes:
    columns = base_columns()
    rows = len(columns["time"])
    frame = pl.DataFrame(
        {
            "timestamp": [*columns["time"], *columns["time"]],
            "episode_index": [0] * rows + [1] * rows,
            "observation.state": [[q] for q in np.degrees([*columns["qpos/servo"]] * 2)],
            "action": [[u] for u in np.degrees([*columns["ctrl/servo"]] * 2)],
        }
    )
    with input_folder() as folder:
        write_table(folder / "frames.parquet", frame)
        return (folder / "frames.parquet").read_bytes()


def make_lerobot(random: Random) -> Mapping[str, bytes]:
    """A LeRobot dataset whose description or settings are changed."""
    info, toml = json.dumps(LEROBOT_INFO).encode(), mutate.to_toml(dict(LEROBOT)).encode()
    if random.random() < 0.7:
        info = bytes_or(random, info, lambda: mutate.to_json(mutate.mutate_value(dict(LEROBOT_INFO), random)).encode())
    else:
        toml = bytes_or(random, toml, lambda: toml_bytes(mutate.mutate_value(dict(LEROBOT), random)))
    files = {"dataset.toml": toml, "model.xml": XML.encode(), "meta/info.json": info}
    return files | {"data/frames.parquet": _lerobot_frames()}


def make_servo(random: Random) -> Mapping[str, bytes]:
    """Records of a servo as JSON, of which one, or the settings, are changed."""
    columns = base_columns()
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
        files["0.json"] = bytes_or(random, plain, lambda: mutate.to_json(mutate.mutate_value(record, random)).encode())
    else:
        toml = bytes_or(random, toml, lambda: toml_bytes(mutate.mutate_value(dict(SERVO), random)))
    return files | {"servo.toml": toml}
