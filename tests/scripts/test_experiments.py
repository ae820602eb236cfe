"""The paper's experiments at tiny sizes: saved data against plain loops and scipy, resuming, drawing alone."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import bench as bench_room
import btr_twelve
import claims
import fig2_scans
import fig3_behaviours
import fig4_identification
import fig5_metrics
import maps
import numpy as np
import pytest
import scipy.stats
import units as units_room

from btr_mjx.errors import Interrupted
from btr_mjx.robots import hexapod
from btr_mjx.runs import RunFolder, StopRequest, read_arrays

FIGURES: dict[str, Any] = claims.FIGURES


TINY = ["--preset", "tiny", "--no-progress", "--out"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All experiments, computed once; then figures and claims, from saved files without simulation."""
    path = tmp_path_factory.mktemp("experiments")
    for name, config in claims.configs(claims.ClaimsConfig(preset="tiny", out=path, progress=False)).items():
        assert FIGURES[name].compute(config) > 0
        assert not list(path.rglob("*.png"))
    with pytest.MonkeyPatch.context() as patch:
        forbid_simulation(patch)
        claims.main([*TINY, str(path), "--gallery", str(path / "gallery")])
    return path


def numbers(path: Path) -> Any:
    return json.loads(path.read_text())


def forbid_simulation(patch: pytest.MonkeyPatch) -> None:
    """Any call that would simulate fails."""

    def refuse(*args: Any, **options: Any) -> None:
        raise AssertionError("simulated")

    for module in (bench_room, fig5_metrics):
        patch.setattr(module, "evaluate", refuse)
    patch.setattr(fig2_scans, "evolve_controllers", refuse)


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    forbid_simulation(monkeypatch)


# ---- what was saved ----


def test_fig2(folder: Path) -> None:
    summary = numbers(folder / "fig2_scans" / "fig2.json")
    config = fig2_scans.PRESETS["tiny"]
    for seed in range(config.seeds):
        arrays = read_arrays(folder / "fig2_scans" / f"seed-{seed}.npz")
        for parameter, truth in fig2_scans.TRUTHS.items():
            part = {k.partition("/")[2]: v for k, v in arrays.items() if k.startswith(parameter + "/")}
            assert part["grid"].tolist() == sorted({*np.linspace(0.4, 1.6, config.grid).tolist(), truth})
            assert part["fitness"].shape == (len(part["grid"]), config.trials, config.marks + 1)
            assert part["scores"].shape == (config.generations, config.population)
            each = np.abs(part["fitness"][..., -1] - part["real"][:, -1])
            assert (each[part["grid"] == truth] == 0.0).all()  # Theorem 1
            mean, error = each.mean(axis=1), np.abs(part["grid"] - truth)
            row = summary[parameter]["seeds"][seed]
            assert float(row["rho"]) == pytest.approx(scipy.stats.spearmanr(mean, error).statistic)
            assert row["roughness"] == pytest.approx(np.abs(np.diff(mean)).sum() / np.ptp(mean))
            assert row["lost"] == pytest.approx((part["start"] - part["real"])[:, -1].mean())
            assert row["elsewhere"] == mean[error > 0].min() > 0


def test_fig3(folder: Path) -> None:
    summary = numbers(folder / "fig3_behaviours" / "fig3.json")
    config = fig3_behaviours.PRESETS["tiny"]
    assert summary["at_truth"] == 0.0
    assert list(summary["by_m"]) == ["1", "3", "9"]
    low, high = summary["influence"]
    assert low <= fig3_behaviours.TRUTH <= high
    for seed in range(config.seeds):
        arrays = read_arrays(folder / "fig3_behaviours" / f"seed-{seed}.npz")
        grid = arrays["grid"]
        assert arrays["diverse"].shape == (config.diversities, len(grid), config.trials, config.marks + 1)
        keep = (grid >= low) & (grid <= high)
        each = np.abs(arrays["fitness"][..., -1] - arrays["real"][:, -1])
        curve = [np.mean([each[i, k] for k in range(config.mutants)]) for i in range(len(grid))]
        off = abs(grid[keep][np.argmin(np.array(curve)[keep])] - fig3_behaviours.TRUTH)
        assert summary["by_m"]["9"]["off"]["values"][seed] == off
    assert len({row["p_m"] for row in summary["by_p_m"]}) == config.diversities


