"""The command: what it writes, how it resumes, what it says to bad input."""

import dataclasses
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import btr_mjx
from btr_mjx import coevolve
from btr_mjx.backtoreality import CoevolveConfig, Problem
from btr_mjx.errors import InputError, Interrupted
from btr_mjx.evaluation import evaluate
from btr_mjx.models import load_robot
from btr_mjx.plotting import draw_run
from btr_mjx.plotting.run_data import read_run
from btr_mjx.robots import hexapod
from btr_mjx.runs import read_arrays, read_config, read_table

ROOT = Path(__file__).parents[2]

SMALL_RUN = (
    "--engine=native",
    "--duration=0.05",
    "--controllers=8",
    "--controller-generations=2",
    "--trials=3",
    "--simulations=6",
    "--simulation-generations=2",
    "--iterations=2",
    "--no-figures",
    "--no-progress",
)
"""Flags of a co-evolution that takes a few seconds."""

SAME = ("result.json", "generations.csv", "iterations.csv", "trials.npz", "simulations-002.npz")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "whole"
    coevolve.main([*SMALL_RUN, "--out", str(folder)])
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


def test_run_folder(finished: Path) -> None:
    result = json.loads((finished / "result.json").read_text())
    for name in ("delta_fitness", "parameter_error"):
        assert np.isfinite(result[f"{name}_first"])
        assert np.isfinite(result[f"{name}_last"])
    assert result["reality_evaluations"] == 7
    assert np.isfinite(result["lp"])
    assert result["parameter_error_first"] == pytest.approx((0.24 + 0.24) / 2)
    config = json.loads((finished / "config.json").read_text())
    assert config["controllers"] == 8
    assert read_table(finished / "generations.csv").height == 8
    trials = read_arrays(finished / "trials.npz")
    assert trials["controllers"].shape == (7, 36)
    archive = read_arrays(finished / "simulations-001.npz")
    assert archive["parameters"].shape == (2, 6, 2)
    assert archive["names"].tolist() == ["bl_5", "bl_14"]
    # The reported error is that of the reported simulation.
    error = np.mean([abs(result["simulation"][n] - result["truth"][n]) for n in ("bl_5", "bl_14")])
    assert result["parameter_error_last"] == pytest.approx(error)
    assert not list(finished.glob("*.png"))


def test_progress_ends_at_the_total_that_was_announced(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    flags = [flag for flag in SMALL_RUN if flag != "--no-progress"]
    flags += ["--distance", "fitness", "--out", str(tmp_path / "run")]
    coevolve.main(flags)
    lines = [line for line in capsys.readouterr().err.splitlines() if "pairs" in line]
    totals = [re.search(r"(\d+)%.* (\d+)/(\d+) ", line) for line in lines]
    counts = [tuple(map(int, found.groups())) for found in totals if found]
    assert counts[0][:2] == (0, 0)
    assert counts[-1][0] == 100
    assert {total for _, _, total in counts} == {counts[-1][1]}
    coevolve.main([*flags, "--resume"])  # nothing is left to be done
    assert "pairs" not in capsys.readouterr().err


SMALL: dict[str, Any] = {
    "engine": "native",
    "duration": 0.05,
    "controllers": 8,
    "controller_generations": 2,
    "trials": 3,
    "simulations": 6,
    "simulation_generations": 2,
    "iterations": 2,
    "figures": False,
    "progress": False,
}
"""The same settings in Python."""


def test_library_face(finished: Path, tmp_path: Path) -> None:
    """btr_mjx.coevolve is a module and can be called; it does what the command does."""
    result = btr_mjx.coevolve(hexapod(), **SMALL, out=str(tmp_path / "again"))
    assert files(tmp_path / "again") == files(finished)
    assert result["reality_evaluations"] == 7


def test_who_interrupts_in_python_learns_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: Any) -> None:
        raise Interrupted("stopped at a safe point (SIGINT)", 2)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(coevolve, "run_in_folder", stopped)
    with pytest.raises(Interrupted, match=r"safe point \(SIGINT\); go on with out='runs/quick-0', resume=True"):
        btr_mjx.coevolve(hexapod(), **SMALL)


