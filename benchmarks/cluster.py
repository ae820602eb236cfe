"""Local workers against one, the rate of tasks, and memory of large scans: `uv run python benchmarks/cluster.py`.

Speed: every worker owns one core. One and two workers evaluate tables of equal size in turn, so that other load on the
machine affects both; the ratio is the median over the rounds. Then tasks that do nothing, for the rate at which client
and scheduler handle tasks, on the same two cores. Files: time to write a block and to read it again. Memory: peak of
the command `btr_mjx.scan` with 10^4 and 10^6 pairs of ten steps, each in a process of its own.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from btr_mjx.cluster import BlockSettings, connect, evaluate_blocks, map_cases
from btr_mjx.cluster.blocks import read_block, write_block
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.models import base_model
from btr_mjx.robots import Robot, hexapod
from btr_mjx.runs import available_cores, describe_environment, write_json

AIM = 1.7
"""Aim for the speed of two workers in units of that of one."""
TASKS = 2000
"""Tasks that do nothing."""
GRIDS = (100, 1000)
"""Simulations, and as many controllers, of the scans whose memory is measured."""
SCAN = ("--behaviours=random", "--duration=0.005", "--no-figures", "--no-progress")


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    pairs: int = 16_384
    """Pairs of a table."""
    block: int = 1024
    """Pairs per block."""
    steps: int = 340
    """Steps per pair."""
    rounds: int = 5
    """Rounds; one worker and two workers run once a round."""
    speed: bool = True
    """Measure the speed and the rate of tasks."""
    files: bool = True
    """Measure the files of blocks."""
    memory: bool = True
    """Measure the memory."""
    json: Path | None = None
    """Also write the numbers to this file."""


@contextmanager
def workers_on(cores: list[int]) -> Iterator[Any]:
    """A client of a local cluster with one worker on each of these cores; this process keeps all of its own."""
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)  # workers divide the cores that they inherit
    with connect(f"local:{len(cores)}") as client:
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), own)
        yield client


def speed(config: Config) -> dict[str, Any]:
    """Pairs per second of one and of two workers, by round, and the median of the ratios."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        raise InputError("two workers need two cores, this process may use one; use --no-speed")
    robot = replace(hexapod(), duration=config.steps * float(base_model(hexapod()).opt.timestep))
    rates: dict[str, list[float]] = {"one": [], "two": []}
    with workers_on(cores[:1]) as one, workers_on(cores) as two:
        clients = {"one": one, "two": two}
        for client in clients.values():
            seconds(robot, 4 * config.block, config.block, client, 0)  # compiles on every worker
        for number in range(1, config.rounds + 1):
            for name, client in clients.items():
                took = seconds(robot, config.pairs, config.block, client, number)
                rates[name].append(config.pairs / took)
        begun = time.perf_counter()
        empty = TASKS / (sum(1 for _ in map_cases(abs, range(TASKS), two)) and time.perf_counter() - begun)
    ratios = np.array(rates["two"]) / np.array(rates["one"])
    return {
        "pairs_per_s": rates,
        "ratios": ratios.tolist(),
        "ratio": float(np.median(ratios)),
        "tasks_per_s": empty,
        "steps": config.steps,
    }


def seconds(robot: Robot, pairs: int, block: int, client: Any, seed: int) -> float:
    """Time in which a cluster evaluates about as many pairs [s]."""
    rng, side = np.random.default_rng(seed), round(pairs**0.5)
    simulations, controllers = robot.simulation_box.sample(rng, side), robot.controller_box.sample(rng, pairs // side)
    begun = time.perf_counter()
    evaluate_blocks(robot, simulations, controllers, engine="lanes", blocks=BlockSettings(size=block, cluster=client))
    return time.perf_counter() - begun


def block_file(side: int, repeats: int = 20) -> dict[str, float]:
    """Size [bytes] of the file of side x side pairs, and median times of writing and reading it [s]."""
    arrays: dict[str, np.ndarray] = {
        "fitness": np.zeros((side, side)),
        "diverged": np.zeros((side, side), bool),
        "solver_capped": np.zeros((side, side), np.int32),
    }
    times = []
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        for name in (f"{i:064d}" for i in range(repeats)):
            begun = time.perf_counter()
            write_block(Path(folder), name, arrays)
            written = time.perf_counter()
            read_block(Path(folder), name)
            times.append((written - begun, time.perf_counter() - written))
        size = (Path(folder) / f"{name}.npz").stat().st_size
    write, read = np.median(times, axis=0)
    return {"bytes": size, "write_s": float(write), "read_s": float(read)}


def memory() -> dict[str, float]:
    """Peak memory of scans by their number of pairs [MiB]."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for grid in GRIDS:
            flags = [f"--grid={grid}", f"--trials={grid}", f"--out={folder}/{grid}", *SCAN]
            process = subprocess.Popen([sys.executable, "-m", "btr_mjx.scan", *flags], stdout=subprocess.DEVNULL)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                raise InputError(f"the scan of {grid} x {grid} pairs failed")
            found[f"{grid**2:.0e}"] = usage.ru_maxrss / 2**10
    return found


def main(config: Config) -> None:
    """Measure and print."""
    environment = describe_environment()
    numbers: dict[str, Any] = {"environment": environment, "load": os.getloadavg()}
    print(f"{environment['processor']}, {available_cores()} cores, load {os.getloadavg()[0]:.1f} at the start")
    with cli_errors():
        if config.speed:
            numbers["speed"] = found = speed(config)
            for name, rates in found["pairs_per_s"].items():
                print(f"{name} worker(s) of one core: {np.median(rates):,.0f} pairs/s of {config.steps} steps")
            low, high = min(found["ratios"]), max(found["ratios"])
            print(f"{found['tasks_per_s']:,.0f} empty tasks per second")
            print(f"two are {found['ratio']:.2f} times as fast ({low:.2f} to {high:.2f} by round; aim {AIM})")
        if config.files:
            numbers["files"] = {str(side**2): block_file(side) for side in (64, 256)}
            for pairs, one in numbers["files"].items():
                print(
                    f"file of a block of {pairs} pairs: {one['bytes'] / 2**10:,.0f} KiB, "
                    f"written in {1e3 * one['write_s']:.1f} ms, read in {1e3 * one['read_s']:.1f} ms"
                )
        if config.memory:
            numbers["peak_memory_mib"] = memory()
            for pairs, peak in numbers["peak_memory_mib"].items():
                print(f"scan of {pairs} pairs: peak memory {peak:,.0f} MiB")
        if config.json is not None:
            write_json(config.json, numbers)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
