"""Kinds of hostile input, each with a few of its inputs: one clear line, in seconds."""

import io
import os
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest
from hostile.inputs import DATASET, LEROBOT, LEROBOT_INFO, SERVO, XML
from hostile.mutations import to_json, to_toml
from hostile.parsers import write_input

from btr_mjx.errors import DamagedFile, InputError, one_line
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.preflight import preflight
from btr_mjx.models import check_mjcf, parse_path, set_values
from btr_mjx.runs import read_arrays, read_json, read_table, read_toml, write_table


@pytest.fixture(autouse=True)
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No input takes long, however it ends."""
    monkeypatch.chdir(tmp_path)
    mujoco.set_mju_user_warning(lambda _: None)
    begin = time.process_time()
    yield
    assert time.process_time() - begin < 20


def short(value: object) -> str:
    """Name of a case."""
    return (value if isinstance(value, str) else repr(value))[:30]


TIME = 0.01 * np.arange(80)
COLUMNS = {"time": TIME, "ctrl/servo": np.sin(5 * TIME), "qpos/servo": 0.5 * np.sin(5 * TIME - 0.2)}


def dataset(folder: Path, *, toml: str = "", xml: str = XML, columns: dict[str, np.ndarray] | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "dataset.toml").write_text(toml or to_toml(dict(DATASET)))
    (folder / "model.xml").write_text(xml)
    write_table(folder / "one.csv", columns or COLUMNS)
    write_table(folder / "two.csv", COLUMNS)
    return folder


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        preflight(open_dataset(folder))
    line = one_line(caught.value)
    assert len(line) <= 1000
    assert line.isprintable()
    return line


@pytest.mark.parametrize(
    "path",
    ["body_rootid[1]", "jnt_dofadr[0]", "geom_bodyid[0]", "actuator_trnid[0][0]", "dof_parentid[0]", "nq"],
)
def test_fields_that_are_no_physical_numbers_have_no_path(path: str) -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    with pytest.raises(InputError, match=r"physical numbers|expected KIND"):
        parse_path(model, path)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("option/timestep", -0.5),
        ("option/timestep", 1e-12),
        ("option/timestep", float("nan")),
        ("body:arm/mass", float("inf")),
        ("joint:servo/armature", -1e-3),
        ("joint:servo/damping", -1.0),
        ("body_mass[1]", -2.0),
        ("geom_friction[0][0]", -0.1),
        ("actuator:servo/kp", 1e300),
    ],
)
def test_numbers_that_cannot_be_simulated(path: str, value: float) -> None:
    with pytest.raises(InputError, match="expected"):
        set_values(mujoco.MjModel.from_xml_string(XML), {path: value})


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('timestep="0.002"', 'timestep="-inf"', "timestep"),
        ('timestep="0.002"', 'timestep="1e-9"', "timestep"),
        ('damping="0.04"', 'damping="nan"', "dof_damping"),
        ('armature="0.002"', 'armature="-3"', "armature"),
        ('kp="1.6"', 'kp="inf"', "actuator"),
        ('damping="0.04"', 'damping="1e200"', "dof_damping"),
        (
            "<worldbody>",
            '<worldbody><replicate count="500"><replicate count="400"><site/></replicate></replicate>',
            "elements",
        ),
        ("<worldbody>", '<size memory="900G"/><worldbody>', "memory"),
        ("<worldbody>", '<size nuserdata="2000000000"/><worldbody>', "nuserdata"),
        ("<worldbody>", '<option iterations="2000000000"/><worldbody>', "iterations"),
        (
            "<worldbody>",
            '<asset><texture name="t" builtin="flat" type="2d" width="90000" height="9"/></asset><worldbody>',
            "w",
        ),
        ("<worldbody>", '<asset><mesh name="m" file="/dev/zero.obj"/></asset><worldbody>', "outside"),
        ("<worldbody>", '<include file="../../secret.xml"/><worldbody>', "outside"),
        ("<worldbody>", '<worldbody><flexcomp type="grid" count="99 99 99" spacing="1 1 1" name="f"/>', "elements"),
        ("<worldbody>", "<worldbody>" + "<frame>" * 400 + "</frame>" * 400, "nested"),
    ],
    ids=short,
)
def test_mjcf(tmp_path: Path, old: str, new: str, named: str) -> None:
    assert named in refusal(dataset(tmp_path / "d", xml=XML.replace(old, new)))


def test_mjcf_in_another_encoding(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "d")
    (folder / "model.xml").write_bytes(XML.replace('name="tip"', 'name="Spitze für Öl"').encode("cp1252"))
    assert "UTF-8" in refusal(folder)


def test_comments_with_two_hyphens_are_fine() -> None:
    """XML forbids them, MuJoCo does not, and models have them."""
    check_mjcf(XML.replace("<worldbody>", "<!-- a -- b --><worldbody>"), "x.xml", Path("."))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('"relative" = false', '"relative" = "yes"', "relative"),
        ("[0.0, 2.0]", "[0, 0x" + "f" * 4000 + "]", "digits"),
        ("[0.0, 2.0]", "[0, " + "8" * 5000 + "]", "TOML"),
        ("[0.0, 2.0]", "[-1e308, 1e308]", "finite"),
        ("[0.0, 2.0]", "[-1.0, 2.0]", "dof_damping"),
        ('"body:arm/mass" = 0.5', '"body:arm/mass" = -0.5', "mass"),
        ('"body:arm/mass" = 0.5', '"body_parentid[1]" = 0', "physical"),
        ('"body:arm/mass" = 0.5', '"body:arm/mass" = true', "overrides"),
        ('"one.csv"', '"/etc/hostname"', "inside"),
        ('"one.csv"', '"a/../../one.csv"', "inside"),
        ('"model.xml"', '"../model.xml"', "inside"),
        ('"viscous_damping" = 0.1', '"viscous_damping" = nan', "tolerances"),
        ('"model"]', '"model"]\na = ' + "{b = " * 400 + "1" + "}" * 400, "TOML|nested"),
    ],
    ids=short,
)
def test_dataset_toml(tmp_path: Path, old: str, new: str, named: str) -> None:
    text = to_toml(dict(DATASET))
    assert old in text
    line = refusal(dataset(tmp_path / "d", toml=text.replace(old, new)))
    assert any(word in line for word in named.split("|"))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda c: c | {"time": np.where(np.arange(80) == 60, 3e7, TIME)}, "time"),
        (lambda c: c | {"time": 1e10 * np.arange(80)}, "looks like nanoseconds"),
        (lambda c: c | {"qpos/servo": np.where(np.arange(80) == 7, -1e300, 0.1)}, "row 8"),
        (lambda c: c | {f"sensor/{i}": TIME for i in range(7000)}, "columns"),
    ],
)
def test_recordings(tmp_path: Path, change, named: str) -> None:
    assert named in refusal(dataset(tmp_path / "d", columns=change(COLUMNS)))


def test_a_recording_with_a_pause_is_read(tmp_path: Path) -> None:
    """Twenty seconds of nothing split a recording, and are no reason to refuse the file."""
    later = COLUMNS | {"time": np.where(np.arange(80) >= 40, TIME + 20, TIME)}
    assert preflight(open_dataset(dataset(tmp_path / "d", columns=later)))


@pytest.mark.parametrize(
    "time", [np.concatenate([TIME[:-1], [5e6]]), 1.7e18 + 1e9 * TIME, 1e6 * TIME], ids=["late", "ns", "us"]
)
def test_times_of_other_units_and_late_stamps_cost_no_memory(tmp_path: Path, time: np.ndarray) -> None:
    found = open_dataset(dataset(tmp_path / "d", columns=COLUMNS | {"time": time})).recordings
    assert sum(len(one.time) for one in found) >= 158
    assert all(np.ptp(one.time) < 1.01 * np.ptp(TIME) for one in found)


def npz(path: Path, members: dict[str, bytes], compress: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", compress) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def head(shape: str, kind: str = "<f8") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("members", "named"),
    [
        ({"time.npy": b"just text"}, "no array"),
        ({"notes.txt": b"x"}, "no array"),
        ({"time.npy": head("(10**9,)")}, "not a readable"),
        ({"time.npy": head("(999999999999,)")}, "not a readable"),
        ({"time.npy": head("(-1,)") + b"x" * 8}, "not a readable"),
        ({"time.npy": head("(1,)", "|O") + b"x" * 8}, "Object arrays"),
        ({"time.npy": head("(" * 3000)}, "not a readable"),
        ({"time.npy": bytes(300 << 20)}, "unpack"),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_npz(tmp_path: Path, members: dict[str, bytes], named: str) -> None:
    with pytest.raises(InputError, match=named):
        read_arrays(npz(tmp_path / "a.npz", members))


def test_parquet_that_is_cut_or_panics_is_damaged(tmp_path: Path) -> None:
    """Panics of polars do not derive from Exception."""
    buffer, bad = io.BytesIO(), 0
    pl.DataFrame(COLUMNS).write_parquet(buffer)
    data = buffer.getvalue()
    for place in range(4, len(data), len(data) // 12):
        for damaged in (data[:place], data[:place] + b"\xff\xff\xff\x7f" + data[place + 4 :]):
            (tmp_path / "a.parquet").write_bytes(damaged)
            try:
                read_table(tmp_path / "a.parquet")
            except DamagedFile:
                bad += 1
    assert bad > 12


def test_parquet_of_very_many_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run-length code holds a constant in a few bytes."""
    pl.select(a=pl.repeat(1, 1000)).write_parquet(tmp_path / "a.parquet")
    assert read_table(tmp_path / "a.parquet").height == 1000
    monkeypatch.setattr("btr_mjx.runs.files.MAX_CELLS", 999)
    with pytest.raises(InputError, match="declares 1000 values, at most 999"):
        read_table(tmp_path / "a.parquet")