def test_fig4(folder: Path) -> None:
    path, config = folder / "fig4_identification", fig4_identification.PRESETS["tiny"]
    summary = numbers(path / "fig4.json")
    assert summary["at_truth"] == 0.0
    for name, shape in (("ga", (3, 6, 4)), ("cma", (3, 6, 4)), ("multiscale-12", (2, 6, 12)), ("noisy-12", (2, 6, 12))):
        for seed in range(config.seeds):
            arrays = read_arrays(path / f"{name}-{seed}.npz")
            assert arrays["parameters"].shape == shape
            assert arrays["values"].shape == shape[:2]
            away = config.away if shape[2] == 4 else config.away_12
            np.testing.assert_allclose(np.abs(arrays["start"] - arrays["truth"]), away)
            g, member = np.unravel_index(arrays["values"].argmin(), shape[:2])
            error = np.abs(arrays["parameters"][g, member] - arrays["truth"]).mean()
            assert summary["searches"][name]["error"]["values"][seed] == pytest.approx(error)
    exact, other = (read_arrays(path / f"{name}-12-0.npz") for name in ("multiscale", "native"))
    np.testing.assert_array_equal(exact["parameters"][0], other["parameters"][0])
    assert (exact["values"] != other["values"]).all()
    # The first population contains s_0; the distance of any member is that of a direct call.
    ga = read_arrays(path / "ga-0.npz")
    np.testing.assert_allclose(ga["parameters"][0, 0], ga["start"], atol=1.2 / 2**10)


def test_fig5(folder: Path) -> None:
    config = fig5_metrics.PRESETS["tiny"]
    summary = numbers(folder / "fig5_metrics" / "fig5.json")
    for seed in range(config.seeds):
        arrays = read_arrays(folder / "fig5_metrics" / f"seed-{seed}.npz")
        other = read_arrays(folder / "fig2_scans" / f"seed-{seed}.npz")
        at = arrays["grid"] == fig5_metrics.TRUTH
        assert arrays["rolling"].shape == (len(fig5_metrics.HEADERS), len(at), config.trials)
        assert (arrays["rolling"][:, at] == 0).all()
        assert (arrays["rolling"][:, ~at] > 0).all()
        assert (arrays["euclidean"][at] == 0).all()
        # The same behaviours as Fig. 2c, measured by the same fitness at T_e.
        np.testing.assert_array_equal(arrays["fitness"][..., -1], other["bl_5/fitness"][..., -1])
        r = np.corrcoef(arrays["rolling"][-1].mean(axis=1), arrays["euclidean"].mean(axis=1))[0, 1]
        assert summary["like_euclidean"]["100 %"]["values"][seed] == pytest.approx(r)


def test_claims(folder: Path) -> None:
    rows = numbers(folder / "claims.json")
    assert len(rows) >= 12
    assert all(list(row)[:5] == ["claim", "statistic", "low", "high", "verdict"] for row in rows)
    assert {row["verdict"] for row in rows} <= {"holds", "undecided", "undecided at this size"}  # tiny
    assert [row["verdict"] for row in rows[:2]] == ["holds", "holds"]  # Theorems 1 and 2, at any size
    text = (folder / "claims.md").read_text()
    assert all(row["claim"] in text for row in rows)
    assert len({row["claim"] for row in rows}) == len(rows)
    shown = {"claims.json", "claims.md", "claims.png", "fig2.png", "fig3.png", "fig4.png", "fig5.png"}
    assert {path.name for path in (folder / "gallery").iterdir()} == shown
    assert (folder / "gallery" / "claims.md").read_text() == text
    unexplained = [row["claim"] for row in rows if row["verdict"] == "holds" and row["why"]]
    assert not unexplained


# ---- without simulating ----


