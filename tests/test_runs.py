import dataclasses
import enum
import io
import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl
import pytest
import tyro

from btr_mjx import errors, files, progress
from btr_mjx.checkpoints import (
    checkpoint_path,
    generator_from_json,
    generator_to_json,
    list_checkpoints,
    load_latest,
    read_checkpoint,
    save_checkpoint,
)
from btr_mjx.configs import config_from_json, config_to_json, differences, read_config
from btr_mjx.environment import describe_environment, environment_changes, git_state
from btr_mjx.errors import DamagedFile, InputError, Interrupted, cli_errors, resume_command
from btr_mjx.runs import History, RunFolder

ROOT = Path(__file__).parents[1]


class Coding(enum.Enum):
    BINARY = 1
    GRAY = 2


@dataclass(frozen=True)
class Mutation:
    rate: float = 0.02
    coding: Coding = Coding.GRAY


@dataclass(frozen=True)
class Hidden:
    limbs: dict[str, float]


@dataclass(frozen=True)
class Measured:
    folder: Path


@dataclass(frozen=True)
class Config:
    out: Path = Path("runs/demo")
    resume: bool = False
    seed: int = 0
    unknown: tuple[str, ...] = ("bl_5", "bl_14")
    box: tuple[float, float] = (0.4, 1.6)
    engine: Literal["lanes", "mjx", "native"] | None = None
    stop: float = math.inf
    mutation: Mutation = field(default_factory=Mutation)
    reality: Hidden | Measured = field(default_factory=lambda: Hidden({"bl_5": 0.7}))
    ladder: list[tuple[int, float]] = field(default_factory=lambda: [(1, 0.5)])


# JSON and config


def test_config_round_trip(tmp_path):
    config = Config(stop=-math.inf, engine="mjx", reality=Measured(Path("data/x")), mutation=Mutation(1, Coding.BINARY))
    with RunFolder.create(tmp_path / "run", config):
        pass
    assert read_config(tmp_path / "run", Config) == config
    assert config_from_json(Config, config_to_json(Config())) == Config()
    text = (tmp_path / "run" / "config.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["stop"] == "-Infinity"


def test_config_from_the_command_line_is_the_config_of_the_file():
    config = tyro.cli(Config, args=["--seed", "3", "--mutation.rate", "0.5", "--unknown", "bl_3", "--engine", "native"])
    assert config_from_json(Config, json.loads(json.dumps(config_to_json(config)))) == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sead": 1}, r"sead: no such field; Config has out, resume, seed"),
        ({"seed": 1.5}, r"seed: expected int, got 1\.5"),
        ({"seed": True}, r"seed: expected int, got True"),
        ({"box": [1.0]}, r"box: expected a list of 2, got \[1\.0\]"),
        ({"unknown": [1]}, r"unknown\[0\]: expected str, got 1"),
        ({"engine": "warp"}, r"engine: expected one of 'lanes', 'mjx', 'native', got 'warp'"),
        ({"mutation": {"coding": "HEX"}}, r"mutation\.coding: expected one of BINARY, GRAY, got 'HEX'"),
        ({"stop": "many"}, r"stop: expected a number, got 'many'"),
        ({"reality": {}}, r"reality\.limbs: missing.*reality\.folder: missing"),
    ],
)
def test_config_refuses(change, message):
    with pytest.raises(InputError, match=message):
        config_from_json(Config, config_to_json(Config()) | change)


@dataclass(frozen=True)
class Twin:
    folder: Path


@dataclass(frozen=True)
class Ambiguous:
    source: Twin | Measured


@dataclass(frozen=True)
class Unsavable:
    thing: Any


def test_config_that_json_cannot_hold_is_a_bug_reported_before_anything_is_written(tmp_path):
    for config in (Ambiguous(Twin(Path("x"))), Unsavable(object()), Config(seed="3"), Config, 3):  # type: ignore[arg-type]
        with pytest.raises(TypeError):
            RunFolder.create(tmp_path / "run", config)
    assert list(tmp_path.iterdir()) == []


