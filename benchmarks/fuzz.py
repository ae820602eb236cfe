"""Feed hostile inputs to a reader of files: `python benchmarks/fuzz.py --parser csv --inputs 20000 --seed 0`.

Inputs are read in worker processes, so that a crash or a hang costs one input. An input has to be accepted or refused
in one line; a traceback, an ended process, or a time above --limit is reported, and the input is kept in --keep. Input
i of a seed is always the same. The exit code is 1 where anything is reported.
"""

import os
import random
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import mujoco
import tyro
from hostile import PARSERS, run_input, write_input
from tqdm import tqdm

BATCH = 200
"""Inputs that share a folder."""


@dataclass(frozen=True)
class FuzzConfig:
    """Settings; every field is a flag."""

    parser: tuple[str, ...] = tuple(PARSERS)
    """Readers to be tried."""
    inputs: int = 20_000
    """Inputs for each."""
    first: int = 0
    """Number of the first input."""
    seed: int = 0
    """Seed of the inputs."""
    limit: float = 30.0
    """Longest time for an input [s]."""
    memory: float = 12.0
    """Largest address space of a worker [GiB]."""
    keep: Path = Path("fuzz-found")
    """Folder of the inputs that are reported."""


def limit_memory(limit: int) -> None:
    """Limit the address space of this process, so that a damaged length costs it and not the machine."""
    import resource

    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard < 0 else min(limit, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def source(parser: str, seed: int, number: int) -> random.Random:
    """The source of random numbers of one input."""
    return random.Random(f"{parser}/{seed}/{number}")


def work(name: str, seed: int, first: int, end: int, memory: float, answers: Connection) -> None:
    """Read inputs first..end-1; sends (number, None) before one is read and (number, outcome) after it."""
    limit_memory(int(memory * 2**30))
    mujoco.set_mju_user_warning(lambda _: None)
    parser = PARSERS[name]
    for start in range(first, end, BATCH):
        numbers = range(start, min(start + BATCH, end))
        with tempfile.TemporaryDirectory() as place:
            folders = [Path(place) / str(number) for number in numbers]
            for number, folder in zip(numbers, folders, strict=True):
                write_input(parser.make(source(name, seed, number)), folder)
            answers.send((start, "ready"))
            os.chdir(place)  # MuJoCo writes a log where it stands
            errors = os.dup(2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            for number, folder in zip(numbers, folders, strict=True):
                answers.send((number, None))
                try:
                    outcome = "accepted" if run_input(parser, folder) == "accepted" else "refused"
                except BaseException:
                    outcome = traceback.format_exc()
                answers.send((number, outcome))
            os.dup2(errors, 2)
            os.chdir("/")
    answers.send((end, ""))


def fuzz(name: str, config: FuzzConfig) -> Counter[str]:
    """Run one reader; returns counts of outcomes."""
    counts: Counter[str] = Counter()
    number, end = config.first, config.first + config.inputs
    context = get_context("spawn")
    with tqdm(total=config.inputs, desc=name, mininterval=5) as bar:
        while number < end:
            answers, other = context.Pipe(duplex=False)
            worker = context.Process(target=work, args=(name, config.seed, number, end, config.memory, other))
            worker.start()
            other.close()
            problem, made, busy = "", False, False
            while not problem and number < end:
                # A worker imports and makes a batch of inputs before it reads the first one.
                if not answers.poll(config.limit if busy else 600):
                    problem = f"hang: more than {config.limit:g} s"
                    break
                try:
                    current, outcome = answers.recv()
                except EOFError:
                    worker.join()
                    if not made:
                        raise SystemExit(f"{name}: the inputs from {number} on could not be made") from None
                    problem = f"crash: exit code {worker.exitcode}"
                    break
                made, busy = made or outcome == "ready", outcome is None
                if outcome in (None, "ready", ""):
                    number = current
                    continue
                number = current + 1
                bar.update()
                kind = outcome if outcome in ("accepted", "refused") else "traceback"
                counts[kind] += 1
                if kind == "traceback":
                    report(name, config, current, outcome)
            worker.kill()
            worker.join()
            if problem:
                counts[problem.split(":")[0]] += 1
                report(name, config, number, problem)
                number += 1
                bar.update()
    return counts


def report(name: str, config: FuzzConfig, number: int, problem: str) -> None:
    """Keep an input and what it did."""
    folder = config.keep / f"{name}-{config.seed}-{number}"
    shutil.rmtree(folder, ignore_errors=True)
    write_input(PARSERS[name].make(source(name, config.seed, number)), folder)
    (folder / "problem.txt").write_text(problem)
    tqdm.write(f"{folder}: {problem.strip().splitlines()[-1][:200]}")


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    config = tyro.cli(FuzzConfig, args=sys.argv[1:] if argv is None else list(argv), description=__doc__)
    failed = False
    for name in config.parser:
        counts = fuzz(name, config)
        failed |= bool(set(counts) - {"accepted", "refused"})
        print(f"{name:12}" + "  ".join(f"{kind} {counts[kind]}" for kind in KINDS), flush=True)
    raise SystemExit(int(failed))


KINDS = ("accepted", "refused", "traceback", "crash", "hang")
"""Outcomes of an input."""

if __name__ == "__main__":
    main()
