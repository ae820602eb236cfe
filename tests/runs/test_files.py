import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs import files


def test_json_is_strict(tmp_path):
    value = {"x": [math.nan, math.inf, -math.inf, 0.1], "y": np.float32(0.1), "z": np.array([1, 2]), "p": Path("a/b")}
    files.write_json(tmp_path / "result.json", value | {"none": None, "flag": np.bool_(True)})
    back = files.read_json(tmp_path / "result.json")
    assert back["x"] == ["NaN", "Infinity", "-Infinity", 0.1]
    assert math.isnan(float(back["x"][0]))
    assert float(back["x"][2]) == -math.inf
    assert np.float32(back["y"]) == np.float32(0.1)
    assert (back["z"], back["p"], back["none"], back["flag"]) == ([1, 2], "a/b", None, True)


@pytest.mark.parametrize("value", [{1: 2}, {"a": {1, 2}}, {"a": 1j}, {"a": np.array([None])}, {"a": b"x"}])
def test_json_refuses_and_leaves_the_old_file(tmp_path, value):
    files.write_json(tmp_path / "r.json", 1)
    with pytest.raises(TypeError, match="value"):
        files.write_json(tmp_path / "r.json", value)
    assert files.read_json(tmp_path / "r.json") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["r.json"]


@pytest.mark.parametrize("text", [b"", b'{"a": 1', b'{"a": NaN}', b'"\xff"'])
def test_damaged_json(tmp_path, text):
    (tmp_path / "r.json").write_bytes(text)
    with pytest.raises(DamagedFile, match=r"r\.json: not valid JSON"):
        files.read_json(tmp_path / "r.json")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    files.write_json(tmp_path / "sub" / "r.json", "old")

    def write_and_fail(error):
        with files.atomic_write(tmp_path / "sub" / "r.json") as file:
            file.write(b"half")
            raise error

    for error in (RuntimeError(), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            write_and_fail(error)
    assert files.read_json(tmp_path / "sub" / "r.json") == "old"
    assert [path.name for path in (tmp_path / "sub").iterdir()] == ["r.json"]


def sample_arrays():
    payloads = np.array([0x7FF8000000000001, 0xFFF0000000000123, 0x8000000000000000], np.uint64).view(np.float64)
    dtypes = "bool int8 int16 int32 int64 uint8 uint16 uint32 uint64 float16 float32 float64 complex64"
    arrays = {name: np.arange(-3, 3).astype(name).reshape(2, 3) for name in dtypes.split()}
    return arrays | {
        "payloads": payloads,
        "nan32": np.array([0x7FC00001, 0xFF800001], np.uint32).view(np.float32),
        "big": np.array([2**64 - 1], np.uint64),
        "scalar": np.float64(0.1),
        "empty": np.zeros((0, 4), np.float32),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(10)[::-3],
        "swapped": np.arange(3, dtype=">i4"),
        "names": np.array(["bl_5", "bl_14"]),
        "file": np.arange(2),
        "a/b": np.arange(2),
    }


@pytest.mark.parametrize("compress", [False, True])
def test_arrays_come_back_bit_for_bit(tmp_path, compress):
    arrays = sample_arrays()
    files.write_arrays(tmp_path / "a.npz", arrays, compress=compress)
    back = files.read_arrays(tmp_path / "a.npz", require_digest=True)
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        array = np.asarray(array)
        assert (back[name].dtype, back[name].shape) == (array.dtype, array.shape)
        assert back[name].tobytes() == array.tobytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as plain:
        assert set(plain.files) == set(arrays)
    files.write_arrays(tmp_path / "b.npz", arrays, compress=compress)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_arrays_that_need_pickle_are_refused(tmp_path):
    import ml_dtypes

    for array in (np.array([None, 1]), [{}], np.zeros(2, ml_dtypes.bfloat16)):
        with pytest.raises(TypeError, match="'x'"):
            files.write_arrays(tmp_path / "a.npz", {"x": array})
    np.savez(tmp_path / "evil.npz", x=np.array([{}], dtype=object))
    with pytest.raises(DamagedFile, match="Object arrays"):
        files.read_arrays(tmp_path / "evil.npz")
    np.save(tmp_path / "one.npy", np.arange(3))
    with pytest.raises(DamagedFile, match="not a readable"):
        files.read_arrays(tmp_path / "one.npy")
    np.savez(tmp_path / "foreign.npz", x=np.arange(3))
    assert files.read_arrays(tmp_path / "foreign.npz")["x"].tolist() == [0, 1, 2]
    with pytest.raises(DamagedFile, match="no checksum"):
        files.read_arrays(tmp_path / "foreign.npz", require_digest=True)
    with pytest.raises(FileNotFoundError):
        files.read_arrays(tmp_path / "absent.npz")


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_tables(tmp_path, suffix):
    table = {"step": [1, 2, 3], "x": [0.1, math.nan, math.inf], "y": [None, 1e-300, 1 / 3], "name": ["a", "b,c", 'd"']}
    path = tmp_path / f"t{suffix}"
    files.write_table(path, table)
    assert files.read_table(path).equals(pl.DataFrame(table))
    path.write_bytes(b"" if suffix == ".csv" else path.read_bytes()[:-5])
    with pytest.raises(DamagedFile, match=str(path)):
        files.read_table(path)
    with pytest.raises(InputError, match=r"\.parquet or \.csv, got '\.txt'"):
        files.write_table(tmp_path / "t.txt", table)


def test_figures(tmp_path):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([1, 2])
    files.write_figure(tmp_path / "figures" / "x.png", figure, dpi=50)
    files.write_figure(tmp_path / "x.svg", figure)
    data = (tmp_path / "figures" / "x.png").read_bytes()
    assert data[:4] == b"\x89PNG"
    assert int.from_bytes(data[16:20], "big") == 100
    assert b"<svg" in (tmp_path / "x.svg").read_bytes()