def test_differences_name_every_field():
    new = dataclasses.replace(Config(), seed=2, mutation=Mutation(0.2), box=(0.5, 1.6), out=Path("elsewhere"))
    found = differences(config_to_json(Config()), config_to_json(new), ignore=("out",))
    assert found == [
        "seed: saved 0, now 2",
        "box: saved [0.4, 1.6], now [0.5, 1.6]",
        "mutation.rate: saved 0.02, now 0.2",
    ]
    assert differences({"a": {"b": 1}}, {"a": None, "c": True}, ()) == [
        "a.b: saved 1, now (absent)",
        "a: saved (absent), now None",
        "c: saved (absent), now True",
    ]
    assert differences({"a": 1}, {"a": 1.0}) == []
    assert differences({"a": 1}, {"a": True}) == ["a: saved 1, now True"]
    assert differences({"a": {"b": 1}, "ab": 1}, {"a": {"b": 2}, "ab": 2}, ignore=("a",)) == ["ab: saved 1, now 2"]


def test_json_is_strict(tmp_path):
    value = {"x": [math.nan, math.inf, -math.inf, 0.1], "y": np.float32(0.1), "z": np.array([1, 2]), "p": Path("a/b")}
    files.write_json(tmp_path / "result.json", value | {"none": None, "flag": np.bool_(True), "coding": Coding.GRAY})
    back = files.read_json(tmp_path / "result.json")
    assert back["x"] == ["NaN", "Infinity", "-Infinity", 0.1]
    assert math.isnan(float(back["x"][0]))
    assert float(back["x"][2]) == -math.inf
    assert np.float32(back["y"]) == np.float32(0.1)
    assert (back["z"], back["p"], back["none"], back["flag"], back["coding"]) == ([1, 2], "a/b", None, True, "GRAY")


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


# Files


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
    with pytest.raises(DamagedFile, match="single"):
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


# Checkpoints


def save(folder, step, **options):
    state = {"genomes": np.arange(100) % (step + 2) == 0}
    return save_checkpoint(folder, step, state, {"best": math.nan, "step": step}, **options)


def test_checkpoints_keep_the_last_ones(tmp_path):
    assert load_latest(tmp_path) is None
    for step in range(5):
        save(tmp_path, step, keep=3)
    assert [step for step, _ in list_checkpoints(tmp_path)] == [2, 3, 4]
    latest = load_latest(tmp_path, warn=pytest.fail)
    assert (latest.step, latest.meta["step"], math.isnan(latest.meta["best"])) == (4, 4, True)
    assert latest.arrays["genomes"].dtype == bool
    assert list(latest.arrays) == ["genomes"]
    save(tmp_path, 3)  # the course is taken up again from step 2: what lay ahead is void
    assert [step for step, _ in list_checkpoints(tmp_path)] == [2, 3]
    save(tmp_path, 1_234_567)
    assert load_latest(tmp_path).step == 1_234_567


@pytest.mark.parametrize(
    ("step", "arrays", "keep", "error"),
    [
        (-1, {}, 2, ValueError),
        (0, {}, 1, ValueError),
        (0, {"__meta__": 1}, 2, ValueError),
        (0, {"x": [object()]}, 2, TypeError),
    ],
)
def test_checkpoint_arguments(tmp_path, step, arrays, keep, error):
    with pytest.raises(error):
        save_checkpoint(tmp_path, step, arrays, keep=keep)
    assert list(tmp_path.iterdir()) == []


def test_any_altered_byte_is_noticed(tmp_path):
    save(tmp_path, 7)
    path = save(tmp_path, 8)
    sound = path.read_bytes()
    rng = random.Random(0)
    for position in [*range(40), *range(len(sound) - 90, len(sound)), *rng.sample(range(len(sound)), 100)]:
        data = bytearray(sound)
        data[position] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    for length in [0, 1, 63, 64, 70, 71, 72, *rng.sample(range(len(sound)), 50), len(sound) - 1]:
        path.write_bytes(sound[:length])
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    for data in (sound + b"\0", bytes(len(sound)), sound + sound):
        path.write_bytes(data)
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    path.write_bytes(sound)
    assert read_checkpoint(path).step == 8