@pytest.mark.usefixtures("no_simulation")
def test_drawing_does_not_simulate(folder: Path) -> None:
    """The fixture drew all figures without simulation; --draw-only draws one again with the same numbers."""
    assert all(next((folder / name).glob("*.png")).stat().st_size > 10_000 for name in FIGURES)
    picture, summary = folder / "fig2_scans" / "fig2.png", folder / "fig2_scans" / "fig2.json"
    before = summary.read_bytes()
    picture.unlink()
    fig2_scans.main([*TINY, str(folder / "fig2_scans"), "--draw-only"])
    assert picture.stat().st_size > 10_000
    assert summary.read_bytes() == before


@pytest.mark.usefixtures("no_simulation")
def test_bad_input_is_one_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    cases = [
        ([fig2_scans, "--draw-only", "--out", str(tmp_path / "no")], "nothing was computed"),
        ([fig2_scans, "--trials", "6", "--out", str(tmp_path / "no")], "m = 6"),
        ([fig2_scans, "--grid", "6", "--out", str(folder / "fig2_scans")], "grid"),
        ([fig3_behaviours, "--mutants", "1", "--out", str(tmp_path / "no")], "mutants 1"),
        ([fig4_identification, "--members", "2", "--out", str(tmp_path / "no")], "members 2"),
        ([fig5_metrics, "--samples", "10", "--out", str(tmp_path / "no")], "samples"),
    ]
    for (module, *flags), words in cases:
        with pytest.raises(SystemExit) as stop:
            module.main([*TINY[:-1], *flags])
        assert stop.value.code == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1
        assert words in lines[0]
    assert not (tmp_path / "no").exists()


def test_maps(tmp_path: Path) -> None:
    flags = ["--seeds", "1", "--behaviours", "2", "--noises", "0", "--horizons", "0.02"]
    maps.main([*TINY, str(tmp_path / "maps"), *flags])
    summary = numbers(tmp_path / "maps" / "maps.json")
    assert set(summary) == {
        *("m2-noise0", "m2-native", "horizon0.02-noise0", "horizon0.02-noise5", "curriculum-noise0"),
        *("curriculum-noise5", "marks1", "marks2", "p_m0.2", "p_m-random"),
        *("choice-random", "choice-fittest", "choice-disagreement", "truth"),
    }
    # Both strategies begin with the same three trials.
    assert summary["choice-random"][0] == summary["choice-disagreement"][0]
    assert (tmp_path / "maps" / "maps.png").exists()
    maps.main([*TINY, str(tmp_path / "one"), "--seeds", "1", "--parts", "truth"])
    assert set(numbers(tmp_path / "one" / "maps.json")) == {"truth"}
    maps.main([*TINY, str(tmp_path / "one"), "--seeds", "1", "--parts", "marks", "--resume"])
    assert set(numbers(tmp_path / "one" / "maps.json")) == {"truth", "marks1", "marks2"}


# ---- resuming ----


def test_btr_twelve_in_other_physics(tmp_path: Path) -> None:
    btr_twelve.main(["--preset", "tiny", "--seeds", "1", "--no-progress", "--physics", "other", "--out", str(tmp_path)])
    config = numbers(tmp_path / "seed-0" / "config.json")
    assert (config["reality_engine"], config["reality_integrator"]) == ("native", "rk4")
    assert config["reality_timestep"] == 2.5e-4


def test_btr_twelve(tmp_path: Path) -> None:
    """Its numbers are those of the runs; drawing again does not simulate."""
    words = ["--preset", "tiny", "--seeds", "1", "--no-progress", "--out", str(tmp_path)]
    btr_twelve.main(words)
    row, result = numbers(tmp_path / "btr_twelve.json")["seeds"][0], numbers(tmp_path / "seed-0" / "result.json")
    robot = dataclasses.replace(hexapod(), duration=0.06)
    found = btr_twelve.evaluate(
        robot, [list(result["simulation"].values())], [result["best_controller"]], engine="native"
    )
    assert row["f_s"] == found.fitness[0, 0]
    assert row["gap"] == pytest.approx(abs(row["f_s"] / result["f_r_best"] - 1))
    assert set(result["truth"]) == set(robot.simulation_box.names)
    btr_twelve.main([*words, "--draw-only"])


