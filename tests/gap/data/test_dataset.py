"""Datasets: round trip of writing and reading, and one-line errors for invalid input."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest
from gap_recordings import COUNT, MODEL, XML, smooth_recording

from btr_mjx.errors import InputError
from btr_mjx.gap.data import DatasetDescription, Format, Noise, control_columns, load, noise_of, save_dataset
from btr_mjx.gap.data.columns.model_columns import state_columns
from btr_mjx.gap.data.recordings.velocities import estimate_velocity
from btr_mjx.gap.data.writing import recording_columns
from btr_mjx.models import PathParameter, parse_path, part_names, set_values
from btr_mjx.runs import write_arrays


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A valid dataset of two CSV recordings."""
    recordings = [smooth_recording("one", rng), smooth_recording("two", rng, "test")]
    save_dataset(tmp_path, XML, recordings, file_format="csv")
    return tmp_path


@pytest.mark.parametrize("file_format", ["csv", "parquet", "npz"])
def test_write_read_round_trip(tmp_path: Path, rng: np.random.Generator, file_format: Format) -> None:
    recordings = [smooth_recording("one", rng), smooth_recording("two", rng, "test")]
    noise = Noise(np.array([1, 1, 1, 2, 2, 2, 3, 4, 4, 4]) * 1e-3, np.arange(1, 11) * 1e-2)
    believed = PathParameter("hip damping", ("joint:hip/damping",), 0.1, 2.0)
    pair = PathParameter("strength", ("actuator:hip_motor/kp", "actuator:hip_motor/kv"), 0.5, 2.0, relative=True)
    save_dataset(
        tmp_path,
        XML,
        recordings,
        DatasetDescription(
            parameters=[believed, pair],
            interpolation="cubic",
            tolerances={"viscous_damping": 0.1},
            noise=noise,
            overrides={"two": {"body:thigh/mass": 0.7}},
            models={"one": XML.replace('kp="20"', 'kp="30"')},
        ),
        file_format=file_format,
    )
    dataset = load(tmp_path)
    assert dataset.parameters == (believed, pair)
    assert dataset.recordings[0].interpolation == "cubic"
    assert dataset.tolerances == {"viscous_damping": 0.1}
    assert dataset.noise is not None
    np.testing.assert_allclose(dataset.noise.qpos, noise.qpos)
    np.testing.assert_allclose(dataset.noise.qvel, noise.qvel)
    for wrote, read in zip(recordings, dataset.recordings, strict=True):
        assert (read.name, read.split) == (wrote.name, wrote.split)
        np.testing.assert_array_equal(read.time, wrote.time)
        np.testing.assert_array_equal(read.ctrl, wrote.ctrl)
        np.testing.assert_allclose(read.qpos, wrote.qpos, atol=1e-15)
        np.testing.assert_array_equal(read.qvel, wrote.qvel)
        np.testing.assert_array_equal(read.force["hip_motor"], wrote.time)
        assert read.qvel_measured.all()
    assert [r.name for r in dataset.fit] == ["one"]
    assert [r.name for r in dataset.test] == ["two"]
    one, two = (r.model for r in dataset.recordings)
    assert one.actuator_gainprm[0, 0] == 30
    assert two.body("thigh").mass[0] == 0.7
    assert dataset.model.body("thigh").mass[0] == 0.5
    assert pair.value(one) == 1.0
    pair.write(one, 1.5)
    assert (one.actuator_gainprm[0, 0], one.actuator_biasprm[0, 1], one.actuator_biasprm[0, 2]) == (45, -45, -1.5)


def test_grouped_npz_arrays_equal_single_columns(tmp_path: Path, rng: np.random.Generator) -> None:
    recordings = [smooth_recording("one", rng), smooth_recording("two", rng)]
    save_dataset(
        tmp_path, XML, [r.part(slice(None), s, r.name) for r, s in zip(recordings, ("fit", "test"), strict=True)]
    )
    first, second = recordings
    write_arrays(tmp_path / "one.npz", {"time": first.time, "ctrl": first.ctrl, "qpos": first.qpos, "qvel": first.qvel})
    columns = recording_columns(second)
    columns = {k: v for k, v in columns.items() if not k.startswith("qpos/root/")} | {"qpos/root": second.qpos[:, :7]}
    write_arrays(tmp_path / "two.npz", columns)
    for wrote, read in zip(recordings, load(tmp_path).recordings, strict=True):
        np.testing.assert_allclose(read.qpos, wrote.qpos, atol=1e-15)
        np.testing.assert_array_equal(read.qvel, wrote.qvel)


