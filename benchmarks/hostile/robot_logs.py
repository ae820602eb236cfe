"""Recordings of robots as hostile inputs: ROS bags, HDF5 and PyTorch files."""

import io
import struct
import zipfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hostile import mutations as mutate
from hostile.inputs import base_columns, with_recording
from hostile.logs import odd_columns

_START = 1_760_000_000_000_000_000
"""Time stamp of the first message [ns]."""
_NAMES: Sequence[Sequence[str]] = ((), ("servo", "servo"), ("",), ("servo", "x"), ("x",), ("\x00",))
_NUMBERS: Sequence[Sequence[float]] = ((), (np.nan,), (0.0, 1.0), (1e308,), (np.inf,))


def make_mcap(random: Random) -> Mapping[str, bytes]:
    """An MCAP file whose bytes or messages are changed."""
    data = _bag("MCAP", None)["one.mcap"]
    content = mutate.mutate_bytes(data, random) if random.random() < 0.7 else _bag("MCAP", random)["one.mcap"]
    return with_recording("one.mcap", content)


def make_rosbag(random: Random) -> Mapping[str, bytes]:
    """The folder of a rosbag2 recording, of which one file is changed."""
    files = dict(_bag("SQLITE3", None))
    if random.random() < 0.7:
        name = random.choice(sorted(files))
        files[name] = mutate.mutate_bytes(files[name], random)
    else:
        files = dict(_bag("SQLITE3", random))
    recording = with_recording("bag", b"")
    return {name: data for name, data in recording.items() if name != "bag"} | {
        f"bag/{name}": data for name, data in files.items()
    }


def _bag(plugin: str, random: Random | None) -> Mapping[str, bytes]:
    return _plain_bag(plugin) if random is None else _written_bag(plugin, random)


@cache
def _plain_bag(plugin: str) -> Mapping[str, bytes]:
    return _written_bag(plugin, None)