def test_a_killed_run_can_be_resumed(folder: Path, tmp_path: Path) -> None:
    """SIGKILL after the first unit; --resume gives the same files, and more seeds add to them."""
    script = Path(fig2_scans.__file__)
    words = [sys.executable, str(script), "--preset", "tiny", "--out", str(tmp_path / "run"), "--no-progress"]
    process = subprocess.Popen([*words, "--seeds", "40"], stdout=subprocess.DEVNULL)
    try:
        while not (tmp_path / "run" / "seed-0.npz").exists():
            assert process.poll() is None
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = {path.name: path.read_bytes() for path in (tmp_path / "run").glob("seed-*.npz")}
    assert done.keys() != {f"seed-{i}.npz" for i in range(40)}
    fig2_scans.main([*words[2:], "--seeds", str(len(done) + 1), "--resume"])
    for name, content in done.items():
        assert (tmp_path / "run" / name).read_bytes() == content
    assert len(list((tmp_path / "run").glob("seed-*.npz"))) == len(done) + 1
    assert done["seed-0.npz"] == (folder / "fig2_scans" / "seed-0.npz").read_bytes()


def test_a_unit_resumes_from_its_saved_calls(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that failed in its last generation reads the others from its journal and ends in the same bytes."""
    config = dataclasses.replace(fig4_identification.PRESETS["tiny"], out=tmp_path / "run")
    unit = next(one for one in fig4_identification.units(config) if one.name == "cma-0")
    original, calls = bench_room.evaluate, []

    def failing(*args: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 4:
            raise MemoryError
        return original(*args, **options)

    monkeypatch.setattr(bench_room, "evaluate", failing)
    with RunFolder.create(config.folder, config) as run:
        shutil.copy(folder / "fig4_identification" / "behaviours-0.npz", config.folder)
        journal = units_room.Journal(run, unit.name, lambda count: None, StopRequest(), interval=0.0)
        with pytest.raises(MemoryError):
            unit.work(lambda count: None, journal)
    with RunFolder.create(config.folder, config, resume=True) as run:
        arrays = unit.work(lambda count: None, units_room.Journal(run, unit.name, lambda count: None, StopRequest()))
    assert len(calls) == 3 + 2  # 3 from the journal; the one that failed, again
    expected = read_arrays(folder / "fig4_identification" / "cma-0.npz")
    for name, value in expected.items():
        np.testing.assert_array_equal(arrays[name], value)


def test_a_unit_stops_after_the_current_call(tmp_path: Path) -> None:
    """A stop request does not wait for the end of the unit; results so far are kept."""
    config, stop, nothing = fig2_scans.PRESETS["tiny"], StopRequest(), lambda count: None
    with RunFolder.create(tmp_path / "run", config) as run:
        journal = units_room.Journal(run, "seed-0", nothing, stop)
        assert journal(lambda: np.array(1.0), 1) == 1.0
        stop.signum = signal.SIGINT
        with pytest.raises(Interrupted):
            journal(lambda: np.array(2.0), 1)
    with RunFolder.create(tmp_path / "run", config, resume=True) as run:
        journal = units_room.Journal(run, "seed-0", nothing, StopRequest())
        # Nothing is computed again: the numbers are the saved ones.
        assert [float(journal(lambda: np.array(0.0), 1)) for _ in range(3)] == [1.0, 2.0, 0.0]


def test_a_damaged_unit_is_computed_again(folder: Path, tmp_path: Path) -> None:
    config = dataclasses.replace(fig2_scans.PRESETS["tiny"], out=tmp_path, seeds=1, progress=False)
    units = fig2_scans.units(config)
    content = (folder / "fig2_scans" / "seed-0.npz").read_bytes()
    (tmp_path / "seed-0.npz").write_bytes(content)
    assert units_room.missing(tmp_path, units) == []
    (tmp_path / "seed-0.npz").write_bytes(content[:-200])
    assert units_room.missing(tmp_path, units) == units