def test_column_order_is_mujocos() -> None:
    positions, velocities = state_columns(MODEL)
    assert positions[:7] == [f"qpos/root/{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    assert positions[7:] == ["qpos/hip", *(f"qpos/wrist/{c}" for c in ("qw", "qx", "qy", "qz"))]
    assert velocities[:6] == [f"qvel/root/{c}" for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
    assert velocities[6:] == ["qvel/hip", *(f"qvel/wrist/{c}" for c in ("wx", "wy", "wz"))]
    assert (len(positions), len(velocities)) == (MODEL.nq, MODEL.nv)
    assert control_columns(MODEL) == ["ctrl/hip_motor"]


def test_unnamed_parts_get_a_name() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/><body name="c"><joint axis="0 1 0"/>'
        '<geom size=".1"/></body></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>'.replace(
            '<joint axis="0 1 0"/>', '<joint name="j" axis="0 1 0"/>'
        )
    )
    assert part_names(model, "joint") == ["b", "j"]
    assert part_names(model, "actuator") == ["j"]
    assert part_names(model, "geom") == ["geom0", "geom1"]


def test_velocities_are_estimated_where_not_measured(tmp_path: Path, rng: np.random.Generator) -> None:
    recordings = [smooth_recording("one", rng), smooth_recording("two", rng, "test")]
    save_dataset(tmp_path, XML, recordings, file_format="parquet")
    table = pl.read_parquet(tmp_path / "one.parquet").drop("qvel/hip")
    table.write_parquet(tmp_path / "one.parquet")
    read = load(tmp_path).recordings[0]
    assert read.qvel_measured.tolist() == [True] * 6 + [False] + [True] * 3
    assert any("estimated" in note and "hip" in note for note in read.notes)
    np.testing.assert_allclose(read.qvel[:, 6], recordings[0].qvel[:, 6], atol=2e-4)


def test_estimated_velocities_of_every_kind_of_joint(rng: np.random.Generator) -> None:
    recording = smooth_recording("one", rng)
    estimate = estimate_velocity(MODEL, recording.time, recording.qpos)
    np.testing.assert_allclose(estimate, recording.qvel, atol=2e-3)


def test_explicit_and_default_splits(tmp_path: Path, rng: np.random.Generator) -> None:
    recordings = [smooth_recording(f"r{i}", rng, "test" if i == 5 else "fit") for i in range(6)]
    save_dataset(tmp_path, XML, recordings)
    file = tmp_path / "dataset.toml"
    said = file.read_text()
    assert [r.split for r in load(tmp_path).recordings] == ["fit"] * 5 + ["test"]
    file.write_text("\n".join(line for line in said.splitlines() if not line.startswith("split")))
    assert [r.split for r in load(file).recordings] == ["fit"] * 4 + ["test"] * 2
    file.write_text(said.replace('split = "test"', 'split = "fit"'))
    with pytest.raises(InputError, match=r"all 6 recordings are in split 'fit'"):
        load(tmp_path)


def test_single_recording_is_split_in_time(tmp_path: Path, rng: np.random.Generator) -> None:
    save_dataset(tmp_path, XML, [smooth_recording("only", rng, count=90)])
    file = tmp_path / "dataset.toml"
    file.write_text(file.read_text().replace('split = "fit"\n', ""))
    first, second = load(tmp_path).recordings
    assert (first.split, second.split) == ("fit", "test")
    assert len(first.time) + len(second.time) == 90
    assert 0.6 < len(first.time) / 90 < 0.73


def test_rows_with_isolated_missing_values_are_dropped(folder: Path) -> None:
    table = pl.read_csv(folder / "one.csv")
    values = table["qpos/hip"].to_list()
    values[10], values[30] = None, float("nan")
    table.with_columns(pl.Series("qpos/hip", values)).write_csv(folder / "one.csv")
    read = load(folder).recordings[0]
    assert len(read.time) == COUNT - 2
    assert any("2 rows" in note for note in read.notes)


def test_quaternions_are_normalised_with_continuous_sign(folder: Path) -> None:
    table = pl.read_csv(folder / "one.csv")
    names = [f"qpos/root/{c}" for c in ("qw", "qx", "qy", "qz")]
    flipped = table.with_columns(
        [pl.when(pl.int_range(pl.len()) % 2 == 0).then(-1.02 * pl.col(n)).otherwise(pl.col(n)).alias(n) for n in names]
    )
    flipped.write_csv(folder / "one.csv")
    quat = load(folder).recordings[0].qpos[:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(quat, axis=1), 1, atol=1e-12)
    assert (np.sum(quat[1:] * quat[:-1], axis=1) > 0.9).all()


def edit_table(change: Callable[[pl.DataFrame], pl.DataFrame]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        change(pl.read_csv(folder / "one.csv")).write_csv(folder / "one.csv")

    return edit


def edit_text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return edit


def with_rows(column: str, rows: slice | np.ndarray, value: float) -> Callable[[Path], None]:
    def change(table: pl.DataFrame) -> pl.DataFrame:
        values = table[column].to_numpy().copy()
        values[rows] = value
        return table.with_columns(pl.Series(column, values))

    return edit_table(change)


def duplicate_header(folder: Path) -> None:
    lines = (folder / "one.csv").read_text().splitlines()
    (folder / "one.csv").write_text("\n".join([lines[0] + ",qpos/hip", *(line + ",0" for line in lines[1:])]))


BAD: list[tuple[str, Callable[[Path], None], str]] = [
    ("unknown joint", edit_table(lambda t: t.rename({"qpos/hip": "qpos/hipp"})), r"one\.csv.*'qpos/hipp'.*'qpos/hip'"),
    (
        "unknown actuator",
        edit_table(lambda t: t.rename({"ctrl/hip_motor": "ctrl/tail"})),
        r"no actuator.*ctrl/hip_motor",
    ),
    ("missing time", edit_table(lambda t: t.drop("time")), r"no column 'time'"),
    ("missing joint", edit_table(lambda t: t.drop("qpos/hip")), r"no column 'qpos/hip', but one of its velocity"),
    ("half a velocity", edit_table(lambda t: t.drop("qvel/root/vx")), r"'qvel/root/vx'; give all"),
    ("time goes back", with_rows("time", slice(20, 21), 0.01), r"time goes back.*row 21"),
    (
        "holes all over",
        with_rows("qpos/hip", np.arange(60) % 15 < 4, np.nan),
        r"0 parts at 3 holes.*20 samples in a row",
    ),
    ("all NaN", with_rows("qpos/hip", slice(None), np.nan), r"'qpos/hip' holds no finite"),
    ("no quaternion", with_rows("qpos/root/qw", slice(5, 6), 7.0), r"quaternion of joint 'root'.*row 6"),
    ("too short", edit_table(lambda t: t.head(12)), r"12 samples are too short"),
    ("no rows", edit_table(lambda t: t.head(0)), r"no rows"),
    ("text in a column", edit_table(lambda t: t.with_columns(pl.lit("rad").alias("qpos/hip"))), r"'rad' in row 1"),
    ("empty file", lambda f: (f / "one.csv").write_text("") and None, r"one\.csv: the file is empty"),
    ("twice a column", duplicate_header, r"'qpos/hip' occurs 2 times"),
    ("no such file", edit_text("dataset.toml", "one.csv", "three.csv"), r"there is no file .*three\.csv"),
    ("unknown suffix", edit_text("dataset.toml", "one.csv", "model.xml"), r"\.csv, .*\.parquet, \.npz"),
    ("no TOML", edit_text("dataset.toml", "[model]", "[model"), r"not valid TOML"),
    ("misspelt key", edit_text("dataset.toml", "split =", "splt ="), r"'splt'; did you mean 'split'"),
    ("unknown split", edit_text("dataset.toml", '"test"', '"train"'), r"'train'.*'fit' or 'test'"),
    ("unknown interpolation", edit_text("dataset.toml", '"linear"', '"spline"'), r"'spline'.*'hold'"),
    ("no model", edit_text("dataset.toml", "model.xml", "robot.xml"), r"robot\.xml: there is no such model"),
    ("broken model", edit_text("model.xml", "</body>", ""), r"model\.xml: not well-formed XML"),
    (
        "unknown joint without an encoder",
        edit_text("dataset.toml", "[model]", '[model]\nunmeasured = ["hipp"]'),
        r"unmeasured = \['hipp'\]: expected a list of joints, of root, hip",
    ),
    ("single brackets", edit_text("dataset.toml", "[[recording]]", "[recording]"), r"valid TOML|double brackets"),
]


@pytest.mark.parametrize(("change", "message"), [pytest.param(c, m, id=n) for n, c, m in BAD])
def test_invalid_input_raises_one_line_error(folder: Path, change: Callable[[Path], None], message: str) -> None:
    change(folder)
    with pytest.raises(InputError, match=message) as caught:
        load(folder)
    assert "\n" not in str(caught.value)


PARAMETER = '[[parameter]]\nname = "p"\npath = "{path}"\nbounds = {bounds}\n'


@pytest.mark.parametrize(
    ("path", "bounds", "message"),
    [
        ("joint:hipp/damping", "[0, 1]", "no joint 'hipp'; nearest: 'hip'"),
        ("joint:hip/dampin", "[0, 1]", "attributes here are damping"),
        ("dof_dampin[3]", "[0, 1]", "nearest: 'dof_damping'"),
        ("geom:ball/friction[9]", "[0, 1]", "does not point at a single number"),
        ("joint:hip/damping", "[1, 0]", "LOW below HIGH"),
        ("joint:hip/damping", "[1, 2]", "value of 'joint:hip/damping' is 0.3, outside"),
        ("hip", "[0, 1]", "KIND:NAME/ATTRIBUTE"),
    ],
)
def test_invalid_parameters_raise(folder: Path, path: str, bounds: str, message: str) -> None:
    file = folder / "dataset.toml"
    file.write_text(file.read_text() + PARAMETER.format(path=path, bounds=bounds))
    with pytest.raises(InputError, match=r"\[\[parameter\]\] 1.*" + message.replace("[", r"\[")):
        load(folder)


def test_absent_folders_raise(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        load(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"holds no dataset\.toml"):
        load(tmp_path)


def test_unknown_keys_are_noted(folder: Path) -> None:
    file = folder / "dataset.toml"
    file.write_text('author = "somebody"\n' + file.read_text() + "\n[noise]\nqpo = 0.1\n")
    notes = load(folder).notes
    assert any("'author'" in note for note in notes)
    assert any("'qpo'" in note and "did you mean 'qpos'" in note for note in notes)
    assert noise_of(load(folder)).qpos.shape == (MODEL.nv,)


def set_gain(actuator: mujoco.MjsActuator, kp: float) -> None:
    actuator.gainprm[0], actuator.biasprm[1] = kp, -kp


@pytest.mark.parametrize(
    ("path", "attribute"),
    [
        ("joint:hip/damping", lambda spec: spec.joint("hip").damping.__setitem__(0, 0.9)),
        ("joint:hip/armature", lambda spec: setattr(spec.joint("hip"), "armature", 0.9)),
        ("joint:hip/frictionloss", lambda spec: setattr(spec.joint("hip"), "frictionloss", 0.9)),
        ("geom:ball/friction", lambda spec: spec.geom("ball").friction.__setitem__(0, 0.9)),
        ("body:thigh/mass", lambda spec: setattr(spec.geom("thigh"), "mass", 0.9)),
        ("option/density", lambda spec: setattr(spec.option, "density", 0.9)),
        ("actuator:hip_motor/kp", lambda spec: set_gain(spec.actuator("hip_motor"), 0.9)),
        ("actuator:hip_motor/kv", lambda spec: spec.actuator("hip_motor").biasprm.__setitem__(2, -0.9)),
    ],
)  # fmt: skip
def test_parameter_paths_against_compiler(path: str, attribute: Callable[[mujoco.MjSpec], None]) -> None:
    """A number set through its path gives the same motion as the number in the MJCF."""
    spec = mujoco.MjSpec.from_string(XML)
    attribute(spec)
    expected, model = spec.compile(), mujoco.MjModel.from_xml_string(XML)
    set_values(model, {path: 0.9})
    assert parse_path(model, path).read(model) == pytest.approx(0.9)
    states = []
    for m in (expected, model):
        data = mujoco.MjData(m)
        data.qvel[:] = np.linspace(-1, 1, m.nv)
        data.ctrl[:] = 0.5
        mujoco.mj_step(m, data, 100)
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(states[1], states[0], rtol=1e-9, atol=1e-12)


def test_path_syntax() -> None:
    texts = (
        "joint:hip/damping",
        "joint/hip/damping",
        "joint:hip.damping",
        "joint[@name='hip']/@damping",
        "dof_damping[6]",
    )
    assert {parse_path(MODEL, text).read(MODEL) for text in texts} == {0.3}
