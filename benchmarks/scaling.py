"""Cost per pair and memory from 64 to 100,000 pairs: `uv run python benchmarks/scaling.py`.

Every 64 pairs share a morphology, as in a block of a scan; the measured cost is the whole cost of a pair: its share of
preparing the model, simulating it, computing its fitness. The number of JAX devices is fixed when JAX starts, so that
each number of devices has a process of its own. It runs the sizes in ascending order, several times; the peak memory
after a size in the first pass is the memory that this size needs. Compilation is not timed. All steps cost the same, so
that short trials show the same curve, with a larger share of preparation.
"""

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from btr_mjx.evaluation import evaluate
from btr_mjx.models import base_model, compile_models
from btr_mjx.robots import hexapod
from btr_mjx.runs import available_cores

SIZES = (64, 256, 1024, 4096, 16_384, 100_000)
"""Numbers of pairs."""
FLAT_FROM = 1024
"""Number of pairs from which on the cost per pair should be constant."""
FLAT_WITHIN = 0.15
"""Aim for the largest relative difference of the cost per pair."""
SHARED = 64
"""Pairs of a morphology."""
MEMORY_GIB = 1.5
"""Aim for the peak memory [GiB]."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    max_pairs: int = SIZES[-1]
    """Largest number of pairs; the sizes below it are those of the full benchmark."""
    steps: int = 340
    """Steps per pair."""
    rounds: int = 2
    """Passes over the sizes; the cost of a size is the median of its passes."""
    devices: tuple[int, ...] = (1, 2)
    """Numbers of JAX devices, one process each."""
    json: Path | None = None
    """Also write the numbers to this file."""
    measure: bool = False
    """Internal: measure one number of devices in this process and print JSON."""


def measure(config: Config) -> dict[str, Any]:
    """Time all sizes in this process.

    Args:
      config: settings with one number of devices.

    Returns:
      rows: pairs, seconds per pair, steps per second, peak memory of the process so far [GiB]; prepare_s_per_pair:
      seconds that preparing one model takes.
    """
    (devices,) = config.devices
    jax.config.update("jax_num_cpu_devices", devices)
    robot = replace(hexapod(), duration=config.steps * float(base_model(hexapod()).opt.timestep))
    rng = np.random.default_rng(0)
    sizes = [size for size in SIZES if size < config.max_pairs] + [config.max_pairs]
    simulations = robot.simulation_box.sample(rng, -(-config.max_pairs // SHARED)).repeat(SHARED, axis=0)
    controllers = robot.controller_box.sample(rng, config.max_pairs)
    evaluate(robot, simulations[:1], controllers[:1], pairwise=True, engine="lanes")  # compiles
    seconds: dict[int, list[float]] = {size: [] for size in sizes}
    peak: dict[int, float] = {}
    for _ in range(config.rounds):
        for size in sizes:
            repeats = max(1, FLAT_FROM // size)
            start = time.perf_counter()
            for _ in range(repeats):
                evaluate(robot, simulations[:size], controllers[:size], pairwise=True, engine="lanes")
            seconds[size].append((time.perf_counter() - start) / repeats / size)
            peak.setdefault(size, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
    start = time.perf_counter()
    some = min(config.max_pairs, 2048)
    compile_models(robot, robot.simulation_box.sample(rng, some))
    prepare = (time.perf_counter() - start) / some
    rows = [
        {
            "devices": devices,
            "pairs": size,
            "s_per_pair": float(np.median(seconds[size])),
            "steps_per_s": config.steps / float(np.median(seconds[size])),
            "peak_memory_gib": peak[size],
        }
        for size in sizes
    ]
    return {"rows": rows, "prepare_s_per_pair": prepare}


def in_own_process(config: Config, devices: int) -> dict[str, Any]:
    """`measure` with a number of devices, in a new process."""
    flags = [f"--max-pairs={config.max_pairs}", f"--steps={config.steps}", f"--rounds={config.rounds}"]
    environment = {
        key: value for key, value in os.environ.items() if key != "XLA_FLAGS"
    }  # it could set another number of devices
    output = subprocess.run(
        [sys.executable, __file__, "--measure", *flags, "--devices", str(devices)],
        stdout=subprocess.PIPE,
        env=environment,
        check=True,
        text=True,
    ).stdout
    return json.loads(output.splitlines()[-1])


def unevenness(rows: list[dict[str, Any]]) -> float | None:
    """Largest relative difference of the cost per pair from that of 1,024 pairs; None without larger sizes."""
    costs = [row["s_per_pair"] for row in rows if row["pairs"] >= FLAT_FROM]
    return max(abs(cost / costs[0] - 1) for cost in costs) if len(costs) > 1 else None


def main(config: Config) -> None:
    """Run all processes and print the table."""
    if config.measure:
        print(json.dumps(measure(config)))
        return
    found = {devices: in_own_process(config, devices) for devices in config.devices}
    rows = [row for result in found.values() for row in result["rows"]]
    print(f"{available_cores()} cores, {config.steps} steps, {SHARED} pairs per morphology")
    print(f"{'devices':>8}{'pairs':>9}{'us per pair':>13}{'steps/s':>12}{'peak GiB':>10}")
    for row in rows:
        print(
            f"{row['devices']:8}{row['pairs']:9,}{1e6 * row['s_per_pair']:13.1f}{row['steps_per_s']:12,.0f}"
            f"{row['peak_memory_gib']:10.2f}"
        )
    uneven = {str(devices): unevenness(result["rows"]) for devices, result in found.items()}
    peak = max(row["peak_memory_gib"] for row in rows)
    prepare = min(result["prepare_s_per_pair"] for result in found.values())
    for devices, value in uneven.items():
        if value is not None:
            print(
                f"{devices} device(s): cost per pair from {FLAT_FROM:,} pairs on within {value:.1%} of that at "
                f"{FLAT_FROM:,} (aim: {FLAT_WITHIN:.0%})"
            )
    print(f"preparing a model {1e6 * prepare:.1f} us; peak memory {peak:.2f} GiB (aim: below {MEMORY_GIB} GiB)")
    if config.json is not None:
        numbers = {
            "steps": config.steps,
            "rows": rows,
            "unevenness": uneven,
            "flat": all(value <= FLAT_WITHIN for value in uneven.values() if value is not None),
            "peak_memory_gib": peak,
            "small": peak < MEMORY_GIB,
            "prepare_s_per_pair": prepare,
        }
        config.json.write_text(json.dumps(numbers, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