def test_a_robot_of_a_program_and_of_a_file(tmp_path: Path) -> None:
    """A robot that its robot.toml describes is named by it; another one is the program's."""
    file = ROOT / "examples" / "thrower" / "robot.toml"
    robot = load_robot(file)
    settings = SMALL | {"iterations": 1, "duration": None}
    for name, own in (("file", file), ("read", robot), ("own", dataclasses.replace(robot, speed_limit=40.0))):
        btr_mjx.coevolve(own, **settings, out=tmp_path / name)
    assert len({(tmp_path / name / "result.json").read_bytes() for name in ("file", "read", "own")}) == 1
    files = {name: read_config(tmp_path / name, CoevolveConfig).robot for name in ("file", "read", "own")}
    assert files["file"] == files["read"] == file
    assert files["own"] is not None
    assert "program" in str(files["own"])
    with pytest.raises(InputError, match="other"):  # of another robot the folder is not continued
        btr_mjx.coevolve(robot, **settings, out=tmp_path / "own", resume=True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"iterationz": 3}, "no setting 'iterationz'; nearest: 'iterations'"),
        ({"iterations": "3"}, "iterations: got '3', expected a whole number"),
        ({"iterations": True}, "iterations: got True"),
        ({"optimiser": "adam"}, "optimiser: got 'adam', expected 'ga', 'cma'"),
        ({"marks": 0.3}, "marks: got 0.3, expected a tuple of float"),
        ({"noise": -1}, "noise: got -1"),
        ({"trials": 900, "controllers": 8}, "trials m = 900"),
        ({"unknown": "bl_99"}, "bl_99"),
        ({"truth": {"bl_14": 1.7}}, r"got 1\.7 for 'bl_14'"),
        ({"truth": {"bl_3": 1.0}}, "bl_3 is not among the unknown"),
        ({"robot": 3}, "robot: got 3, expected a path or None"),
    ],
)
def test_settings_in_python_are_checked_as_those_of_the_command(
    settings: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        btr_mjx.coevolve(**settings)
    assert not list(tmp_path.rglob("*.*"))


@pytest.mark.slow
def test_types_of_the_library_face(tmp_path: Path) -> None:
    """What static editors and type checkers know of the package's names."""
    good = "import btr_mjx as btr\nfrom btr_mjx import hexapod\nrobot: btr.Robot = hexapod(timestep=1e-3)\n"
    good += "btr.evaluate(robot, robot.nominal, [], fitness='forward_speed').fitness.shape\n"
    good += "btr.coevolve(robot, iterations=3, seed=1)['simulation']\nbtr.coevolve(optimiser='cma')\n"
    bad = "btr.coevolve(3)\nhexapod(1)\n"
    (tmp_path / "notebook.py").write_text(good + bad)
    places = "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache" / "notebook")
    command = [sys.executable, "-m", "mypy", *places, "notebook.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    lines = {int(line.split(":")[1]) for line in done.stdout.splitlines() if ": error:" in line}
    assert lines == {7, 8}, done.stdout


def test_seeds_differ_and_truth_may_be_drawn(finished: Path, tmp_path: Path) -> None:
    coevolve.main([*SMALL_RUN, "--seed=1", "--truth", "--out", str(tmp_path / "other")])
    ours, other = (json.loads((f / "result.json").read_text()) for f in (finished, tmp_path / "other"))
    assert ours["truth"] != other["truth"]
    assert ours["best_controller"] != other["best_controller"]


@pytest.mark.slow
def test_killed_at_random_moments_and_resumed(finished: Path, tmp_path: Path) -> None:
    """kill -9 again and again; whatever remains, --resume reaches the same bytes."""
    folder, dice = tmp_path / "killed", random.Random(7)
    command = [sys.executable, "-m", "btr_mjx.coevolve", *SMALL_RUN, "--out", str(folder)]
    kills = 0
    for _ in range(12):
        resume = ["--resume"] if (folder / "config.json").exists() else []
        process = subprocess.Popen([*command, *resume], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        before = len(list(folder.glob("checkpoint-*"))) if folder.exists() else 0
        deadline = time.monotonic() + 60
        # Wait for work to begin, then strike at a random moment.
        while process.poll() is None and time.monotonic() < deadline:
            if folder.exists() and (before or list(folder.glob("checkpoint-*"))):
                break
            time.sleep(0.02)
        time.sleep(dice.uniform(0.0, 3.0 if before else 0.6))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        _, errors = process.communicate()
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL, errors.decode()
        if kills == 3:
            break
    assert kills >= 1
    if not (folder / "result.json").exists():
        subprocess.run([*command, "--resume"], check=True, capture_output=True)
    assert files(folder) == files(finished)


def test_sigint_stops_at_a_safe_point(finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "interrupted"
    command = [sys.executable, "-m", "btr_mjx.coevolve", *SMALL_RUN, "--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(folder.glob("checkpoint-*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "python -m btr_mjx.coevolve" in errors.partition("resume with: ")[2]
    assert "--resume" in errors
    subprocess.run([*command, "--resume"], check=True, capture_output=True)
    assert files(folder) == files(finished)


def test_damaged_checkpoint_falls_back(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """An altered newest checkpoint is noticed by its checksum and the one before it is used."""
    folder = tmp_path / "damaged"
    coevolve.main([*SMALL_RUN, "--out", str(folder)])
    newest = sorted(folder.glob("checkpoint-*"))[-1]
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    (folder / "result.json").unlink()
    capsys.readouterr()
    coevolve.main([*SMALL_RUN, "--out", str(folder), "--resume"])
    assert "checksum" in capsys.readouterr().err
    assert files(folder) == files(finished)


def fails(capsys: pytest.CaptureFixture, *flags: str) -> str:
    """Run the command, expect exit code 2, and return the one line that it printed."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        coevolve.main([*SMALL_RUN, *flags])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    return lines[0]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--truth", "bl_5=1.7"], ["1.7", "bl_5", "[0.4, 1.6]"]),
        (["--truth", "bl_5=nan"], ["nan", "bl_5"]),
        (["--truth", "bl_5=long"], ["bl_5=long", "NAME=NUMBER"]),
        (["--truth", "bl_3=0.5"], ["bl_3", "not among the unknown"]),
        (["--unknown", "bl_15"], ["bl_15", "bl_3, bl_4"]),
        (["--unknown", "bl_5", "bl_5"], ["bl_5"]),
        (["--trials", "8"], ["m = 8", "population of 8"]),
        (["--p-m", "1.5"], ["p_m", "1.5", "[0, 1]"]),
        (["--simulation-p-m", "-0.1"], ["p_m", "-0.1"]),
        (["--fitness", "beauty"], ["beauty", "distance"]),
        (["--noise", "-1"], ["noise", "-1"]),
        (["--duration", "0"], ["duration", "0"]),
        (["--reality-timestep", "1e-4"], ["--reality-engine native"]),
        (["--template", "absent.xml.j2"], ["absent.xml.j2"]),
        (["--simulation-bits", "60"], ["60", "bits"]),
    ],
)
def test_bad_input_is_one_line(
    capsys: pytest.CaptureFixture, tmp_path: Path, flags: list[str], words: list[str]
) -> None:
    folder = tmp_path / "never"
    line = fails(capsys, *flags, "--out", str(folder))
    for word in words:
        assert word in line
    assert not folder.exists()


def test_existing_folder_is_left_alone(capsys: pytest.CaptureFixture, finished: Path) -> None:
    before = files(finished)
    line = fails(capsys, "--out", str(finished))
    assert "--resume" in line
    assert files(finished) == before


def test_resume_with_another_config_names_the_field(capsys: pytest.CaptureFixture, finished: Path) -> None:
    before = files(finished)
    line = fails(capsys, "--out", str(finished), "--resume", "--p-m", "0.3", "--seed", "4")
    for word in ("p_m", "0.3", "0.02", "seed", "4"):
        assert word in line
    assert files(finished) == before


@pytest.mark.parametrize(
    ("find", "replacement", "words"),
    [
        ("{{ kp }}", "{{ stiffness }}", ["robot.xml.j2", "stiffness", "line"]),
        ("<freejoint", "<freejiont", ["robot.xml.j2", "freejiont", "line"]),
        ("</worldbody>", "", ["not well-formed", "line"]),
    ],
)
def test_broken_template(
    capsys: pytest.CaptureFixture, tmp_path: Path, find: str, replacement: str, words: list[str]
) -> None:
    text = (Path(__file__).parents[2] / "assets/hexapod.xml.j2").read_text()
    assert find in text
    path = tmp_path / "robot.xml.j2"
    path.write_text(text.replace(find, replacement))
    line = fails(capsys, "--template", str(path), "--out", str(tmp_path / "never"))
    for word in words:
        assert word in line
    assert not (tmp_path / "never").exists()


def test_presets() -> None:
    paper = coevolve.parse(["--preset", "paper", "--seed", "5"])
    assert (paper.preset, paper.trials, paper.seed) == ("paper", 15, 5)
    assert coevolve.build_problem(paper).unknown == ("bl_3", "bl_5", "bl_6", "bl_8")
    assert coevolve.build_problem(coevolve.parse([])).unknown == ("bl_5", "bl_14")


def test_unknown_and_truth() -> None:
    def problem(*flags: str) -> Problem:
        return coevolve.build_problem(coevolve.parse(flags))

    def truth(*flags: str) -> list[float]:
        return list(problem(*flags).reality.truth)

    nominal = list(hexapod().nominal)
    every = problem("--unknown", "all", "--truth")
    assert every.simulation_box.n == 12
    assert all(a != b for a, b in zip(every.reality.truth, nominal, strict=True))
    assert truth("--unknown", "all")[2] == 0.88  # the preset's own value; the others are drawn
    assert truth("--unknown", "bl_3", "bl_14")[11] == 1.6
    assert truth("--unknown", "bl_3", "bl_14")[2] == nominal[2]  # bl_5 is known then
    assert truth("--truth", "preset", "bl_5=0.5")[2] == 0.5
    assert truth("--preset", "paper")[:6] == [0.54, 0.64, 0.54, 0.74, 0.64, 0.74]
    # What is drawn depends on the seed alone, not on which values are given.
    assert truth("--truth", "bl_5=0.5")[11] == truth("--truth")[11] != truth("--truth", "--seed", "1")[11]
    assert problem().start.tolist() == nominal
    assert problem("--start", "random").start[2] != nominal[2]


def test_delta_fitness_is_reported_whatever_is_minimised(tmp_path: Path) -> None:
    """delta_fitness_* in result.json are eq. 4 over whole trials, computed here from scratch."""
    flags = [*SMALL_RUN, "--distance", "multiscale", "--marks", "0.02", "0.04", "--iterations", "1"]
    coevolve.main([*flags, "--out", str(tmp_path / "run")])
    result, trials = json.loads((tmp_path / "run/result.json").read_text()), read_arrays(tmp_path / "run/trials.npz")
    problem = coevolve.build_problem(coevolve.parse(flags))
    tried, f_r = trials["controllers"][1:], trials["f_r"][1:]
    last = problem.embed(np.array(list(result["simulation"].values())))
    for name, simulation in (("first", problem.start), ("last", last)):
        f_s = evaluate(problem.robot, simulation, tried, engine="native").fitness[0]
        assert result[f"delta_fitness_{name}"] == pytest.approx(np.abs(f_s - f_r).mean(), rel=1e-12)
    assert trials["f_marks"].shape == (4, 2)
    draw_run(tmp_path / "run")
    assert read_run(tmp_path / "run").distance_label == "multiscale distance"
