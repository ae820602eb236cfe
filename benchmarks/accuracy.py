"""Error of the lanes engine against native MuJoCo over time: `uv run python benchmarks/accuracy.py`.

In double precision the trajectory of lanes is compared with native MuJoCo's for a whole trial. In single precision
contacts make the two diverge, as they do between any two machines. There the fitness is compared: its correlation over
gaits and its error. JAX's precision is fixed within a process, so that each precision has a process of its own.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from scipy import stats

from btr_mjx.evaluation import Evaluation, evaluate
from btr_mjx.models import base_model
from btr_mjx.robots import Robot, hexapod

MARKS = (1, 10, 100, 340, 850, 1700, 2550, 3400)
"""Steps after which states are compared."""
STATE_ERROR = 1e-9
"""Aim for the largest error of a coordinate in float64 [m or rad]."""
PEARSON = 0.99
"""Aim for the correlation of fitness in float32."""
FITNESS_ERROR = 1e-3
"""Aim for the median error of fitness in float32 [m/s]."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    steps: int = MARKS[-1]
    """Steps per pair."""
    double_pairs: int = 8
    """Random pairs in double precision."""
    single_pairs: int = 256
    """Random pairs in single precision."""
    seed: int = 0
    """Seed of the pairs."""
    json: Path | None = None
    """Also write the numbers to this file."""
    precision: Literal["both", "float64", "float32"] = "both"
    """Measure one precision in this process and print JSON: what the command runs for each."""


def both_ways(config: Config, pairs: int, states: bool) -> tuple[np.ndarray, Evaluation, Evaluation]:
    """Random pairs by lanes and by native MuJoCo.

    Args:
      config: settings.
      pairs: number of pairs.
      states: whether to record full states.

    Returns:
      (K,) marks in steps, and the two evaluations, sampled at the marks.
    """
    timestep = float(base_model(hexapod()).opt.timestep)
    marks = np.unique([*(mark for mark in MARKS if mark < config.steps), config.steps])
    robot: Robot = replace(hexapod(), duration=config.steps * timestep)
    rng = np.random.default_rng(config.seed)
    s, c = robot.simulation_box.sample(rng, pairs), robot.controller_box.sample(rng, pairs)
    fast, exact = (
        evaluate(robot, s, c, pairwise=True, engine=engine, times=marks * timestep, states=states)
        for engine in ("lanes", "native")
    )
    return marks, fast, exact


def double(config: Config) -> dict[str, Any]:
    """Largest difference of any coordinate at the marks, in JAX's double precision."""
    marks, fast, exact = both_ways(config, config.double_pairs, True)
    assert fast.outcome.qpos is not None
    assert exact.outcome.qpos is not None
    error = np.abs(fast.outcome.qpos - exact.outcome.qpos).max((0, 2))
    return {"pairs": config.double_pairs, "steps": marks.tolist(), "qpos_error": error.tolist()}


def single(config: Config) -> dict[str, Any]:
    """Fitness against native MuJoCo's, and the error of the base's position at the marks."""
    marks, fast, exact = both_ways(config, config.single_pairs, False)
    distance = np.linalg.norm(fast.outcome.position - exact.outcome.position, axis=-1)  # (pairs, marks)
    valid = ~(fast.diverged | exact.diverged)
    difference = np.abs(fast.fitness - exact.fitness)[valid]
    return {
        "pairs": config.single_pairs,
        "diverged": int((~valid).sum()),
        "steps": marks.tolist(),
        "position_error_median": np.median(distance[valid], axis=0).tolist(),
        "position_error_p90": np.quantile(distance[valid], 0.9, axis=0).tolist(),
        "pearson": float(stats.pearsonr(fast.fitness[valid], exact.fitness[valid]).statistic),
        "fitness_error_median": float(np.median(difference)),
        "fitness_error_p90": float(np.quantile(difference, 0.9)),
    }


def in_own_process(config: Config, precision: str) -> dict[str, Any]:
    """One precision in a new process."""
    flags = [f"--steps={config.steps}", f"--double-pairs={config.double_pairs}", f"--seed={config.seed}"]
    output = subprocess.run(
        [sys.executable, __file__, f"--precision={precision}", *flags, f"--single-pairs={config.single_pairs}"],
        stdout=subprocess.PIPE,
        env=os.environ | {"JAX_ENABLE_X64": str(int(precision == "float64"))},
        check=True,
        text=True,
    ).stdout
    return json.loads(output.splitlines()[-1])


def main(config: Config) -> None:
    """Run both processes and print the table."""
    if config.precision != "both":
        print(json.dumps((double if config.precision == "float64" else single)(config)))
        return
    wide, narrow = (in_own_process(config, precision) for precision in ("float64", "float32"))
    print(f"lanes against native MuJoCo: {wide['pairs']} pairs in float64, {narrow['pairs']} pairs in float32")
    print(f"{'':>8}{'float64':>16}{'float32: base position error [m]':>36}")
    print(f"{'steps':>8}{'max |dqpos|':>16}{'median':>18}{'90 %':>18}")
    columns = (wide["steps"], wide["qpos_error"], narrow["position_error_median"], narrow["position_error_p90"])
    for step, state, median, high in zip(*columns, strict=True):
        print(f"{step:8}{state:16.1e}{median:18.1e}{high:18.1e}")
    print(f"float64: largest error {max(wide['qpos_error']):.1e} (aim: {STATE_ERROR:.0e})")
    print(
        f"float32: fitness correlates with r = {narrow['pearson']:.4f} (aim: {PEARSON}), differs by "
        f"{narrow['fitness_error_median']:.1e} m/s in the median (aim: {FITNESS_ERROR:.0e}) and "
        f"{narrow['fitness_error_p90']:.1e} m/s at 90 %; {narrow['diverged']} diverged"
    )
    if config.json is not None:
        numbers = {
            "float64": wide | {"fine": max(wide["qpos_error"]) <= STATE_ERROR},
            "float32": narrow
            | {"fine": narrow["pearson"] >= PEARSON and narrow["fitness_error_median"] <= FITNESS_ERROR},
        }
        config.json.write_text(json.dumps(numbers, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
