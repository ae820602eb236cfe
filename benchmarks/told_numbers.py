"""Are the numbers that trials are said to tell true? Intervals of co-evolutions whose reality is known.

    uv run python benchmarks/told_numbers.py --robot quadruped --seeds 3 --json told.json

Every case is a co-evolution of an example robot; the true values of its unknown numbers are drawn from the seed, and
the reality has a shorter time step, so that no simulation explains all trials. Of the quadruped five are unknown:
trunk mass, stiffness of the servos, damping, armature and dry friction of all joints. A case is kept when it is done:
the same command continues a killed benchmark.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.backtoreality import CoevolveConfig, build_problem, summarise
from btr_mjx.backtoreality.algorithm import run_in_memory
from btr_mjx.errors import cli_errors
from btr_mjx.runs import describe_environment, progress, read_json, write_json

EXAMPLES = Path(__file__).parents[1] / "examples"
JOINTS = [f"{end}_{side}_{part}" for end in ("front", "rear") for side in ("left", "right") for part in ("hip", "knee")]
MORE = {
    "thrower": (),
    "quadruped": (
        ("joint damping", "damping", 0.3, 3.0, "relative = true"),
        ("armature", "armature", 0.0, 0.05, 'unit = "kg m^2"'),
        ("dry friction", "frictionloss", 0.0, 1.0, 'unit = "N m"'),
    ),
}
"""Robot -> further unknown numbers of all joints: name, attribute, bounds, and another line of robot.toml."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    robot: Literal["thrower", "quadruped"] = "quadruped"
    """Example robot."""
    seeds: int = 3
    """Co-evolutions."""
    first_seed: int = 0
    """Seed of the first of them."""
    iterations: int = 2
    """Iterations of Back-to-Reality."""
    noise: float = 0.0
    """Relative standard deviation of a measured fitness."""
    choose: Literal["best", "informative"] = "best"
    """Which controllers are tried."""
    first_population: Literal["random", "mutants"] = "random"
    """Controllers with which the search of iteration 1 begins."""
    out: Path = Path("runs/told_numbers")
    """Folder of the cases."""
    json: Path | None = None
    """Write all numbers here."""


def robot_folder(config: Config) -> Path:
    """The example with its further unknown numbers."""
    folder = config.out / config.robot
    shutil.copytree(EXAMPLES / config.robot, folder, dirs_exist_ok=True)
    blocks = ""
    for name, attribute, low, high, line in MORE[config.robot]:
        paths = ", ".join(f'"joint:{joint}/{attribute}"' for joint in JOINTS)
        blocks += f'[[parameter]]\nname = "{name}"\npath = [{paths}]\nbounds = [{low}, {high}]\n{line}\n\n'
    file = folder / "robot.toml"
    file.write_text(
        (EXAMPLES / config.robot / "robot.toml").read_text().replace("[controller]", f"{blocks}[controller]")
    )
    return folder


def case(config: Config, seed: int) -> dict[str, Any]:
    """One co-evolution: every unknown number with its interval and its true value."""
    settings = CoevolveConfig(
        robot=robot_folder(config),
        reality_engine="native",
        reality_timestep=0.0005,
        optimiser="cma",
        iterations=config.iterations,
        noise=config.noise,
        choose=config.choose,
        first_population=config.first_population,
        seed=seed,
    )
    problem = build_problem(settings)
    result = summarise(problem, run_in_memory(problem))
    told, rows = result["told"], []
    for name, (low, high) in told["intervals"].items():
        space = result["space"][name]
        row = {"name": name, "low": low, "high": high, "told": name in told["told"]}
        row |= {"identified": result["simulation"][name], "truth": result["truth"][name]}
        rows.append(row | {"range": space["high"] - space["low"]})
    return {"seed": seed, "prediction_error": result["prediction_error_last"], "told": told, "numbers": rows}


def summary(cases: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Shares of true values that lie within their intervals, and the intervals' widths."""
    rows = [row for one in cases for row in one["numbers"]]
    within = np.array([row["low"] <= row["truth"] <= row["high"] for row in rows])
    told = np.array([row["told"] for row in rows])
    width = np.array([(row["high"] - row["low"]) / row["range"] for row in rows])
    error = np.array([abs(row["identified"] - row["truth"]) / row["range"] for row in rows])
    return {
        "numbers": len(rows),
        "within": float(within.mean()),
        "told": int(told.sum()),
        "told_within": float(within[told].mean()) if told.any() else None,
        "width_median": float(np.median(width)),
        "error_median": float(np.median(error)),
        "error_median_told": float(np.median(error[told])) if told.any() else None,
    }


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        cases = []
        seeds = range(config.first_seed, config.first_seed + config.seeds)
        for seed in progress(seeds, description=config.robot, unit="runs", show=True):
            how = f"{config.choose}-{config.first_population}-{config.iterations}-{config.noise:g}"
            file = config.out / f"{config.robot}-{how}-{seed}.json"
            if not file.is_file():
                write_json(file, case(config, seed))
            cases.append(read_json(file))
        numbers = summary(cases)
        if config.json is not None:
            write_json(config.json, {"environment": describe_environment(), "summary": numbers, "cases": cases})
    print(f"{'number':20}{'seed':>5}{'truth':>10}{'identified':>12}  {'90 % interval':>21}")
    for one in cases:
        for row in one["numbers"]:
            missed = "" if row["low"] <= row["truth"] <= row["high"] else "missed"
            line = f"{row['name']:20}{one['seed']:5}{row['truth']:10.4g}{row['identified']:12.4g}  {row['low']:10.4g} "
            print(f"{line}{row['high']:10.4g}  {'told' if row['told'] else '':5}{missed}".rstrip())
        for sentence in one["told"]["combinations"]:
            print(f"  seed {one['seed']}: {sentence}")
    for name, value in numbers.items():
        print(f"{name:20} {value}")


if __name__ == "__main__":
    main()
