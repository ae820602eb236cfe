"""LeRobot datasets: names, units, zeros and signs are found, stated in the findings, and can be declared."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, open_dataset, save_dataset
from btr_mjx.gap.data.lerobot import frames as lerobot_frames
from btr_mjx.gap.data.lerobot.steps import counted_step
from btr_mjx.gap.preflight import Finding, preflight
from btr_mjx.gap.preflight.lerobot_tables import joint_lines
from btr_mjx.gap.preflight.predictions import Change, ColumnMap
from tests.support.lerobot_folders import FPS, NAMES, XML, degrees, motions, shares, write_lerobot

MOTIONS = motions()
MENAGERIE = ("Rotation", "Pitch", "Elbow", "Jaw")


def believed(folder: Path, xml: str = XML) -> Path:
    (folder / "arm.xml").write_text(xml)
    return folder / "arm.xml"


def renamed(names: Any) -> str:
    """The model with other names of its joints and actuators."""
    others = dict(zip(NAMES, names, strict=True))
    return re.sub("|".join(NAMES), lambda found: others[found[0]], XML)


def written(folder: Path, numbers: Any = degrees, **more: Any) -> Path:
    return write_lerobot(folder / "set", [(numbers(r.qpos), numbers(r.ctrl)) for r in MOTIONS], **more)


def opened(folder: Path, xml: str = XML, numbers: Any = degrees, **more: Any) -> Dataset:
    folder.mkdir(exist_ok=True)
    dataset = open_dataset(believed(folder, xml), logs=[written(folder, numbers, **more)])
    assert isinstance(dataset, Dataset)
    return dataset


def own_format(folder: Path, positions: Any) -> Dataset:
    """The same recordings in the format of this project; `positions` gives what encoders resolve [rad]."""
    rows = [
        replace(
            r,
            name=f"episode_{i:06d}",
            time=np.arange(len(r.time)) / FPS,
            qpos=positions(r.qpos),
            ctrl=positions(r.ctrl),
            qvel_measured=np.zeros(4, bool),
            split="fit" if i < 2 else "test",
        )
        for i, r in enumerate(MOTIONS)
    ]
    save_dataset(folder, XML, rows)
    dataset = open_dataset(folder)
    assert isinstance(dataset, Dataset)
    return dataset


def assert_alike(found: Dataset, truth: Dataset, atol: float = 1e-6) -> None:
    assert [r.name for r in found.recordings] == [r.name for r in truth.recordings]
    assert [r.split for r in found.recordings] == [r.split for r in truth.recordings]
    for one, other in zip(found.recordings, truth.recordings, strict=True):
        for field in ("time", "qpos", "ctrl"):
            np.testing.assert_allclose(getattr(one, field), getattr(other, field), atol=atol, err_msg=field)
        assert not one.qvel_measured.any()


def jaw(qpos: np.ndarray) -> np.ndarray:
    return -0.2 + 1.8 * degrees(qpos)[:, 3:] / 100


def from_degrees(qpos: np.ndarray) -> np.ndarray:
    return np.hstack([np.radians(degrees(qpos)[:, :3]), jaw(qpos)])


def from_shares(qpos: np.ndarray) -> np.ndarray:
    return np.hstack([shares(qpos)[:, :3] / 100 * np.array([2500, 2200, 2000]) / 4096 * np.pi, jaw(qpos)])


@pytest.mark.parametrize("version", ["v3.0", "v2.1"])
@pytest.mark.parametrize(
    ("numbers", "truth", "said"),
    [
        (degrees, from_degrees, r'unit = "deg"\): values are multiples of 360/4096'),
        (shares, from_shares, r'unit = "range"\): an encoder\'s steps differ from joint to joint'),
        (lambda q: q, lambda q: q, r'unit = "rad"\): no value is beyond'),
    ],
    ids=["degrees", "shares", "radians"],
)
def test_recordings_are_those_of_the_projects_own_format(
    tmp_path: Path, version: str, numbers: Any, truth: Any, said: str
) -> None:
    found = opened(tmp_path, numbers=numbers, version=version)
    assert_alike(found, own_format(tmp_path / "own", truth), 2e-5 if numbers is shares else 1e-6)
    assert re.search(said, "\n".join(found.notes))
    assert found.recordings[0].interpolation == "hold"
    (tmp_path / "dataset.toml").write_text(found.inferred)  # what was found, declared, is the same
    assert_alike(open_dataset(tmp_path), found, 1e-5)  # type: ignore[arg-type]


def test_a_folder_that_holds_the_model_too(tmp_path: Path) -> None:
    folder = written(tmp_path)
    believed(folder)
    assert_alike(open_dataset(folder), opened(tmp_path / "again"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("in_model", "in_dataset", "assumed"),
    [
        (NAMES, {"motors": [f"main_{name}" for name in NAMES]}, False),
        ([f"arm_{name}" for name in NAMES], list(NAMES), False),
        (MENAGERIE, [f"{name}.pos" for name in NAMES], True),
        ("1234", [f"{name}.pos" for name in NAMES], True),
        (("a", "b", "elbow_flex", "d"), [f"{name}.pos" for name in NAMES], True),
    ],
)
def test_names_are_matched_or_taken_in_order(tmp_path: Path, in_model: Any, in_dataset: Any, assumed: bool) -> None:
    found = opened(tmp_path, renamed(in_model), names=in_dataset)
    assert_alike(found, opened(tmp_path / "plain"))
    assert any(line.startswith("assumed: numbers of the dataset are the joints") for line in found.notes) == assumed
    warned = [f for f in preflight(found) if f.level == "warning" and "names differ" in f.message]
    assert len(warned) == assumed


def test_names_that_contradict_the_order_are_asked_for(tmp_path: Path) -> None:
    xml = renamed(("elbow_flex", "b", "c", "d"))
    with pytest.raises(
        InputError, match=r"info\.json: observation\.state: the model has no joint 'shoulder_pan"
    ) as asked:
        opened(tmp_path, xml)
    lines = "\n".join(asked.value.lines)
    assert f"Write this to {tmp_path / 'dataset.toml'}" in lines
    assert '[lerobot.joints."shoulder_pan.pos"]\njoint = "NAME 1"' in lines
    table = lines[lines.index("[model]") : lines.index("then run")]
    for old, new in (("NAME 1", "elbow_flex"), ("NAME 2", "b"), ("NAME 3", "d")):
        table = table.replace(old, new)
    (tmp_path / "dataset.toml").write_text(table + '[lerobot.joints.elbow_flex]\njoint = "c"\n')
    assert_alike(open_dataset(tmp_path), opened(tmp_path / "plain"))  # type: ignore[arg-type]


def test_numbers_of_no_joint_are_left_out(tmp_path: Path) -> None:
    def numbers(qpos: np.ndarray) -> np.ndarray:
        return np.hstack([degrees(qpos), qpos[:, :1], qpos[:, :1]])

    names = [*(f"{name}.pos" for name in NAMES), "x.vel", "extra.pos"]
    with pytest.raises(InputError, match=r"no joint 'extra\.pos'"):
        opened(tmp_path, numbers=numbers, names=names)
    toml = '[model]\nfile = "arm.xml"\n[lerobot]\nfolder = "set"\n[lerobot.joints.extra]\njoint = ""\n'
    (tmp_path / "dataset.toml").write_text(toml)
    found = open_dataset(tmp_path)
    assert isinstance(found, Dataset)
    assert_alike(found, opened(tmp_path / "plain"))
    assert "numbers of the dataset without a use: x.vel, extra.pos" in found.notes


def test_degrees_without_steps_are_said_to_be_assumed(tmp_path: Path) -> None:
    def smooth(qpos: np.ndarray) -> np.ndarray:
        return np.hstack([np.degrees(qpos[:, :3]), degrees(qpos)[:, 3:]])

    found = opened(tmp_path, numbers=smooth)
    assert any(line.startswith("assumed: values of the dataset are degrees") for line in found.notes)
    np.testing.assert_allclose(found.recordings[0].qpos[:, :3], MOTIONS[0].qpos[:, :3], atol=1e-6)


def test_numbers_beyond_100_are_degrees_and_those_beyond_limits_as_degrees_are_shares(tmp_path: Path) -> None:
    def far(qpos: np.ndarray) -> np.ndarray:
        return np.hstack([2 * np.degrees(qpos[:, :3]), degrees(qpos)[:, 3:]])

    wide = XML.replace("-1.7 1.7", "-3 3").replace("-1.6 1.6", "-3 3")
    assert any("reaches 1" in line and '"deg"' in line for line in opened(tmp_path, wide, far).notes)
    narrow = XML.replace("-1.7 1.7", "-0.8 0.8").replace("-1.6 1.6", "-0.8 0.8").replace("-1.9 1.9", "-0.8 0.8")

    def shared(qpos: np.ndarray) -> np.ndarray:
        return np.hstack([125 * np.clip(qpos[:, :3], -0.8, 0.8), degrees(qpos)[:, 3:]])

    found = opened(tmp_path / "narrow", narrow, shared)
    assert any("would be beyond the joint's limits" in line for line in found.notes)
    np.testing.assert_allclose(found.recordings[0].ctrl[:, 1], np.clip(MOTIONS[0].ctrl[:, 1], -0.8, 0.8), atol=1e-6)


def test_a_zero_in_the_middle_of_the_range_is_found_and_another_one_is_asked_for(tmp_path: Path) -> None:
    shifted = XML.replace("-1.7 1.7", "-3.2 0.2")
    found = opened(tmp_path, shifted)
    assert any("zero of shoulder_lift.pos is in the middle" in line for line in found.notes)
    np.testing.assert_allclose(found.recordings[0].qpos[:, 1], from_degrees(MOTIONS[0].qpos)[:, 1] - 1.5, atol=1e-6)

    def old(qpos: np.ndarray) -> np.ndarray:
        return degrees(qpos) * [1, -1, 1, 1] + [0, 180, 0, 0]

    found = opened(tmp_path / "old", numbers=old)
    (warned,) = [f for f in preflight(found) if f.level == "warning" and "calibration is another one" in f.message]
    assert "shoulder_lift.pos" in warned.message
    toml = found.inferred.replace(*_table("shoulder_lift.pos", "sign = 1\nzero = 0", "sign = -1\nzero = 180"))
    (tmp_path / "old" / "dataset.toml").write_text(toml)
    assert_alike(open_dataset(tmp_path / "old"), opened(tmp_path / "plain"))  # type: ignore[arg-type]


def _table(name: str, old: str, new: str) -> tuple[str, str]:
    head = f'[lerobot.joints."{name}"]\njoint = "{name.removesuffix(".pos")}"\nunit = "deg"\n'
    return head + old, head + new


def test_a_turned_joint_is_caught_with_the_lines_that_mend_it(tmp_path: Path) -> None:
    def turned(qpos: np.ndarray) -> np.ndarray:
        return degrees(qpos) * [1, 1, -1, 1]

    def errors(found: list[Finding]) -> list[Finding]:
        return [f for f in found if f.level == "error"]

    (fault,) = errors(preflight(opened(tmp_path, numbers=turned)))
    assert "qpos/elbow_flex and ctrl/elbow_flex both have the opposite sign" in fault.message
    text = "\n".join(fault.lines)
    assert '[lerobot.joints."elbow_flex.pos"]\nsign = -1' in text
    (tmp_path / "dataset.toml").write_text(text[text.index("[model]") : text.index("then run")])
    mended = open_dataset(tmp_path)
    assert isinstance(mended, Dataset)
    again = preflight(mended)
    assert errors(again) == []
    assert not any(finding.lines for finding in again)
    np.testing.assert_allclose(mended.recordings[0].qpos, from_degrees(MOTIONS[0].qpos), atol=2e-3)


def test_exchanged_joints_have_lines_that_mend_them(tmp_path: Path) -> None:
    found = opened(tmp_path, numbers=lambda qpos: degrees(qpos)[:, [0, 2, 1, 3]])
    order = ColumnMap(np.array([0, 2, 1, 3]), np.ones(4), np.zeros(4))
    text = "\n".join(joint_lines(found, Change(order, order)))
    (tmp_path / "dataset.toml").write_text(text[text.index("[model]") : text.index("then run")])
    assert_alike(open_dataset(tmp_path), opened(tmp_path / "plain"))  # type: ignore[arg-type]
    assert joint_lines(found, Change.none(found.model)) == ()
    assert joint_lines(found, Change(order, ColumnMap.affine(4))) == ()  # names are those of states and of actions
    turned = ColumnMap.affine(4, [1], -1.0)
    assert joint_lines(found, Change(turned, turned)) != ()
    assert joint_lines(found, Change(turned, ColumnMap.affine(4))) == ()


def test_signs_that_data_cannot_tell_are_named(tmp_path: Path) -> None:
    (note,) = [f for f in preflight(opened(tmp_path)) if f.topic == "sign"]
    told, _, untold = note.message.partition("signs of shoulder_pan")
    assert "elbow_flex" in told
    assert "cannot be told" in untold
    assert '[lerobot.joints."shoulder_pan.pos"]' in note.message
    assert note.lines == ()  # they would turn a joint that may be right


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('unit = "turns"', r"unit = 'turns': expected one of deg"),
        ('folder = "nowhere"', r"there is no .*nowhere/meta/info\.json"),
        ("degrees = true", None),
        ("[lerobot.joints.elbow_flx]", r"no such number in the dataset; nearest: 'elbow_flex"),
        ('[lerobot.joints.elbow_flex]\njoint = "elbow"', r"joint = 'elbow': the model has no such hinge"),
        ('[lerobot.joints.elbow_flex]\njoint = "gripper"', r"both are the joint 'gripper'"),
        ("[lerobot.joints.elbow_flex]\nsign = 2", r"sign = 2: expected 1 or -1"),
        ('[lerobot.joints.elbow_flex]\nunit = "m"', r"in m, but the joint 'elbow_flex' is a hinge"),
        ("[lerobot.joints.elbow_flex]\nrange = [1, 2]", r"range is of the units range and percent"),
        ("[lerobot.joints.gripper]\nzero = 1", r"zero is of the units deg, rad and m"),
        ("[lerobot.joints.gripper]\nrange = [1]", r"range = \[1\]: expected the positions"),
        ("[lerobot.joints.gripper]\nsigns = 1", r"did you mean 'sign'"),
    ],
)
def test_what_cannot_be_declared(tmp_path: Path, lines: str, message: str | None) -> None:
    believed(tmp_path)
    written(tmp_path)
    head = '[model]\nfile = "arm.xml"\n[lerobot]\n' + ("" if lines.startswith("folder") else 'folder = "set"\n')
    (tmp_path / "dataset.toml").write_text(f"{head}{lines}\n")
    if message is None:
        assert "unknown key 'degrees'" in "\n".join(open_dataset(tmp_path).notes)
        return
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


def test_folders_that_are_refused(tmp_path: Path) -> None:
    model, folder = believed(tmp_path), written(tmp_path)
    info = folder / "meta" / "info.json"
    with pytest.raises(InputError, match=r"is a LeRobot dataset, and 1 more logs were given"):
        open_dataset(model, logs=[folder, model])
    with pytest.raises(InputError, match=r"with 0 MJCF files beside it; give the model, too: MODEL\.xml"):
        open_dataset(folder)
    with pytest.raises(InputError, match=r"no such model file"):
        open_dataset(tmp_path / "other.xml", logs=[folder])
    believed(tmp_path, re.sub(r"<position([^>]*?) kp=.*?/>", r"<motor\1/>", XML))
    with pytest.raises(InputError, match=r"'shoulder_pan' has one that is no position servo.*<position joint="):
        open_dataset(model, logs=[folder])
    believed(tmp_path)
    info.write_text(info.read_text().replace("v3.0", "v1.6"))
    with pytest.raises(InputError, match=r"codebase_version is 'v1\.6', expected v2\.0, v2\.1 or v3\.0"):
        open_dataset(model, logs=[folder])


def test_of_long_datasets_episodes_are_chosen_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lerobot_frames, "MAX_SAMPLES", 550)
    found = opened(tmp_path)
    assert [r.name for r in found.recordings] == ["episode_000000", "episode_000002"]
    assert any("2 of 3 episodes are used" in line for line in found.notes)


@pytest.mark.parametrize("step", [360 / 4096, 200 / 2500, 200 / 4095, 100 / 1173])
def test_the_step_of_counted_values_is_found(step: float) -> None:
    rng = np.random.default_rng(0)
    values = (step * (rng.integers(-900, 900, 3000) + 0.5)).astype(np.float32)
    assert counted_step(values) == pytest.approx(step, rel=1e-5)
    assert counted_step(values + rng.normal(size=3000)) is None
    assert counted_step(values[:5]) is None
