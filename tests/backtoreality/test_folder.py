"""Reality behind a folder: what is asked, what is used, and what is said of rows that cannot be."""

import dataclasses
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btr_mjx import coevolve
from btr_mjx.backtoreality import PRESETS, FolderReality, SimulatedReality, Waiting
from btr_mjx.backtoreality.given_settings import flags_of
from btr_mjx.backtoreality.reality.instructions import command_kinds, instructions
from btr_mjx.errors import WAITING_CODE, InputError
from btr_mjx.evaluation import evaluate, fitness_function, fitness_of
from btr_mjx.gap.data import control_columns
from btr_mjx.gap.data.writing import recording_columns
from btr_mjx.models import base_model, load_robot
from btr_mjx.robots import hexapod

EXAMPLES = Path(__file__).parents[2] / "examples"
ROBOT = load_robot(EXAMPLES / "thrower")
FITNESS = fitness_of(ROBOT)
TIMES = (ROBOT.duration,)


@pytest.fixture
def reality(tmp_path: Path) -> FolderReality:
    return FolderReality(ROBOT, tmp_path, FITNESS)


@pytest.fixture
def controllers() -> np.ndarray:
    return ROBOT.controller_box.sample(np.random.default_rng(0), 3)


def ask(reality: FolderReality, controllers: np.ndarray, trial: int = 0) -> Waiting:
    with pytest.raises(Waiting) as waiting:
        reality.measure(controllers, trial, TIMES)
    return waiting.value