def _written_bag(plugin: str, random: Random | None) -> Mapping[str, bytes]:
    """Files of a recording by name; with strange messages where a source of random numbers is given."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    columns = base_columns()
    rate = 0.0 if random is None else random.choice((0.02, 0.3, 1.0))

    def odd() -> bool:
        return random is not None and random.random() < rate

    with TemporaryDirectory() as parent:
        folder = Path(parent) / "one"
        with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as bag:
            topics: dict[str, Any] = {}
            for k, time in enumerate(columns["time"]):
                stamp = _START + round(1e9 * time)
                if odd() and random is not None:
                    stamp = random.choice((0, stamp - 10**9, 2**31 * 10**9 - 1, _START))
                names, position = ["servo"], np.array([columns["qpos/servo"][k]])
                velocity, effort = np.array([columns["qvel/servo"][k]]), np.array([])
                sent = np.array([columns["ctrl/servo"][k]])
                if random is not None:
                    names = list(random.choice(_NAMES)) if odd() else names
                    position = np.array(random.choice(_NUMBERS)) if odd() else position
                    velocity = np.array(random.choice(_NUMBERS)) if odd() else velocity
                    effort = np.array(random.choice(_NUMBERS)) if odd() else effort
                    sent = np.array(random.choice(_NUMBERS)) if odd() else sent
                clock = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
                header = kinds["std_msgs/msg/Header"](stamp=clock, frame_id="")
                layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
                state = kinds["sensor_msgs/msg/JointState"](
                    header=header, name=names, position=position, velocity=velocity, effort=effort
                )
                command = kinds["std_msgs/msg/Float64MultiArray"](layout=layout, data=sent)
                for topic, message in (("/joint_states", state), ("/commands", command)):
                    if topic not in topics:
                        topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=store)
                    raw = bytes(store.serialize_cdr(message, message.__msgtype__))
                    if odd() and random is not None:
                        raw = mutate.mutate_bytes(raw, random)
                    bag.write(topics[topic], _START + round(1e9 * time), raw)
        return {file.name: file.read_bytes() for file in folder.iterdir()}


def make_hdf5(random: Random) -> Mapping[str, bytes]:
    """An HDF5 file whose bytes, datasets or attributes are changed."""
    content = mutate.mutate_bytes(_plain_hdf5(), random) if random.random() < 0.6 else _written_hdf5(random)
    return with_recording("one.h5", content)


@cache
def _plain_hdf5() -> bytes:
    return _written_hdf5(None)


def _written_hdf5(random: Random | None) -> bytes:
    import h5py

    buffer = io.BytesIO()
    columns = base_columns() if random is None else odd_columns(random)
    with h5py.File(buffer, "w") as file:
        for name, values in columns.items():
            array = np.asarray(values)
            if array.dtype.kind not in "biufcSO" or (array.dtype.kind == "O" and array.ndim == 0):
                continue
            try:
                data = file.create_dataset(
                    name, data=array.astype(float) if array.dtype.kind == "O" else array, track_order=True
                )
            except (TypeError, ValueError):  # a name that is a group already, numbers that are none
                continue
            if random is not None and random.random() < 0.3:
                data.attrs[random.choice(("units", "names", "joint_names"))] = random.choice(
                    ("deg", "", "x" * 3000, [1, 2], np.nan, ["servo"], b"\xff\xfe")
                )
        if random is not None and random.random() < 0.2:
            file["link"] = random.choice((h5py.SoftLink("/link"), h5py.ExternalLink("/etc/passwd", "/"), file))
    return buffer.getvalue()


def make_torch(random: Random) -> Mapping[str, bytes]:
    """A file as torch.save writes it, of which the bytes, the pickle or the stored numbers are changed."""
    kind = random.random()
    if kind < 0.3:
        return with_recording("one.pt", mutate.mutate_bytes(_torch_file(_torch_program()), random))
    program = bytearray(_torch_program())
    if kind < 0.8:
        changed = mutate.mutate_bytes(bytes(program), random)
        return with_recording("one.pt", _torch_file(changed))
    words = (
        b"cos\nsystem\n",
        b"c__builtin__\neval\n",
        b"cnumpy\nload\n",
        b"Q",
        b"R",
        b"}",
        b"t",
        b"(",
        b"2",
        b"0",
        b".",
    )
    for _ in range(random.choice((1, 2, 5))):
        place = random.randrange(2, len(program))
        program[place : place + random.choice((0, 1, 4))] = random.choice(words)
    return with_recording("one.pt", _torch_file(bytes(program), random))


_TENSORS: Mapping[str, str] = {"time": "time", "dof_pos": "qpos/servo", "des_dof_pos": "ctrl/servo"}


@cache
def _torch_program() -> bytes:
    """The pickle of a dictionary of tensors."""
    rows = len(base_columns()["time"])
    program = b"\x80\x02}("
    for key, name in enumerate(_TENSORS):
        shape = (rows,) if name == "time" else (rows, 1)
        sizes = b"(" + b"".join(b"K" + bytes([size]) for size in shape) + b"t"
        strides = b"(" + b"K\x01" * len(shape) + b"t"
        storage = b"(" + _text("storage") + b"ctorch\nFloatStorage\n" + _text(str(key)) + _text("cpu")
        storage += b"K" + bytes([rows]) + b"tQ"
        tensor = b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + b"K\x00" + sizes + strides + b"\x89"
        program += _text(name) + tensor + b"ccollections\nOrderedDict\n)RtR"
    return program + b"u."


def _text(word: str) -> bytes:
    return b"X" + struct.pack("<I", len(word)) + word.encode()


def _torch_file(program: bytes, random: Random | None = None) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/data.pkl", program)
        archive.writestr("archive/version", "3\n")
        for key, name in enumerate(_TENSORS.values()):
            data = base_columns()[name].astype("<f4").tobytes()
            if random is not None and random.random() < 0.3:
                data = mutate.mutate_bytes(data, random)
            archive.writestr(f"archive/data/{key}", data)
    return buffer.getvalue()