def test_a_damaged_checkpoint_gives_way_to_the_one_before(tmp_path):
    save(tmp_path, 1)
    path = save(tmp_path, 2)
    path.write_bytes(path.read_bytes()[:-100])
    lines: list[str] = []
    assert load_latest(tmp_path, warn=lines.append).step == 1
    assert len(lines) == 1
    assert lines[0].startswith("warning: ")
    assert "checkpoint-000002.npz" in lines[0]
    path.write_bytes(checkpoint_path(tmp_path, 1).read_bytes())
    assert load_latest(tmp_path, warn=lines.append).step == 1
    assert "was renamed, it holds step 1" in lines[-1]
    checkpoint_path(tmp_path, 1).write_bytes(b"")
    with pytest.raises(DamagedFile, match=r"no sound checkpoint.*000002.*000001.*another --out"):
        load_latest(tmp_path, warn=lines.append)


def test_fallback_warns_on_stderr(tmp_path, capfd):
    save(tmp_path, 1)
    save(tmp_path, 2).write_bytes(b"x")
    assert load_latest(tmp_path).step == 1
    assert capfd.readouterr().err.startswith("warning: ")


@pytest.mark.parametrize("bits", ["PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"])
def test_generator_state(bits):
    generator = np.random.Generator(getattr(np.random, bits)(np.random.SeedSequence(5, spawn_key=(3,))))
    generator.spawn(2)
    generator.random(5)
    generator.integers(10, dtype=np.uint32)  # leaves half a word in the buffer
    data = json.loads(json.dumps(generator_to_json(generator), allow_nan=False))
    assert all(abs(number) <= 2**53 for number in numbers(data))
    twin = generator_from_json(data)
    assert generator_to_json(twin) == data
    for a, b in ((generator, twin), (generator.spawn(1)[0], twin.spawn(1)[0])):
        assert a.integers(1000, size=3, dtype=np.uint32).tolist() == b.integers(1000, size=3, dtype=np.uint32).tolist()
        assert a.standard_normal(4).tobytes() == b.standard_normal(4).tobytes()


def numbers(value):
    if isinstance(value, dict):
        return [n for item in value.values() for n in numbers(item)]
    if isinstance(value, list):
        return [n for item in value for n in numbers(item)]
    return [value] if isinstance(value, int | float) else []


def test_generator_state_from_elsewhere():
    good = generator_to_json(np.random.default_rng(np.random.SeedSequence([1, 2**100])))
    assert generator_to_json(generator_from_json(good)) == good
    for bad in (
        {},
        {"bit_generator": "Dice"},
        {"bit_generator": "PCG64", "state": 3},
        good | {"bit_generator": "SFC64"},
    ):
        with pytest.raises(InputError, match="generator state"):
            generator_from_json(bad)


# History


def test_history_types_survive(tmp_path):
    rows = [
        {
            "step": 1,
            "x": np.float32(0.1),
            "mixed": 1,
            "none": None,
            "late": None,
            "s": np.array([0.4, 1.6]),
            "ok": True,
        },
        {"step": 2, "x": math.nan, "mixed": 2.5, "none": None, "late": "text", "s": [math.inf, 1.0], "ok": np.bool_(0)},
    ]
    whole, first = History(tmp_path / "a.parquet"), History(tmp_path / "b.parquet")
    first.write()
    for row in rows:
        whole.append(row)
    whole.write()
    first.append(rows[0])
    first.write()
    second = History(tmp_path / "b.parquet", files.read_table(tmp_path / "b.parquet").to_dicts())
    second.append(rows[1])
    second.write()
    assert files.read_table(tmp_path / "a.parquet").equals(files.read_table(tmp_path / "b.parquet"))
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    with pytest.raises(ValueError, match="expected the columns"):
        second.append({"step": 3})
    second.append(rows[1] | {"late": 5})
    with pytest.raises(TypeError, match="'late' mixes int, str"):
        second.write()
    with pytest.raises(ValueError, match="parquet"):
        History(tmp_path / "a.csv")