HEADER = {"dataset.toml": to_toml(dict(LEROBOT)).encode(), "model.xml": XML.encode()}


@pytest.mark.parametrize(
    "info",
    [
        None,
        [],
        {"features": []},
        {"features": {"observation.state": None}},
        {"features": {"observation.state": {"names": [1]}}},
        {"features": {"observation.state": {"names": "servo"}, "action": 3}},
        LEROBOT_INFO
        | {"features": {"observation.state": {"names": ["servo", "servo"]}, "action": {"names": ["servo"]}}},
    ],
)
def test_lerobot_info(tmp_path: Path, info: object) -> None:
    write_input(
        {
            "dataset.toml": to_toml(dict(LEROBOT)).encode(),
            "model.xml": XML.encode(),
            "meta/info.json": to_json(info).encode(),
        },
        tmp_path,
    )
    write_table(tmp_path / "data" / "a.parquet", {"timestamp": [0.0]})
    assert "info.json" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("column", "values", "named"),
    [
        ("timestamp", ["noon"] * 80, "timestamp"),
        ("episode_index", [float("nan")] * 80, "episode_index"),
        ("episode_index", ["a"] * 80, "episode_index"),
        ("episode_index", [-1] * 80, "episode_index"),
        ("action", [[1.0, 2.0]] * 80, "numbers a row"),
        ("action", [["x"]] * 80, "expected numbers"),
        ("observation.state", [{"a": 1}] * 80, "expected numbers"),
    ],
)
def test_lerobot_frames(tmp_path: Path, column: str, values: list, named: str) -> None:
    write_input(HEADER | {"meta/info.json": to_json(dict(LEROBOT_INFO)).encode()}, tmp_path)
    frame = {
        "timestamp": TIME,
        "episode_index": [0] * 80,
        "action": [[u] for u in COLUMNS["ctrl/servo"]],
        "observation.state": [[q] for q in COLUMNS["qpos/servo"]],
    }
    write_table(tmp_path / "data" / "a.parquet", pl.DataFrame(frame | {column: values}))
    assert named in refusal(tmp_path)


