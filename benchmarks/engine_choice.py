"""What `--engine auto` chooses and how well it knows: `uv run python benchmarks/engine_choice.py`.

For robots that differ in their contacts: time until lanes has run once (importing JAX, tracing, compiling; nothing is
read from a cache), the speed of lanes relative to native MuJoCo as `choose_engine` measures it at the beginning of
trials, and as whole trials of other controllers show. Each robot has a process of its own.
"""

import dataclasses
import json
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tyro

from btr_mjx.evaluation import Engine, choose_engine, evaluate
from btr_mjx.models import load_robot
from btr_mjx.robots import Robot, hexapod

EXAMPLES = Path(__file__).parents[1] / "examples"

FEET: Mapping[str, tuple[str, int, int]] = {
    "pyramidal, condim 6": ("pyramidal", 1, 6),
    "elliptic, condim 3": ("elliptic", 1, 3),
    "elliptic, condim 6": ("elliptic", 100, 6),  # as of the Go1 of MuJoCo's Menagerie
}
"""Cone, impratio and condim of the quadruped's feet."""

NAMES = ("hexapod", "thrower", "quadruped", *FEET)


@dataclasses.dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    robots: tuple[str, ...] = NAMES
    """Robots that are measured."""
    pairs: int = 256
    """Pairs of the whole trials with lanes; native MuJoCo gets an eighth."""
    json: Path | None = None
    """Also write the numbers to this file."""
    alone: bool = False
    """Measure the first robot in this process and print its numbers as JSON."""


def robot_of(name: str) -> Robot:
    """A robot by its name; of `FEET`, the quadruped with other feet."""
    if name == "hexapod":
        return hexapod()
    robot = load_robot(EXAMPLES / ("thrower" if name == "thrower" else "quadruped") / "robot.toml")
    if name not in FEET:
        return robot
    cone, impratio, condim = FEET[name]
    feet = f'density="400" condim="{condim}" priority="1" friction="0.8 0.02 0.01"'
    text = robot.template.replace('density="400"', feet)
    option = f'integrator="implicitfast" cone="{cone}" impratio="{impratio}"'
    return dataclasses.replace(robot, template=text.replace('integrator="implicitfast"', option))


def measure(robot: Robot, pairs: int) -> dict[str, float]:
    """First call of lanes [s], and its speed relative to native: as the choice measures it, and in whole trials."""
    c = robot.controller_box.sample(np.random.default_rng(1), pairs)

    def seconds(engine: Engine, count: int) -> float:
        start = time.perf_counter()
        evaluate(robot, robot.nominal_simulation, c[:count], engine=engine)
        return (time.perf_counter() - start) / count

    seconds("native", 1)
    start = time.perf_counter()
    import jax

    jax.config.update("jax_enable_compilation_cache", False)
    evaluate(robot, robot.nominal_simulation, c[:1], engine="lanes", times=[robot.duration / 100])
    first = time.perf_counter() - start
    ratios = [seconds("native", pairs // 8) / seconds("lanes", pairs) for _ in range(3)]
    return {
        "native [ms]": 1e3 * seconds("native", pairs // 8),
        "first call [s]": first,
        "chosen by": choose_engine(robot).ratio or float("nan"),
        "whole trials": float(np.median(ratios)),
    }


def main(config: Config) -> None:
    """Print the table, a row as soon as it is known."""
    if config.alone:
        print(json.dumps(measure(robot_of(config.robots[0]), config.pairs)))
        return
    rows = {}
    for name in config.robots:
        command = [sys.executable, __file__, "--alone", f"--pairs={config.pairs}", "--robots", name]
        out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        rows[name] = json.loads(out.splitlines()[-1])
        if len(rows) == 1:
            print(f"{'':22}" + "".join(f"{key:>16}" for key in rows[name]))
        print(f"{name:22}" + "".join(f"{value:16.3g}" for value in rows[name].values()), flush=True)
    if config.json is not None:
        config.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
