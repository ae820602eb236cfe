"""Commands with a robot.toml: a whole co-evolution, a scan, figures, and what they say to bad input."""

import json
from pathlib import Path

import numpy as np
import pytest

from btr_mjx import coevolve, scan

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_thrower_is_identified(tmp_path: Path) -> None:
    """Two numbers that are given by paths, drawn from the seed, from the fitness of trials alone."""
    out = tmp_path / "run"
    flags = ("--trials=6", "--controllers=16", "--controller-generations=3", "--simulations=20", "--no-progress")
    more = ("--simulation-generations=15", "--iterations=2", "--optimiser=cma", "--engine=native")
    coevolve.main(["--robot", str(EXAMPLES / "thrower"), "--out", str(out), *flags, *more])
    result = json.loads((out / "result.json").read_text())
    assert result["fitness"] == "target_distance"
    assert result["delta_fitness_last"] < 0.5 * result["delta_fitness_first"]
    for name in ("ball mass", "elbow damping"):
        assert result["simulation"][name] == pytest.approx(result["truth"][name], rel=0.1)
    assert result["space"]["ball mass"] == {"low": 0.05, "high": 0.6, "unit": "kg"}
    assert (out / "delta_fitness.png").stat().st_size > 1000


def test_a_scan_of_a_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ("--grid=5", "--trials=3", "--behaviours=random", "--engine=native", "--no-progress", "--truth=0.3")
    scan.main(
        ["--robot", str(EXAMPLES / "thrower"), "--parameter", "ball mass", "--out", str(tmp_path / "scan"), *flags]
    )
    assert "ball mass: 3 behaviours, 5 simulations" in capsys.readouterr().out
    with np.load(tmp_path / "scan" / "scan.npz") as arrays:
        np.testing.assert_allclose(arrays["grid"], np.linspace(0.05, 0.6, 5))
    result = json.loads((tmp_path / "scan" / "result.json").read_text())
    assert (result["parameter_unit"], result["fitness_unit"]) == ("kg", "m")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--robot", "nowhere/robot.toml"], "nowhere"),
        (["--robot", str(EXAMPLES / "thrower"), "--template", "x.xml"], "got both"),
        (
            ["--robot", str(EXAMPLES / "thrower"), "--reality-model", str(EXAMPLES / "quadruped" / "robot.xml")],
            "expected those of thrower: shoulder, elbow",
        ),
        (["--robot", str(EXAMPLES / "thrower"), "--unknown", "ball mas"], "did you mean 'ball mass'"),
        (["--robot", str(EXAMPLES / "thrower"), "--truth", "ball mass=7"], "[0.05, 0.6] kg"),
    ],
)
def test_bad_input_ends_in_one_line(
    flags: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        coevolve.main([*flags, "--out", str(tmp_path / "run")])
    assert end.value.code == 2
    error = capsys.readouterr().err.strip()
    assert words in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()
