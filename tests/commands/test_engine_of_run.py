"""`--engine auto` in a run: what is chosen is kept, continued and has the bits of the engine that was chosen."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from btr_mjx import coevolve, scan
from btr_mjx.evaluation import choose_engine, evaluate
from btr_mjx.models import load_robot
from btr_mjx.runs import read_arrays

THROWER = Path(__file__).parents[2] / "examples/thrower/robot.toml"

FLAGS = (
    f"--robot={THROWER}",
    "--controllers=8",
    "--controller-generations=2",
    "--trials=3",
    "--simulations=6",
    "--simulation-generations=3",
    "--iterations=1",
    "--no-figures",
    "--no-progress",
)
SAME = ("generations.csv", "iterations.csv", "trials.npz", "simulations-001.npz", "result.json")


def run(folder: Path, *more: str) -> dict[str, bytes]:
    coevolve.main([*FLAGS, *more, "--out", str(folder)])
    return {name: (folder / name).read_bytes() for name in SAME}


def engine_of(folder: Path) -> str:
    return json.loads((folder / "config.json").read_text())["engine"]


def test_a_short_run_is_not_worth_compiling_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    found = run(tmp_path / "auto", "--progress")
    assert "native: about" in capsys.readouterr().err
    assert engine_of(tmp_path / "auto") == "native"
    assert found == run(tmp_path / "asked", "--engine=native")


def test_a_resumed_run_keeps_its_engine(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """A run of lanes goes on with lanes, which `auto` would not take for so few trials."""
    whole = run(tmp_path / "whole", "--engine=lanes")
    assert whole != run(tmp_path / "native", "--engine=native")
    shutil.copytree(tmp_path / "whole", tmp_path / "cut")
    sorted((tmp_path / "cut").glob("checkpoint-*.npz"))[-1].unlink()
    for name in ("result.json", "trials.npz", "simulations-001.npz"):
        (tmp_path / "cut" / name).unlink()
    assert run(tmp_path / "cut", "--resume") == whole
    assert engine_of(tmp_path / "cut") == "lanes"
    with pytest.raises(SystemExit):
        run(tmp_path / "cut", "--resume", "--engine=native")
    assert "engine: saved 'lanes', now 'native'" in capsys.readouterr().err


def test_a_long_run_takes_what_is_faster(capsys: pytest.CaptureFixture) -> None:
    """The thrower is a few bodies without contacts: lanes steps hundreds of them in the time of one."""
    robot = load_robot(THROWER)
    long, short = choose_engine(robot, pairs=10**9), choose_engine(robot, pairs=1)
    assert (long.engine, short.engine) == ("lanes", "native")
    assert long.ratio is not None
    assert long.ratio > 1
    assert long.reason.startswith("lanes: ")
    c = robot.controller_box.sample(np.random.default_rng(0), 3)
    chosen, asked = (evaluate(robot, robot.nominal, c, engine=engine) for engine in (None, "lanes"))
    assert chosen.engine == "lanes"
    np.testing.assert_array_equal(chosen.fitness, asked.fitness)


def test_a_scan_keeps_its_engine(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    flags = (f"--robot={THROWER}", "--grid=4", "--trials=3", "--behaviours=random", "--no-figures", "--no-progress")
    for name, engine in (("auto", "auto"), ("native", "native"), ("lanes", "lanes")):
        scan.main([*flags, f"--engine={engine}", "--out", str(tmp_path / name)])
    auto, native, lanes = (read_arrays(tmp_path / name / "scan.npz")["fitness"] for name in ("auto", "native", "lanes"))
    assert engine_of(tmp_path / "auto") == "native"
    np.testing.assert_array_equal(auto, native)
    assert (native != lanes).any()
    for block in (tmp_path / "lanes/blocks").iterdir():
        block.unlink()
    scan.main([*flags, "--resume", "--out", str(tmp_path / "lanes")])
    np.testing.assert_array_equal(read_arrays(tmp_path / "lanes/scan.npz")["fitness"], lanes)
