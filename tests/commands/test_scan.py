"""Scans: the library functions against plain loops, the command, and the short script."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

import btr_mjx as btr
from btr_mjx import scan
from btr_mjx.backtoreality import SearchSettings, evolve_controllers, select_transferable
from btr_mjx.errors import InputError
from btr_mjx.evaluation import evaluate
from btr_mjx.robots import Robot, hexapod
from btr_mjx.runs import read_arrays

SMALL = ("--engine=native", "--duration=0.03", "--grid=5", "--trials=3", "--controllers=6", "--generations=2")


def test_delta_fitness_against_a_loop(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 4)
    f_r = rng.uniform(0, 1, 4)
    expected = []
    for row in s:
        f_s = [evaluate(robot, [row], [k], engine="native").fitness[0, 0] for k in c]
        expected.append(np.mean([abs(a - b) for a, b in zip(f_s, f_r, strict=True)]))
    np.testing.assert_allclose(btr.scan.delta_fitness(robot, s, c, f_r, engine="native"), expected, rtol=1e-12)


def test_scan_is_exactly_zero_at_the_truth(robot: Robot, rng: np.random.Generator) -> None:
    """On the default engine: Theorems 1 and 2 along the line, and only there."""
    c = robot.controller_box.sample(rng, 5)
    line = scan.along(robot, "bl_14", [1.3, 1.4, 1.5, 1.6])
    f_r = evaluate(robot, line[3:], c).fitness[0]
    delta = scan.delta(robot, line, c, f_r)
    assert (delta[3] == 0.0).all()
    assert (scan.delta_fitness(robot, line, c, f_r)[:3] > 0.0).all()


def test_lines(robot: Robot) -> None:
    line = scan.along(robot, "bl_5", 7)
    assert line.shape == (7, 12)
    np.testing.assert_allclose(line[:, 2], np.linspace(0.4, 1.6, 7))
    np.testing.assert_array_equal(np.delete(line, 2, 1), np.tile(np.delete(robot.nominal_simulation, 2), (7, 1)))
    with pytest.raises(InputError, match=r"bl_15.*bl_3"):
        scan.along(robot, "bl_15", 7)
    with pytest.raises(InputError, match="at least 2"):
        scan.along(robot, "bl_5", 1)
    with pytest.raises(InputError, match=r"2\.0.*bl_5"):
        scan.along(robot, "bl_5", [0.5, 2.0])


def test_statistics_by_hand(rng: np.random.Generator) -> None:
    grid, truth = np.linspace(0.4, 1.6, 25), 0.88
    curve = np.abs(grid - truth) ** 0.5 + rng.normal(0, 0.05, 25)
    numbers = scan.curve_statistics(grid, curve, truth)
    assert numbers["spearman"] == pytest.approx(scipy.stats.spearmanr(curve, np.abs(grid - truth)).statistic)
    right = grid >= truth
    assert numbers["spearman_right"] == pytest.approx(scipy.stats.spearmanr(curve[right], grid[right]).statistic)
    assert numbers["spearman_left"] == pytest.approx(scipy.stats.spearmanr(curve[~right], -grid[~right]).statistic)
    assert numbers["roughness"] == pytest.approx(np.abs(np.diff(curve)).sum() / np.ptp(curve))
    assert numbers["at_minimum"] == grid[curve.argmin()]
    perfect = scan.curve_statistics(grid, np.abs(grid - truth), truth)
    assert perfect["spearman"] == pytest.approx(1)
    assert perfect["monotonicity"] == 1


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = tmp_path / "scan"
    scan.main([*SMALL, "--parameter", "bl_5", "--out", str(folder), "--no-figures"])
    arrays, result = read_arrays(folder / "scan.npz"), json.loads((folder / "result.json").read_text())
    assert arrays["delta"].shape == (5, 3)
    assert arrays["truth"] == 0.88
    np.testing.assert_allclose(arrays["delta"], np.abs(arrays["fitness"] - arrays["f_r"]))
    np.testing.assert_allclose(arrays["delta_fitness"], arrays["delta"].mean(1))
    numbers = scan.curve_statistics(arrays["grid"], arrays["delta_fitness"], 0.88)
    assert result["spearman"] == pytest.approx(numbers["spearman"])
    assert "spearman" in capsys.readouterr().out
    assert result["evolved_at"] == 0.64  # as in experiments/fig2_scans.py


@pytest.mark.parametrize(("flags", "start"), [(["--parameter=bl_3"], 0.4), (["--start=1.0"], 1.0), ([], 0.4)])
def test_controllers_evolve_where_the_scan_says(tmp_path: Path, flags: list[str], start: float) -> None:
    """Against the search itself, in the simulation that was named."""
    scan.main([*SMALL, *flags, "--out", str(tmp_path / "s"), "--no-figures"])
    assert json.loads((tmp_path / "s/result.json").read_text())["evolved_at"] == start
    found = dataclasses.replace(hexapod(), duration=0.03)
    parameter = flags[0].partition("=")[2] if flags and "bl" in flags[0] else "bl_14"
    genomes, scores = evolve_controllers(
        found, scan.along(found, parameter, [start])[0], SearchSettings(6, 2), seed=0, engine="native"
    )
    best, _ = select_transferable(genomes, scores, 3, maximise=True)
    box = found.controller_box.with_bits(SearchSettings(6, 2).bits)
    np.testing.assert_array_equal(read_arrays(tmp_path / "s/scan.npz")["controllers"], box.decode(best))


def test_resume_computes_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = [*SMALL, "--block=6", "--no-figures", "--out=run"]
    scan.main(flags)
    saved = {path: path.read_bytes() for path in Path("run").rglob("*.*z*")}
    blocks = sorted(Path("run/blocks").iterdir())
    assert len(blocks) == 3
    Path("run/scan.npz").unlink()
    blocks[0].unlink()
    blocks[1].write_bytes(b"damaged")
    capsys.readouterr()
    scan.main([*flags, "--resume"])
    assert {path: path.read_bytes() for path in Path("run").rglob("*.*z*")} == saved
    warnings = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert blocks[1].name in warnings[0]
    for wrong, word in ((["--resume", "--trials=4"], "trials: saved 3, now 4"), ([], "--resume")):
        with pytest.raises(SystemExit):
            scan.main([*flags, *wrong])
        assert word in capsys.readouterr().err
    with pytest.raises(SystemExit):
        scan.main([*SMALL, "--resume"])
    assert "--out FOLDER" in capsys.readouterr().err


@pytest.mark.parametrize("behaviours", ["mutants", "random"])
def test_other_behaviours(behaviours: str, tmp_path: Path) -> None:
    scan.main([*SMALL, "--behaviours", behaviours, "--p-m", "0.2", "--out", str(tmp_path / "s"), "--no-figures"])
    controllers = read_arrays(tmp_path / "s" / "scan.npz")["controllers"]
    assert len(np.unique(controllers, axis=0)) == 3


def test_a_line_needs_points_or_values() -> None:
    with pytest.raises(InputError, match=r"got 1\.6, expected at least 2 points, or a list of values"):
        scan.along(hexapod(), "bl_14", 1.6)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--parameter", "bl_2"], ["bl_2", "bl_3, bl_4"]),
        (["--truth", "1.7"], ["1.7", "bl_14", "[0.4, 1.6]"]),
        (["--start", "1.7"], ["1.7", "bl_14", "[0.4, 1.6]"]),
        (["--start", "1.0", "--behaviours", "random"], ["start 1", "random"]),
        (["--grid", "1"], ["grid: got 1"]),
        (["--trials", "6"], ["m = 6", "M = 6"]),
        (["--p-m", "2"], ["p_m", "2"]),
        (["--fitness", "beauty"], ["beauty", "distance"]),
        (["--cluster", "slurm"], ["--cluster", "slurm", "local:N", "tcp://HOST:PORT"]),
        (["--block", "0"], ["size 0", "at least 1"]),
        (["--resume"], ["nothing to resume", "never"]),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture, flags: list[str], words: list[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        scan.main([*SMALL, *flags, "--out", str(tmp_path / "never")])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert all(word in lines[0] for word in words), lines
    assert not (tmp_path / "never").exists()


def test_public_names() -> None:
    for name in btr.__all__:
        assert getattr(btr, name) is not None
    assert callable(btr.coevolve)
    with pytest.raises(AttributeError, match="reality_gap"):
        _ = btr.reality_gap


def test_the_short_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shorter trial: it saves and draws, and Delta_fitness is exactly zero at the truth."""
    import scan_bl14

    monkeypatch.setattr(btr, "hexapod", lambda: dataclasses.replace(hexapod(), duration=0.01), raising=False)
    scan_bl14.main(tmp_path)
    arrays = read_arrays(tmp_path / "scan.npz")
    assert arrays["delta"].shape == (49, 15)
    assert arrays["delta_fitness"][-1] == 0.0
    assert (tmp_path / "scan.png").stat().st_size > 1000
