"""Speed of one engine on the device that JAX chooses: `uv run python benchmarks/accelerator.py --engine mjx`.

Each engine runs in a process of its own: where XLA does not come to an end with a program, the others are measured all
the same. `native` runs on the processor, beside which the accelerator is to be judged:

    for engine in native mjx lanes; do timeout 240 python benchmarks/accelerator.py --engine $engine; done

The first pairs are compared with native MuJoCo, so that a fast wrong answer does not count.
"""

import json
import time
from dataclasses import dataclass, replace
from typing import Literal

import jax
import numpy as np
import tyro

from btr_mjx.evaluation import EngineSettings, evaluate
from btr_mjx.robots import hexapod
from btr_mjx.runs import available_cores


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    engine: Literal["native", "mjx", "lanes"] = "lanes"
    """Engine."""
    pairs: int = 16384
    """Number of pairs (s, c)."""
    chunk: int | None = None
    """Pairs that are stepped together; None for the engine's own choice."""
    duration: float = 0.1
    """Duration of a trial [s]."""
    rounds: int = 2
    """Number of timed calls."""


def main(config: Config) -> None:
    """Measure and print one line of JSON."""
    robot = replace(hexapod(), duration=config.duration)
    rng = np.random.default_rng(0)
    simulations = robot.simulation_box.clip(
        robot.nominal_simulation * rng.uniform(0.8, 1.2, (config.pairs, robot.simulation_box.n))
    )
    controllers = robot.controller_box.sample(rng, config.pairs)

    def run(engine: Literal["native", "mjx", "lanes"], count: int) -> tuple[np.ndarray, float]:
        start = time.perf_counter()
        settings = EngineSettings(chunk=config.chunk if engine == config.engine else None)
        found = evaluate(
            robot, simulations[:count], controllers[:count], pairwise=True, engine=engine, settings=settings
        )
        return found.fitness, time.perf_counter() - start

    fitness, first = run(config.engine, config.pairs)
    seconds = min(run(config.engine, config.pairs)[1] for _ in range(config.rounds))
    reference = run("native", 64)[0]
    steps = round(config.duration / 0.0005)
    print(
        json.dumps(
            {
                "engine": config.engine,
                "device": jax.devices()[0].device_kind if config.engine != "native" else f"{available_cores()} cores",
                "pairs": config.pairs,
                "chunk": config.chunk,
                "steps": steps,
                "steps_per_s": round(config.pairs * steps / seconds),
                "first_call_s": round(first, 1),
                "seconds": round(seconds, 3),
                "difference_median": float(np.median(np.abs(fitness[:64] - reference))),
            }
        ),
        flush=True,
    )


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