@pytest.mark.parametrize(
    ("key", "value"),
    [("unit", 3), ("folder", 3), ("folder", ".."), ("joints", [1]), ("joints", {"servo": 3}), ("joints", {"x": {}})]
    + [
        ("joints", {"servo": {key: value}}) for key in ("joint", "sign", "zero", "range", "unit") for value in ([], "x")
    ],
)
def test_lerobot_tables(tmp_path: Path, key: str, value: object) -> None:
    toml = to_toml(dict(LEROBOT) | {"lerobot": {key: value}}).encode()
    files = {"dataset.toml": toml, "model.xml": XML.encode(), "meta/info.json": to_json(dict(LEROBOT_INFO)).encode()}
    write_input(files, tmp_path)
    assert "lerobot" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", 1e150),
        ("length", -1),
        ("kp", None),
        ("vin", "12"),
        ("entries", [1, 2]),
        ("entries", {}),
        ("mass", 10**400),
    ],
    ids=short,
)
def test_servo(tmp_path: Path, name: str, value: object) -> None:
    entries = [{"timestamp": t, "goal_position": u, "position": q} for t, u, q in zip(*COLUMNS.values(), strict=True)]
    record = {"mass": 0.5, "length": 0.1, "kp": 32, "vin": 15.0, "entries": entries} | {name: value}
    files = {"servo.toml": to_toml(dict(SERVO)).encode(), "a.json": to_json(record).encode()}
    write_input(files, tmp_path)
    assert "a.json" in refusal(tmp_path)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, "9" * 5000, '{"a": ' * 3000, "nul", "", "\ufeff{}", "[NaN]"], ids=short
)
def test_json(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DamagedFile, match=r"a\.json"):
        read_json(tmp_path / "a.json")


def test_devices_and_pipes_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.toml")
    for path in (tmp_path / "a.toml", Path("/dev/zero"), tmp_path):
        with pytest.raises(InputError, match="expected a"):
            read_toml(path)