def test_history_is_cut_to_the_checkpoint(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        history = run.history("history.parquet")
        for step in range(3):
            history.append({"step": step, "half": 0})
            history.append({"step": step, "half": 1})
            run.save_checkpoint(step, {})
        history.append({"step": 3, "half": 0})
        history.write()
    checkpoint_path(run.path, 2).write_bytes(b"")
    with RunFolder.create(tmp_path / "run", Config(), resume=True) as run:
        checkpoint = run.load_latest()
        assert checkpoint.step == 1
        assert [row["step"] for row in run.history("history.parquet", checkpoint).rows] == [0, 0, 1, 1]
        assert len(run.history("other.parquet", checkpoint)) == 0
        assert len(run.history("history.parquet", None)) == 0
        files.write_table(run.path / "history.parquet", {"step": [0], "half": [0]})
        with pytest.raises(DamagedFile, match="holds 1 rows, the checkpoint counts on 4"):
            run.history("history.parquet", checkpoint)
        (run.path / "history.parquet").unlink()
        with pytest.raises(DamagedFile, match="missing, the checkpoint of step 1 needs it"):
            run.history("history.parquet", checkpoint)


# Run folders


def snapshot(folder):
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}


def test_an_existing_folder_is_left_alone(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        assert not run.resumed
        assert (run.path / "environment.json").exists()
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x")
    for folder in (tmp_path / "run", foreign):
        before = snapshot(folder)
        with pytest.raises(InputError, match=r"is not empty.*--resume.*--out"):
            RunFolder.create(folder, Config(seed=1))
        assert snapshot(folder) == before
    with pytest.raises(InputError, match=r"foreign is not a run folder: it holds no config\.json"):
        RunFolder.create(foreign, Config(), resume=True)
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]
    with pytest.raises(InputError, match="is a file"):
        RunFolder.create(foreign / "thesis.tex", Config())
    with pytest.raises(InputError, match="nothing to resume"):
        RunFolder.create(tmp_path / "typo", Config(), resume=True)
    assert not (tmp_path / "typo").exists()
    (tmp_path / "empty").mkdir()
    RunFolder.create(tmp_path / "empty", Config()).close()


def test_resume_needs_the_same_config(tmp_path):
    RunFolder.create(tmp_path / "run", Config()).close()
    before = snapshot(tmp_path / "run")
    other = Config(seed=5, mutation=Mutation(coding=Coding.BINARY), resume=True, out=Path("./runs/demo/."))
    with pytest.raises(
        InputError, match=r"seed: saved 0, now 5; mutation\.coding: saved 'GRAY', now 'BINARY'\).*--out"
    ) as caught:
        RunFolder.create(tmp_path / "run", other, resume=True)
    assert "resume:" not in str(caught.value)
    assert snapshot(tmp_path / "run") == before
    with pytest.raises(InputError, match="resume: saved False, now True"):
        RunFolder.create(tmp_path / "run", Config(resume=True), resume=True, ignore=())
    with RunFolder.create(tmp_path / "run", Config(resume=True), resume=True) as run:
        assert run.resumed
    assert read_config(tmp_path / "run", Config) == Config()
    assert len(files.read_json(tmp_path / "run" / "environment.json")["resumed"]) == 1


@pytest.mark.parametrize("left", [[], [".lock"], [".lock", ".config.json.0123.tmp"], [".lock", "config.json"]])
def test_a_create_that_was_killed_can_be_resumed(tmp_path, left):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in left:
        (folder / name).write_text("12345")
    if "config.json" in left:
        files.write_json(folder / "config.json", config_to_json(Config()))
    with RunFolder.create(folder, Config(), resume=True) as run:
        assert run.load_latest() is None
        assert {path.name for path in folder.iterdir()} == {".lock", "config.json", "environment.json"}


