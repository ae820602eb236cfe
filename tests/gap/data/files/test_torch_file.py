"""PyTorch files made by hand in the form that torch.save writes, and files that would run code."""

import io
import os
import pickle
import zipfile
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from robot_logs import ARM, simulated_log

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.gap.data import open_logs
from btr_mjx.gap.data.files import torch_file
from btr_mjx.gap.data.files.torch_file import read_torch

LOG = simulated_log(ARM, 1.2).every(2)


class FloatStorage:
    """Stands for torch.FloatStorage in a pickle."""


def _rebuild_tensor_v2(*_: Any) -> None:
    """Stands for torch._utils._rebuild_tensor_v2 in a pickle."""


FloatStorage.__module__, _rebuild_tensor_v2.__module__ = "torch", "torch._utils"


class Tensor:
    def __init__(self, key: int, array: np.ndarray, strides: tuple[int, ...] | None = None, size: Any = None) -> None:
        self.key, self.array = str(key), array.astype("<f4")
        self.size = size or self.array.shape
        self.strides = strides or tuple(step // 4 for step in self.array.strides)


class TorchPickler(pickle._Pickler):  # the one in Python: it lets names be written that cannot be imported here
    def persistent_id(self, item: Any) -> Any:
        if isinstance(item, tuple) and item and item[0] == "storage":
            return item
        return None

    def save_global(self, item: Any, name: str | None = None) -> None:
        if item in (FloatStorage, _rebuild_tensor_v2):
            self.write(pickle.GLOBAL + f"{item.__module__}\n{item.__name__}\n".encode())
            self.memoize(item)
        else:
            super().save_global(item, name)

    dispatch: ClassVar[dict] = dict(pickle._Pickler.dispatch)

    def save_tensor(self, tensor: Tensor) -> None:
        storage = ("storage", FloatStorage, tensor.key, "cpu", tensor.array.size)
        self.save_reduce(_rebuild_tensor_v2, (storage, 0, tensor.size, tensor.strides, False, OrderedDict()))

    dispatch[Tensor] = save_tensor
    dispatch[type(_rebuild_tensor_v2)] = save_global
    dispatch[type] = save_global


def write_torch(
    path: Path, content: Any, tensors: list[Tensor], compression: int = zipfile.ZIP_STORED, protocol: int = 2
) -> Path:
    program = io.BytesIO()
    TorchPickler(program, protocol=protocol).dump(content)
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("archive/data.pkl", program.getvalue())
        archive.writestr("archive/version", "3\n")
        for tensor in tensors:
            archive.writestr(f"archive/data/{tensor.key}", tensor.array.tobytes())
    return path


def chirp(path: Path, protocol: int = 2, **more: Any) -> Path:
    """PACE's chirp_data.pt; positions are written column after column, as a transposed tensor is."""
    time, sent = Tensor(0, LOG.time), Tensor(2, LOG.ctrl)
    flipped = Tensor(1, np.ascontiguousarray(LOG.qpos.T), (1, len(LOG.time)), LOG.qpos.shape)
    return write_torch(
        path, {"time": time, "dof_pos": flipped, "des_dof_pos": sent, **more}, [time, flipped, sent], protocol=protocol
    )


def test_a_chirp_is_read_without_torch(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    data = open_logs(tmp_path / "arm.xml", [chirp(tmp_path / "chirp_data.pt")])
    found = np.concatenate([one.qpos for one in data.recordings])
    np.testing.assert_allclose(found, LOG.qpos, atol=1e-6)
    np.testing.assert_allclose(np.concatenate([one.ctrl for one in data.recordings]), LOG.ctrl, atol=1e-6)
    assert any("order of the model: shoulder, elbow" in note for note in data.recordings[0].notes)


def test_names_of_joints_in_the_file_win(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    file = chirp(tmp_path / "chirp_data.pt", joint_names=["elbow", "shoulder"])
    data = open_logs(tmp_path / "arm.xml", [file])
    np.testing.assert_allclose(data.recordings[0].qpos[:5], LOG.qpos[:5, ::-1], atol=1e-6)


@dataclass
class Evil:
    folder: Path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.folder),)


def test_nothing_of_the_file_is_run(tmp_path: Path) -> None:
    made = tmp_path / "made"
    pickle.loads(pickle.dumps(Evil(made)))
    assert made.is_dir()  # an ordinary unpickler runs it
    made.rmdir()
    file = write_torch(tmp_path / "evil.pt", {"time": Evil(made)}, [])
    with pytest.raises(InputError, match=r"holds the object posix\.mkdir; save a dictionary of tensors"):
        read_torch(file)
    assert not made.exists()


def test_nothing_of_this_process_is_changed(tmp_path: Path) -> None:
    """BUILD would set an attribute of the function that is named before it."""
    file = tmp_path / "x.pt"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a/data.pkl", b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n}X\x04\0\0\0evilK\x01sb0}.")
    with pytest.raises(InputError, match="holds the operation BUILD"):
        read_torch(file)
    assert not hasattr(torch_file._rebuild, "evil")


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_all_protocols_of_torch_are_read(tmp_path: Path, protocol: int) -> None:
    about = {"rate": 1000.5, "steps": 2**40, "joint_names": ["shoulder", "elbow"], "nested": {"a": (True, None)}}
    file = chirp(tmp_path / "x.pt", protocol, **about)
    assert set(read_torch(file)[0].columns) == {"time", "dof_pos/shoulder", "dof_pos/elbow"} | {
        f"des_dof_pos/{name}" for name in ("shoulder", "elbow")
    }


@pytest.mark.parametrize("size", [(10**9, 10**9), (601, 2), (-1, 2)])
def test_sizes_beyond_the_storage_are_refused(tmp_path: Path, size: tuple[int, ...]) -> None:
    tensor = Tensor(0, LOG.qpos, (2, 1), size)
    with pytest.raises(InputError, match="a tensor of size"):
        read_torch(write_torch(tmp_path / "x.pt", {"time": tensor}, [tensor]))
    still = Tensor(0, LOG.qpos, (0, 0), (10**6, 10**6))
    with pytest.raises(InputError, match="a tensor of size"):
        read_torch(write_torch(tmp_path / "x.pt", {"time": still}, [still]))


def test_other_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.pt"
    file.write_bytes(pickle.dumps({"time": 1}))
    with pytest.raises(DamagedFile, match=r"not a readable \.pt file"):
        read_torch(file)
    tensor = Tensor(0, np.zeros(100000))
    with pytest.raises(DamagedFile, match="are compressed"):
        read_torch(write_torch(file, {"time": tensor}, [tensor], zipfile.ZIP_DEFLATED))
    with pytest.raises(InputError, match="no tensor 'time'"):
        read_torch(write_torch(file, {"x": tensor}, [tensor]))
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a/data.pkl", b"\x80\x02}r\xff\xff\xff\xff.")
    with pytest.raises(InputError, match="a memo of 4294967295 objects"):
        read_torch(file)
