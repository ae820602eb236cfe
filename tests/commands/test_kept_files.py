"""A run goes on without its robot's folder: it has copies of what it read."""

import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from btr_mjx import coevolve, report, scan
from btr_mjx.errors import InputError
from btr_mjx.models import kept_files
from btr_mjx.plotting import read_robot
from btr_mjx.plotting.rendering import working_backend
from btr_mjx.replays import read_replay
from btr_mjx.runs import read_json

EXAMPLES = Path(__file__).parents[2] / "examples"
FLAGS = ("--trials=3", "--controllers=6", "--controller-generations=2", "--simulations=6", "--iterations=1")
MORE = ("--simulation-generations=2", "--engine=native", "--no-progress", "--no-figures")


def tetrahedron() -> bytes:
    """An STL file."""
    corners = 0.02 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = [corners[list(face)] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
    return bytes(80) + struct.pack("<I", 4) + b"".join(struct.pack("<12fH", 0, 0, 0, *f.ravel(), 0) for f in faces)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A project with a robot whose MJCF is elsewhere and names an MJCF and a mesh, with a fitness and a reality."""
    mjcf, robot = tmp_path / "project" / "mjcf", tmp_path / "project" / "arm"
    for folder in (robot, mjcf / "meshes"):
        folder.mkdir(parents=True)
    text = (EXAMPLES / "thrower" / "robot.xml").read_text()
    text = text.replace("<worldbody>", '<include file="parts.xml"/><worldbody>', 1)
    text = text.replace('<compiler angle="radian"/>', '<compiler angle="radian" meshdir="meshes"/>')
    text = text.replace('<site name="hand"/>', '<site name="hand"/><geom type="mesh" mesh="tip" mass="0.01"/>')
    (mjcf / "robot.xml").write_text(text)
    (mjcf / "worn.xml").write_text(text.replace('"shoulder" damping="0.3"', '"shoulder" damping="0.6"'))
    (mjcf / "parts.xml").write_text('<mujoco><asset><mesh name="tip" file="tip.stl"/></asset></mujoco>')
    (mjcf / "meshes" / "tip.stl").write_bytes(tetrahedron())
    toml = (EXAMPLES / "thrower" / "robot.toml").read_text().replace("robot.xml", "../mjcf/robot.xml")
    (robot / "robot.toml").write_text(toml.replace('"target_distance"', '"mine.py:height"'))
    (robot / "mine.py").write_text("def height(outcome):\n    return outcome.position[..., -1, 2]\n")
    (tmp_path / "project" / "other.py").write_text("def lowness(outcome):\n    return -outcome.position[..., -1, 2]\n")
    return tmp_path / "project"


def command(home: Path, out: Path, *more: str) -> list[str]:
    return [f"--robot={home / 'arm'}", f"--out={out}", *FLAGS, *MORE, *more]


@pytest.mark.parametrize("other", [False, True])
def test_a_run_without_its_robot(home: Path, tmp_path: Path, other: bool) -> None:
    out = tmp_path / "run"
    named = [f"--fitness={home / 'other.py'}:lowness", f"--reality-model={home / 'mjcf' / 'worn.xml'}"]
    arguments = command(home, out, *(named if other else []))
    coevolve.main(arguments)
    result = (out / "result.json").read_bytes()
    expected = [motion.qpos for motion in read_replay(out, 5, 1.0).motions]
    shutil.rmtree(home)
    assert set(kept_files(out)) == ({"robot", "reality_model", "fitness"} if other else {"robot"})
    for shown, again in zip(expected, read_replay(out, 5, 1.0).motions, strict=True):
        np.testing.assert_array_equal(shown, again.qpos)
    assert read_robot(out).name == "arm"
    assert read_json(out / "result.json")["fitness"] == ("other.py:lowness" if other else "mine.py:height")
    for last in sorted(out.glob("checkpoint-*.npz"))[1:]:  # as if it had been killed
        last.unlink()
    coevolve.main([*arguments, "--resume"])
    assert (out / "result.json").read_bytes() == result


@pytest.mark.slow
def test_the_page_of_a_run_without_its_robot(home: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    coevolve.main(command(home, out))
    shutil.rmtree(home)
    (out / "robot.png").unlink(missing_ok=True)
    page = report.report(out).read_text(encoding="utf-8")
    assert "The robot with the parameters of the start" in page or working_backend() is None


def test_a_robot_that_changed(home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Replays show the run's own robot; a run goes on with no other one."""
    out = tmp_path / "run"
    coevolve.main(command(home, out))
    expected = [motion.qpos for motion in read_replay(out, 5, 1.0).motions]
    model = home / "mjcf" / "robot.xml"
    model.write_text(model.read_text().replace('mass="0.8"', 'mass="1.6"'))
    (home / "arm" / "mine.py").write_text("def height(outcome):\n    return 2 * outcome.position[..., -1, 2]\n")
    for shown, again in zip(expected, read_replay(out, 5, 1.0).motions, strict=True):
        np.testing.assert_array_equal(shown, again.qpos)
    with pytest.raises(SystemExit):
        coevolve.main([*command(home, out), "--resume"])
    said = capsys.readouterr().err
    assert "the robot and the fitness function" in said
    assert f"copies are in {out / 'inputs'}" in said


def test_a_scan_without_its_robot(home: Path, tmp_path: Path) -> None:
    out = tmp_path / "scan"
    flags = ["--grid=4", "--trials=3", "--behaviours=random", "--engine=native", "--no-progress", "--no-figures"]
    scan.main([f"--robot={home / 'arm'}", f"--out={out}", *flags])
    with np.load(out / "scan.npz") as arrays:
        expected = arrays["delta_fitness"]
    shutil.rmtree(home)
    for block in (out / "blocks").iterdir():
        block.unlink()
    scan.main([f"--robot={home / 'arm'}", f"--out={out}", *flags, "--resume"])
    with np.load(out / "scan.npz") as arrays:
        np.testing.assert_array_equal(arrays["delta_fitness"], expected)
    assert report.report(out).is_file()


def test_large_files_stay_where_they_are(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    monkeypatch.setattr("btr_mjx.models.file_copies._MOST_BYTES", 100)
    coevolve.main(command(home, out))
    assert "are not copied" in capsys.readouterr().err
    shutil.rmtree(home)
    with pytest.raises(InputError, match="arm"):
        read_replay(out, 5, 1.0)