def test_damaged_config(tmp_path):
    RunFolder.create(tmp_path / "run", Config()).close()
    (tmp_path / "run" / "config.json").write_text('{"seed": ')
    with pytest.raises(DamagedFile, match=r"config\.json: not valid JSON"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    (tmp_path / "run" / "config.json").write_text("[]")
    with pytest.raises(DamagedFile, match="expected a JSON object"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    with pytest.raises(InputError, match="there is no such folder"):
        read_config(tmp_path / "typo", Config)


def test_one_writer_at_a_time(tmp_path):
    run = RunFolder.create(tmp_path / "run", Config())
    with pytest.raises(InputError, match=rf"in use by another run \(process {os.getpid()}\)"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    run.close()
    run.close()
    run = RunFolder.create(tmp_path / "run", Config(), resume=True)
    del run  # forgotten, not closed
    RunFolder.create(tmp_path / "run", Config(), resume=True).close()


# Environment


def test_environment(tmp_path):
    class Device:
        platform, id, device_kind = "cpu", 3, "cpu"

    now = describe_environment([Device()])
    json.dumps(now, allow_nan=False)
    assert now["versions"]["numpy"] == np.__version__
    assert now["versions"]["mujoco"] == now["versions"]["mujoco-mjx"]
    assert now["devices"] == ["cpu:3 cpu"]
    assert environment_changes(now, now) == []
    other = now | {"python": "3.99", "versions": now["versions"] | {"jax": "9"}, "devices": None, "start": "later"}
    jax = now["versions"]["jax"]
    assert environment_changes(now, other) == [
        f"python changed from {now['python']} to 3.99",
        f"jax changed from {jax} to 9",
    ]


def test_git_state(tmp_path, monkeypatch):
    assert git_state(tmp_path) is None
    git = ["git", "-C", str(tmp_path), "-c", "user.name=x", "-c", "user.email=x@example.org"]
    subprocess.run([*git, "init", "-q"], check=True)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "a.py").write_text("1")
    assert git_state(tmp_path / "site") is None
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*git, "commit", "-qm", "x", "--no-verify"], check=True)
    state = git_state(tmp_path / "site")
    assert len(state["commit"]) == 40
    assert state["dirty"] is False
    (tmp_path / "site" / "a.py").write_text("2")
    assert git_state(tmp_path / "site")["dirty"] is True
    monkeypatch.setenv("PATH", "")
    assert git_state(tmp_path / "site") is None


# Signals, kills and concurrency: real processes

WORKER = """
import os, random, signal, sys, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from btr_mjx.checkpoints import generator_from_json, generator_to_json, list_checkpoints
from btr_mjx.errors import cli_errors
from btr_mjx.files import write_json
from btr_mjx.progress import graceful_interrupt
from btr_mjx.runs import RunFolder

os.fsync = lambda descriptor: None  # slow, and against power cuts, not kills

@dataclass(frozen=True)
class Config:
    seed: int = 0
    steps: int = 80

@cli_errors(resume="again")
def work(folder, resume, pause=0.002):
    config = Config()
    with RunFolder.create(folder, config, resume=resume) as run, graceful_interrupt() as stop:
        checkpoint = run.load_latest()
        history = run.history("history.parquet", checkpoint)
        if checkpoint is None:
            rng, state, first = np.random.default_rng(config.seed), np.zeros(2000), 0
        else:
            rng, state = generator_from_json(checkpoint.meta["rng"]), checkpoint.arrays["state"]
            first = checkpoint.step + 1
        print(f"first {first}\\n", end="", flush=True)  # in one piece, whenever the kill comes
        for step in range(first, config.steps):
            state = np.sin(state + rng.standard_normal(2000))
            history.append({"step": step, "mean": float(state.mean()), "bad": np.nan if step % 3 else None})
            run.save_checkpoint(step, {"state": state}, {"rng": generator_to_json(rng)})
            stop.checkpoint()
            time.sleep(pause)
        write_json(run.path / "result.json", {"mean": state.mean(), "draw": rng.random(), "rows": len(history)})

def fork(folder, kill_after=None):
    # A fresh process without the second that imports take. Returns whether it came to its end.
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            work(folder, Path(folder).exists())
            code = 0
        finally:
            sys.stdout.flush()
            os._exit(code)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(pid, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    assert status in (0, -signal.SIGKILL), status
    return status == 0

def kill_often(whole, killed):
    start = time.monotonic()
    assert fork(whole)
    duration = time.monotonic() - start  # on this machine, under its present load
    print("killed", flush=True)
    rng = random.Random(3)
    kills = 0
    while not fork(killed, rng.choice([0.02, 0.1, 0.4]) * rng.random() * duration if kills < 24 else None):
        kills += 1
        if kills % 4 == 0 and len(found := list_checkpoints(killed)) == 2:
            # a disk that loses the end of the newest file
            found[-1][1].write_bytes(found[-1][1].read_bytes()[:200])
            print("damaged", flush=True)
    print("kills", kills, flush=True)

if sys.argv[1] == "kill":
    kill_often(*sys.argv[2:])
else:
    work(sys.argv[2], sys.argv[1] == "resume", pause=0.2)
"""


