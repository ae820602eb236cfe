"""Cost of preparing morphologies, compared with simulating them: `uv run python benchmarks/models.py`.

Every morphology is simulated once by the lanes engine. The stages run in turn in each of several rounds, so that other
load on the machine affects all of them; ratios are medians of the ratios of the rounds.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import mujoco
import numpy as np
import tyro

from btr_mjx.engines import use_all_cores
from btr_mjx.evaluation.engine_choice import program_of
from btr_mjx.models import compile_models, load_robot, varying_fields
from btr_mjx.robots import hexapod
from btr_mjx.runs import available_cores

QUADRUPED = Path(__file__).parents[1] / "examples/quadruped"


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    morphologies: int = 1000
    """Number of morphologies that are prepared."""
    steps: int = 3400
    """Steps of a simulation."""
    compiled: int = 100
    """Number of morphologies that are rendered and compiled alone, without checks, for comparison."""
    rounds: int = 3
    """Number of rounds; every stage runs once a round."""
    json: Path | None = None
    """Also write the numbers to this file."""


def main(config: Config) -> None:
    """Run all rounds and print the table."""
    use_all_cores()
    robot = hexapod()
    rng = np.random.default_rng(0)
    simulations = robot.simulation_box.sample(rng, config.morphologies)
    start = time.perf_counter()
    varying_fields(robot)
    first = time.perf_counter() - start

    # One block of pairs, as in `evaluate`; all blocks have the same cost per pair.
    program = program_of(robot, "lanes", 1, False, None)
    size = program.layout.pairs
    controllers = robot.controller_box.sample(rng, size)
    leaves = compile_models(robot, np.resize(simulations, (size, robot.simulation_box.n))).leaves
    samples = np.array([config.steps])
    arguments = program.arguments(leaves, controllers, samples)
    compiled = program.function.lower(*arguments).compile()

    def prepare() -> None:
        compile_models(robot, robot.simulation_box.sample(rng, config.morphologies))  # new ones: some are kept

    def compile_each() -> None:
        for s in simulations[: config.compiled]:
            mujoco.MjModel.from_xml_string(robot.render(s))

    stages: dict[str, tuple[Callable[[], object], int]] = {
        "prepare": (prepare, config.morphologies),
        "lay out for the engine": (lambda: program.arguments(leaves, controllers, samples), size),
        "simulate": (lambda: jax.block_until_ready(compiled(*arguments)), size),
        "render and compile each": (compile_each, config.compiled),
    }
    seconds: dict[str, list[float]] = {name: [] for name in stages}
    for run, _ in stages.values():
        run()  # warm up
    for _ in range(config.rounds):
        for name, (run, count) in stages.items():
            start = time.perf_counter()
            run()
            seconds[name].append((time.perf_counter() - start) / count)

    simulate = np.array(seconds["simulate"])
    share = {name: float(np.median(np.array(x) / simulate)) for name, x in seconds.items()}
    print(
        f"{available_cores()} cores, {config.morphologies} morphologies, {config.steps} steps, {config.rounds} rounds"
    )
    print(f"{'':26}{'us each':>10}{'of simulating':>15}")
    for name, x in seconds.items():
        print(f"{name:26}{np.median(x) * 1e6:10.1f}{share[name]:15.1%}")
    print(f"once per robot: {first:.2f} s")
    walker = load_robot(QUADRUPED)
    varying_fields(walker)
    start = time.perf_counter()
    compile_models(walker, walker.simulation_box.sample(rng, 1000))
    paths = time.perf_counter() - start
    print(f"1,000 quadrupeds whose numbers are set by paths: {paths:.2f} s")
    if config.json is not None:
        numbers = {
            "us_each": {name: float(np.median(x) * 1e6) for name, x in seconds.items()},
            "share_of_simulating": share,
            "once_per_robot_s": first,
            "thousand_by_paths_s": paths,
            "seconds": seconds,
        }
        config.json.write_text(json.dumps(numbers, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