def test_trials_and_signals_are_written(reality: FolderReality, controllers: np.ndarray) -> None:
    waiting = ask(reality, controllers)
    assert waiting.missing == (0, 1, 2)
    assert "waiting for 3 measurements (trials 0, 1, 2)" in str(waiting)
    table = np.genfromtxt(reality.folder / "trials" / "000.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(table[:, 1:], controllers)
    for i, controller in enumerate(controllers):
        rows = np.loadtxt(reality.folder / "signals" / f"trial-{i}.csv", delimiter=",", skiprows=1)
        assert rows[-1, 0] == pytest.approx(ROBOT.duration)
        for t, *row in rows[:: len(rows) // 7]:
            np.testing.assert_allclose(row, ROBOT.signal(controller[:, None], t, np)[:, 0], atol=1e-8)
    assert "measured/NNN.csv" in (reality.folder / "README.md").read_text()


def test_repeats_are_averaged_and_failures_counted(reality: FolderReality, controllers: np.ndarray) -> None:
    ask(reality, controllers)
    rows = ["ID, Fitness ,repeats,failed", "2,0.5,3,", "2,0.9,1,", "0,,,1", "1,0.25,,0"]
    (reality.folder / "measured" / "000.csv").write_text("\n".join(rows))
    found = reality.measure(controllers, 0, TIMES)
    np.testing.assert_allclose(found, [[np.nan], [0.25], [0.6]])
    assert reality.noise == pytest.approx(np.std([0.5, 0.9], ddof=1))


def test_every_row_that_cannot_be_used_is_named(reality: FolderReality, controllers: np.ndarray) -> None:
    ask(reality, controllers)
    rows = ["id,fitness,repeats", "0,0.3,", "0,0.3,", "7,0.1,", "x,0.1,", "1,fast,", "1,nan,", "2,0.2,-1", ""]
    (reality.folder / "measured" / "000.csv").write_text("\n".join(rows))
    waiting = ask(reality, controllers)
    assert waiting.missing == (1, 2)
    expected = ["line 3 is the same as line 2", "line 4: trial '7' was not asked", "line 5: trial 'x' was not asked"]
    expected += ["line 6: fitness 'fast'", "line 7: fitness 'nan'", "line 8: repeats '-1'"]
    assert len(waiting.complaints) == len(expected)
    for complaint, words in zip(waiting.complaints, expected, strict=True):
        assert words in complaint


@pytest.mark.parametrize("text", ["", "time,ctrl/shoulder\n0,1\n", "\x00\xff"])
def test_a_file_that_is_no_table(reality: FolderReality, controllers: np.ndarray, text: str) -> None:
    ask(reality, controllers)
    (reality.folder / "measured" / "000.csv").write_text(text)
    (complaint,) = ask(reality, controllers).complaints
    assert "expected id and fitness" in complaint


def test_speeds_beyond_the_limit_are_impossible(tmp_path: Path, controllers: np.ndarray) -> None:
    reality = FolderReality(ROBOT, tmp_path, fitness_function("distance"))
    ask(reality, controllers)
    (tmp_path / "measured" / "000.csv").write_text("id,fitness\n0,1e9\n1,1\n2,1\n")
    assert "more than 50 is not possible" in ask(reality, controllers).complaints[0]


def test_what_was_used_does_not_change(reality: FolderReality, controllers: np.ndarray) -> None:
    ask(reality, controllers)
    table = reality.folder / "measured" / "000.csv"
    table.write_text("id,fitness\n0,1\n1,2\n2,3\n")
    first = reality.measure(controllers, 0, TIMES)
    table.write_text("id,fitness\n0,9\n1,9\n2,9\n")
    np.testing.assert_array_equal(reality.measure(controllers, 0, TIMES), first)
    assert ask(reality, controllers + 1e-3, 3).missing == (3, 4, 5)
    assert (reality.folder / "trials" / "001.csv").is_file()


def test_the_folder_of_another_run_is_refused(reality: FolderReality, controllers: np.ndarray) -> None:
    ask(reality, controllers)
    before = {path: path.read_bytes() for path in reality.folder.rglob("*.csv")}
    with pytest.raises(InputError, match="another run"):
        reality.measure(controllers[::-1], 0, TIMES)
    assert {path: path.read_bytes() for path in reality.folder.rglob("*.csv")} == before


def test_fitness_is_computed_from_recordings(reality: FolderReality, controllers: np.ndarray) -> None:
    """At several times of a trial, against the simulation that was recorded."""
    times = np.arange(1, 61) * 0.01
    truth = evaluate(ROBOT, ROBOT.nominal, controllers, engine="native", times=times, states=True, fitness=FITNESS)
    marks = (0.3, 0.6)
    with pytest.raises(Waiting):
        reality.measure(controllers, 0, marks)
    names = ["time", "qpos/shoulder", "qpos/elbow", *control_columns(base_model(ROBOT))]
    for i in range(3):
        qpos = np.concatenate([np.zeros((1, 2)), truth.outcome.qpos[0, i]])
        rows = np.column_stack([np.concatenate([[0.0], times]), qpos, np.zeros_like(qpos)])
        short = rows[:40] if i == 2 else rows
        file = reality.folder / "measured" / f"trial-{i}.csv"
        np.savetxt(file, short, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    with pytest.raises(Waiting) as waiting:
        reality.measure(controllers, 0, marks)
    assert waiting.value.missing == (2,)
    assert "lasts 0.39 s, a trial takes 0.6 s" in waiting.value.complaints[0]
    np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    found = reality.measure(controllers, 0, marks)
    recordings = reality.record(controllers, [0, 2, 5])
    assert [r.name for r in recordings] == ["trial-0", "trial-2"]
    np.testing.assert_allclose(recordings[0].qpos[1:], truth.outcome.qpos[0, 0], atol=1e-8)
    hand = truth.outcome.position[0][:, [29, 59]]
    np.testing.assert_allclose(found, np.linalg.norm(hand - ROBOT.target, axis=-1), atol=1e-8)


def test_the_instructions_say_what_a_person_needs() -> None:
    config = coevolve.parse(
        [*("--robot", str(EXAMPLES / "thrower"), "--reality", "folder", "--out", "runs/a b", "--trials", "4")]
    )
    reality = coevolve.build_problem(config).reality
    assert isinstance(reality, FolderReality)
    text = instructions(reality.robot, reality.fitness, reality.rate, reality.rounds)
    assert "At most 3 rounds of 4 controllers follow" in text
    assert "distance of `hand` from the point [0.35, 0.0, 1.3] m at t = 0.6 s [m]; smaller is better" in text
    assert "`ctrl/shoulder`: position of joint `shoulder` [rad]" in text
    assert "   - `elbow`: 0 rad" in text
    assert re.search(r"`hand` is then at x y z = [-\d.]+ [-\d.]+ [-\d.]+ m", text)
    assert "A fall is not a failure" in text
    line = next(one for one in text.splitlines() if "--resume" in one)
    words = shlex.split(line)
    assert coevolve.parse(words[words.index("--preset") :]) == dataclasses.replace(config, resume=True)


@pytest.mark.parametrize(
    "flags",
    [
        ["--preset", "paper", "--truth", "bl_3=0.5", "bl_5=0.6", "--no-progress", "--marks", "0.1", "0.2"],
        ["--unknown", "all", "--truth", "--duration", "0.5", "--wait", "--max-evaluations", "40"],
    ],
)
def test_flags_make_their_config_again(flags: list[str]) -> None:
    config = coevolve.parse(flags)
    words = flags_of(config, PRESETS[config.preset], leave_out=("preset",))
    assert coevolve.parse(["--preset", config.preset, *words]) == config


def test_commands_of_every_kind_of_motor() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/><body><joint name="b" type="slide"/>
        <geom size="0.1"/></body></body></worldbody><actuator><motor name="m" joint="a"/><motor name="g" joint="a"
        gear="9"/><position name="p" joint="b" kp="20"/><velocity name="v" joint="a" kv="3"/>
        <motor name="s" joint="b"/><pid name="i" joint="b" kp="3" kv="1" input="pos"/><pid name="two" joint="a" kp="3"
        kv="1"/></actuator></mujoco>"""
    )
    kinds = command_kinds(model)
    assert kinds["m"] == "torque of joint `a` [N m]"
    assert kinds["g"].startswith("control of joint `a`")
    assert kinds["p"] == "position of joint `b` [m]"
    assert kinds["v"] == "velocity of joint `a` [rad/s]"
    assert kinds["s"] == "force of joint `b` [N]"
    assert kinds["i"] == "position of joint `b` [m]"
    assert [name for name in kinds if name.startswith("two")] == ["two/0", "two/1"]
    assert kinds["two/1"].startswith("control of joint `a`")
    assert len(kinds) == model.nu
    assert all(kind.startswith("position of joint") for kind in command_kinds(base_model(hexapod())).values())


def test_marks_need_recordings(reality: FolderReality, controllers: np.ndarray) -> None:
    with pytest.raises(Waiting):
        reality.measure(controllers, 0, (0.3, 0.6))
    (reality.folder / "measured" / "000.csv").write_text("id,fitness\n0,1\n1,2\n2,3\n")
    with pytest.raises(InputError, match="give recordings"):
        reality.measure(controllers, 0, (0.3, 0.6))


SMALL = ("--engine=native", "--optimiser=cma", "--trials=4", "--controllers=8", "--controller-generations=2")
SMALL += ("--simulations=10", "--simulation-generations=6", "--iterations=2", "--no-progress", "--no-figures")


def command(folder: Path, *more: str) -> list[str]:
    exchange, out = str(folder / "exchange"), str(folder / "run")
    own = ["--robot", str(EXAMPLES / "thrower"), "--reality", "folder", "--exchange", exchange, "--out", out]
    return [*own, *SMALL, *more]


def one_round(folder: Path, *more: str) -> int:
    """The exit code of the command, run once."""
    try:
        coevolve.main(command(folder, *more))
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def room(folder: Path, *more: str) -> list[str]:
    return [sys.executable, str(EXAMPLES / "robot_in_the_next_room.py"), str(folder / "exchange"), *more]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """A run in steps: it ends where measurements are missing, and goes on with --resume."""
    folder = tmp_path_factory.mktemp("steps")
    for k in range(4):
        code = one_round(folder, *(["--resume"] if k else []))
        assert code == (WAITING_CODE if k < 3 else 0)  # the first controller, and two iterations
        subprocess.run(room(folder, "--once"), check=True, timeout=60)
    result = json.loads((folder / "run" / "result.json").read_text())
    assert result["reality_evaluations"] == 9
    assert result["measurement_noise"] == pytest.approx(1e-3, rel=0.6)
    assert result["delta_fitness_last"] < 0.5 * result["delta_fitness_first"]
    return result


def test_a_run_that_waits(uninterrupted: dict, tmp_path: Path) -> None:
    """Kills on either side at random moments; rows that are missing for a while, and rows twice."""
    rng = np.random.default_rng(3)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    begun, ours, theirs = time.monotonic(), None, None
    result = tmp_path / "run" / "result.json"
    kills = 0
    while not result.is_file():
        assert time.monotonic() - begun < 180
        if ours is None or ours.poll() is not None:
            more = ["--resume"] if (tmp_path / "run" / "config.json").is_file() else []
            words = [sys.executable, "-m", "btr_mjx.coevolve", *command(tmp_path, "--wait", *more)]
            ours = subprocess.Popen(words, **quiet)
        if theirs is None or theirs.poll() is not None:
            theirs = subprocess.Popen(room(tmp_path), **quiet)
        time.sleep(float(rng.uniform(0.3, 1.5)))
        victim = ours if rng.random() < 0.5 else theirs
        if kills < 6 and not result.is_file():
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            kills += 1
    assert ours is not None
    assert theirs is not None
    ours.wait(60)
    theirs.kill()
    theirs.wait()
    assert kills >= 3
    found = json.loads(result.read_text())
    assert found == uninterrupted


def test_missing_rows_are_asked_for_again(uninterrupted: dict, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert one_round(tmp_path) == WAITING_CODE
    subprocess.run(room(tmp_path, "--once"), check=True, timeout=60)
    one_round(tmp_path, "--resume")
    subprocess.run(room(tmp_path, "--once"), check=True, timeout=60)
    table = tmp_path / "exchange" / "measured" / "001.csv"
    rows = table.read_text().splitlines()
    table.write_text("\n".join([rows[0], *rows[3:], rows[-1], "3,1.0,,,,"]) + "\n")
    os.utime(table)
    capsys.readouterr()
    one_round(tmp_path, "--resume")
    out = capsys.readouterr().out
    assert "waiting for 1 measurement (trials 1)" in out
    assert "is the same as line" in out
    assert "--resume" in out
    table.write_text("\n".join([*rows, rows[-1]]) + "\n")
    for _ in range(2):
        one_round(tmp_path, "--resume")
        subprocess.run(room(tmp_path, "--once"), check=True, timeout=60)
    assert json.loads((tmp_path / "run" / "result.json").read_text()) == uninterrupted


def test_trials_with_an_imu_and_no_pose_are_recordings_without_fitness(tmp_path: Path) -> None:
    """Where a walking robot went is not in its IMU; how its base moved is estimated."""
    robot = load_robot(EXAMPLES / "quadruped")
    walker = FolderReality(robot, tmp_path, fitness_of(robot))
    tried = robot.controller_box.sample(np.random.default_rng(0), 1)
    (true,) = SimulatedReality(robot, tuple(robot.nominal)).record(tried, [0])
    columns = recording_columns(true)
    hidden = {name: values for name, values in columns.items() if "/root/" not in name}
    with pytest.raises(Waiting):
        walker.measure(tried, 0, (robot.duration,))
    np.savez(tmp_path / "measured" / "trial-0.npz", **hidden)  # type: ignore[arg-type]
    with pytest.raises(Waiting) as waiting:
        walker.measure(tried, 0, (robot.duration,))
    assert "does not say where the robot was" in waiting.value.complaints[0]
    (found,) = walker.record(tried, [0])
    assert found.seen.all()
    assert not found.sensed[:6].any()
    # Its feet slide while it walks: how fast it goes forwards is not told, how it is tilted is.
    up = [Rotation.from_quat(one.qpos[:, 3:7], scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for one in (found, true)]
    assert np.abs(up[0] - up[1]).mean() < 0.01
    assert np.abs(found.qpos[:, 2] - true.qpos[:, 2]).mean() < 0.005
