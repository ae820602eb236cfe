"""What the experiments are made of: numbers of curves, verdicts, searches, robots."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import bench as bench_room
import curves
import fig2_scans
import fig4_identification
import identification
import mujoco
import numpy as np
import pytest
import scipy.stats
import thirty_unknowns
import verdicts

from btr_mjx.models import base_model
from btr_mjx.robots import Box, Robot, hexapod
from btr_mjx.runs import read_arrays


@pytest.mark.parametrize(
    ("sense", "low", "high", "verdict"),
    [
        ("at most", 0.0, 0.0, "holds"),
        ("less than", 0.0, 0.0, "does not"),
        ("at least", 0.8, 1.0, "holds"),
        ("more than", -0.1, 0.1, "undecided"),
        ("more than", -0.2, -0.1, "does not"),
        ("more than", np.nan, np.nan, "undecided"),
    ],
)
def test_verdicts(sense: Any, low: float, high: float, verdict: str) -> None:
    bound = 0.5 if sense == "at least" else 0.0
    assert verdicts.Claim("", "", sense, bound, 0.0, low, high, 3).verdict == verdict
    short = verdicts.Claim("", "", sense, bound, 0.0, low, high, 3, whole=False).verdict
    assert short == ("undecided at this size" if verdict == "does not" else verdict)


def test_thirty_unknowns(tmp_path: Path) -> None:
    """The robot has all declared parameters, and the saved search starts at the declared point."""
    robot = thirty_unknowns.detailed_hexapod()
    box = robot.simulation_box
    model = mujoco.MjModel.from_xml_string(robot.render(robot.nominal_simulation))
    plain = mujoco.MjModel.from_xml_string(hexapod().render(hexapod().nominal_simulation))
    changed = robot.nominal_simulation.copy()
    changed[box.indices(["density_4", "kp_2", "friction"])] = [110.0, 1300.0, 0.5]
    other = mujoco.MjModel.from_xml_string(robot.render(changed))
    assert box.n == 32
    assert model.body("b3").mass == plain.body("b3").mass
    assert other.body("b4").mass / model.body("b4").mass == pytest.approx(110 / 200, rel=1e-12)
    different = [
        model.actuator(i).name
        for i in range(18)
        if (other.actuator(i).gainprm != model.actuator(i).gainprm).any()
        or (other.actuator(i).biasprm != model.actuator(i).biasprm).any()
    ]
    assert different == ["j4_vertical", "j4_frontal", "j10"]
    assert other.geom("foot0").friction[0] == 0.5
    thirty_unknowns.main(["--preset", "tiny", "--no-progress", "--out", str(tmp_path)])
    arrays = read_arrays(tmp_path / "search-0.npz")
    assert (np.abs(arrays["start"] - arrays["truth"]) <= 0.2 * arrays["span"] + 1e-9).all()
    assert json.loads((tmp_path / "thirty.json").read_text())["lengths"]["seeds"] == 2


def test_other_physics_are_another_integrator(robot: Robot) -> None:
    own = mujoco.mjtIntegrator(base_model(robot).opt.integrator)
    assert fig4_identification.OTHER_PHYSICS.integrator == "rk4"
    assert own == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert fig4_identification.OTHER_PHYSICS.timestep != base_model(robot).opt.timestep


def test_curve_numbers(rng: np.random.Generator) -> None:
    grid, truth = np.linspace(0.4, 1.6, 25), 0.9
    curve = np.abs(grid - truth) + rng.normal(0, 0.1, 25)
    curve[3] = np.nan
    found = curves.curve_numbers(grid, curve, truth)
    left, right = (grid <= truth) & np.isfinite(curve), grid >= truth
    for name, statistic in (("rho_sides", scipy.stats.spearmanr), ("linearity", scipy.stats.pearsonr)):
        sides = [statistic(curve[side], np.abs(grid - truth)[side]).statistic for side in (left, right)]
        assert found[name] == pytest.approx(np.mean(sides))
    rough = [np.abs(np.diff(curve[side])).sum() / np.ptp(curve[side]) for side in (left, right)]
    assert found["roughness_sides"] == pytest.approx(np.mean(rough))
    assert found["off"] == abs(grid[np.nanargmin(curve)] - truth)
    several = curves.curve_numbers(grid, np.stack([curve, np.abs(grid - truth)]), truth)
    assert several["rho_sides"] == pytest.approx((found["rho_sides"] + 1) / 2)


def test_sensitivity_to_parameters() -> None:
    grid = np.linspace(0.4, 1.6, 49)
    fitness = np.stack([np.maximum(grid - 1.1, 0), 2 * np.maximum(grid - 1.1, 0)], axis=1)
    assert curves.plateau_sensitivity(grid, fitness, 0.4, 1.1) == pytest.approx(0, abs=1e-12)
    assert (
        curves.plateau_sensitivity(grid, fitness, 1.1, 1.6) == np.inf
        or curves.plateau_sensitivity(grid, fitness, 1.1, 1.6) > 10
    )
    keep = curves.influence(grid, [fitness], 1.6)
    assert 1.0 <= grid[keep].min() <= 1.1
    assert grid[keep].max() == 1.6


def test_averages_over_behaviours(rng: np.random.Generator) -> None:
    """The mean over m behaviours reduces noise; the curve of all behaviours does not depend on the draws."""
    grid, truth = np.linspace(0.4, 1.6, 25), 0.9
    slopes = rng.uniform(0.5, 2, 30)
    f_s = slopes * (grid - truth)[:, None] + rng.normal(0, 0.2, (25, 30)) * (grid != truth)[:, None]
    delta = np.abs(f_s)
    found = curves.subset_numbers(grid, delta, truth, [1, 5, 30])
    assert found[1]["rho_sides"] < found[5]["rho_sides"] < found[30]["rho_sides"]
    assert found[30] == pytest.approx(curves.curve_numbers(grid, delta.mean(axis=1), truth))
    noisy = curves.noise_numbers(grid, f_s + 1, np.ones(30), truth, [1, 30], 0.3)
    assert noisy[30]["off"] < noisy[1]["off"]


def test_searches_find_a_bowl() -> None:
    box = Box([f"x_{i}" for i in range(4)], 0.4, 1.6, bits=10)
    truth = np.array([0.54, 0.74, 1.1, 0.9])
    start = identification.away_from(truth, box, 0.2, 0)
    np.testing.assert_allclose(np.abs(start - truth), 0.2)
    assert ((start >= box.low) & (start <= box.high)).all()

    def bowl(x: np.ndarray) -> np.ndarray:
        value = np.abs(x - truth).sum(axis=1)
        value[::7] = np.nan  # failures must not stop either search
        return value

    ga = identification.genetic(bowl, box, start, 30, 40, (0.2, 0.02), seed=1)
    cma = identification.cma_es(bowl, box, start, 16, 120, seed=1)
    adam = identification.adam(lambda x: ((x - truth) ** 2).sum(axis=1), box, start, 150)
    assert ga.error(truth)[-1] < 0.02
    assert cma.error(truth)[-1] < 0.002
    assert adam.error(truth)[-1] < 0.005  # within its finite differences
    assert len(cma.values) < 120  # it stops once it has converged
    assert (np.diff(np.nanmin(ga.values, axis=1)) <= 0.3).all()
    np.testing.assert_allclose(ga.parameters[0, 0], start, atol=0.6 / 1023)


def test_marks_share_a_bench() -> None:
    """Fitness at a mark does not depend on the rest of the trial."""
    config = fig2_scans.PRESETS["tiny"]
    bench = bench_room.Bench.of(config, lambda count: None)
    robot = dataclasses.replace(hexapod(), duration=config.duration)
    rng = np.random.default_rng(0)
    s, c = robot.simulation_box.sample(rng, 2), robot.controller_box.sample(rng, 3)
    np.testing.assert_array_equal(bench.early(s, c), bench.whole(s, c)[..., :-1])