@pytest.fixture(scope="module")
def worker(tmp_path_factory):
    script = tmp_path_factory.mktemp("worker") / "worker.py"
    script.write_text(WORKER)
    # Without git, whose three calls would take most of the time and of the kills
    settings = {"PYTHONPATH": str(ROOT), "PATH": "", "POLARS_MAX_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def start(*arguments):
        command = [sys.executable, str(script), *map(str, arguments)]
        return subprocess.Popen(
            command,
            env=os.environ | settings,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=script.parent,
        )

    return start


def outcome(folder):
    """All files that two equal runs have in common."""
    names = [path.name for path in folder.iterdir() if path.name not in (".lock", "environment.json")]
    return {name: (folder / name).read_bytes() for name in sorted(names)}


def test_killed_runs_resume_to_the_same_bytes(worker, tmp_path):
    process = worker("kill", tmp_path / "whole", tmp_path / "killed")
    output, problems = process.communicate(timeout=120)
    assert process.returncode == 0, problems
    lines = output.split("killed\n")[1].splitlines()
    starts = [int(line.split()[1]) for line in lines if line.startswith("first")]
    assert int(lines[-1].removeprefix("kills ")) >= 10
    assert len(set(starts)) >= 4, starts
    assert "damaged" in lines
    assert problems.count("trying the checkpoint before it") >= 1
    assert "Traceback" not in problems
    expected = outcome(tmp_path / "whole")
    assert list(expected) == [
        "checkpoint-000078.npz",
        "checkpoint-000079.npz",
        "config.json",
        "history.parquet",
        "result.json",
    ]
    assert outcome(tmp_path / "killed") == expected


@dataclass(frozen=True)
class WorkerConfig:
    seed: int = 0
    steps: int = 0


def test_the_first_signal_stops_at_a_safe_point_and_the_lock_keeps_others_out(worker, tmp_path):
    folder = tmp_path / "run"
    process = worker("fresh", folder)
    assert process.stdout.readline() == "first 0\n"
    while not (folder / "checkpoint-000001.npz").exists():
        time.sleep(0.01)
    second = worker("resume", folder)
    _, problems = second.communicate(timeout=60)
    assert second.returncode == 2
    assert problems.startswith(f"error: {folder} is in use by another run (process {process.pid})")
    assert problems.count("\n") == 1
    process.send_signal(signal.SIGTERM)
    _, problems = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "stopping at the next safe point" in problems
    assert problems.endswith("stopped at a safe point (SIGTERM)\nresume with: again\n")
    assert "Traceback" not in problems
    RunFolder.create(folder, read_config(folder, WorkerConfig), resume=True).close()


# Interrupts in this process


def test_graceful_interrupt():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with progress.graceful_interrupt() as stop:
        stop.checkpoint()
        assert not stop.requested
        with progress.graceful_interrupt() as inner:
            assert inner is stop
        assert signal.getsignal(signal.SIGINT) == stop._handle
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested
        with pytest.raises(Interrupted, match=r"safe point \(SIGTERM\)") as caught:
            stop.checkpoint()
        assert caught.value.signum == signal.SIGTERM
        with pytest.raises(Interrupted, match=r"at once \(SIGINT\)"):
            signal.raise_signal(signal.SIGINT)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    assert not issubclass(Interrupted, Exception)


def test_graceful_interrupt_in_a_thread():
    import threading

    seen = []

    def work():
        with progress.graceful_interrupt() as stop:
            stop.checkpoint()
            seen.append(stop.requested)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]


# Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_is_silent_without_a_terminal(capfd):
    assert list(progress.progress(range(3), description="pairs")) == [0, 1, 2]
    with progress.progress(total=3, show=False, file=Terminal()) as bar:
        bar.update(3)
        bar.set_postfix(best=1)
    assert capfd.readouterr() == ("", "")


def test_progress_lines():
    stream = io.StringIO()
    with progress.progress(
        total=4000, description="scan", unit="pairs", unit_scale=True, show=True, file=stream
    ) as bar:
        for _ in range(4):
            bar.update(1000)
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2  # the beginning and the end: it took less than an interval
    assert lines[0].startswith("scan: 0% 0.00/4.00k [")
    assert lines[1].startswith("scan: 100% 4.00k/4.00k [00:00<00:00, ")
    assert "pairs/s" in lines[1]
    stream = io.StringIO()
    for _ in progress.progress(range(2), description="outer", show=True, interval=0, file=stream):
        for _ in progress.progress(iter(range(2)), description="inner", show=True, interval=0, file=stream):
            pass
    assert not set(stream.getvalue()) & set("\r\x1b")
    assert [line.split(" [")[0] for line in stream.getvalue().splitlines()].count("inner: 2 it") == 2
    assert stream.getvalue().splitlines()[-1].startswith("outer: 100% 2/2")
    stream = io.StringIO()
    with progress.progress(total=2, show=True, interval=0, file=stream) as bar:
        bar.update()
        bar.set_description("late")
    assert [line.split(" [")[0] for line in stream.getvalue().splitlines()] == ["0% 0/2", "50% 1/2", "late: 50% 1/2"]


def test_progress_bar_on_a_terminal():
    stream = Terminal()
    with progress.progress(total=2, description="outer", file=stream) as outer:
        for _ in progress.progress(range(2), description="inner", file=stream):
            outer.update()
    assert "\r" in stream.getvalue()
    assert "outer: 100%" in stream.getvalue()


# The boundary of commands


class OurError(ValueError):
    __module__ = "btr_mjx.engines.base"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("m is 9, expected m < M;\n  give fewer"), "error: m is 9, expected m < M; give fewer"),
        (OurError("unsupported"), "error: unsupported"),
        (FileNotFoundError(2, "No such file or directory", "x.csv"), "error: x.csv: No such file or directory"),
        (PermissionError(13, "Permission denied", "a", None, Path("b")), "error: a -> b: Permission denied"),
        (OSError("odd"), "error: odd"),
        (InputError(), "error: InputError"),
    ],
)
def test_bad_input_is_one_line(error, line, capsys):
    @cli_errors()
    def command():
        raise error

    with pytest.raises(SystemExit) as caught:
        command()
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", line + "\n")


@pytest.mark.parametrize(
    "error", [TypeError(), AssertionError(), ValueError("numpy"), KeyError(1), RuntimeError(), SystemExit(7)]
)
def test_bugs_pass(error, capsys):
    with pytest.raises(type(error)) as caught, cli_errors():
        raise error
    assert caught.value is error
    assert capsys.readouterr().err == ""


def test_traceback_on_request(monkeypatch):
    monkeypatch.setenv("BTR_MJX_TRACEBACK", "1")
    with pytest.raises(InputError), cli_errors():
        raise InputError("x")


def test_interrupts_exit_with_130(capsys):
    for error, text in ((KeyboardInterrupt(), "interrupted"), (Interrupted("stopped"), "stopped")):
        with pytest.raises(SystemExit) as caught, cli_errors(), cli_errors(resume="python -m x --resume"):
            raise error
        assert caught.value.code == 130
        assert capsys.readouterr().err == f"\n{text}\nresume with: python -m x --resume\n"
    assert errors.one_line(Interrupted()) == "interrupted"


def test_resume_command(monkeypatch):
    command = resume_command("btr_mjx.coevolve", ["--seed", "3", "--no-resume", "--note", "a b"], out=Path("runs/x"))
    assert command == "python -m btr_mjx.coevolve --seed 3 --note 'a b' --out runs/x --resume"
    monkeypatch.setattr(sys, "argv", ["x.py", "--out=y", "--resume"])
    assert resume_command("btr_mjx.scan", out="y") == "python -m btr_mjx.scan --out=y --resume"
