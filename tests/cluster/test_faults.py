"""Workers that are killed, hang and join late; a scheduler that is lost; scans that are killed and resumed."""

import hashlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from small_robots import hopper

from btr_mjx.cluster import BlockSettings, connect, evaluate_blocks, iterate_blocks, map_cases
from btr_mjx.errors import InputError
from btr_mjx.evaluation import evaluate, fitness_function
from btr_mjx.runs import read_arrays

pytestmark = pytest.mark.slow

FITNESS = """
import hashlib, os, time

import numpy as np

def slow(outcome):
    '''Logs each block that is computed; a block takes at least 0.3 s.'''
    values = np.linalg.norm(outcome.position[..., -1, :2] - outcome.start[..., :2], axis=-1)
    digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
    with open({log!r} + "/" + str(os.getpid()), "a") as file:
        file.write(f"{{time.time()}} {{digest}}\\n")
    time.sleep(0.3)
    return values
"""


def logging_fitness(folder: Path) -> str:
    """Name of a fitness function that logs in folder/log when it computes which block."""
    (folder / "log").mkdir()
    (folder / "slow_fitness.py").write_text(FITNESS.format(log=str(folder / "log")))
    return f"{folder / 'slow_fitness.py'}:slow"


def computations(folder: Path) -> list[tuple[float, str]]:
    """Time and digest of the values of every computation of a block."""
    lines = [line.split() for path in (folder / "log").iterdir() for line in path.read_text().splitlines()]
    return [(float(when), digest) for when, digest in lines]


class Daemons:
    """A scheduler and its workers, processes of their own."""

    def __init__(self, folder: Path) -> None:
        self.file, self.folder = folder / "scheduler.json", folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self.start("dask_scheduler", "--port=0", f"--scheduler-file={self.file}")

    def start(self, module: str, *flags: str) -> subprocess.Popen[bytes]:
        output = (self.folder / f"{module}-{len(self.processes)}.log").open("wb")
        flags = (*flags, "--dashboard-address=127.0.0.1:0", "--host=127.0.0.1")
        command = [sys.executable, "-m", f"distributed.cli.{module}", *flags]
        self.processes.append(subprocess.Popen(command, stdout=output, stderr=output, cwd=self.folder))
        return self.processes[-1]

    def worker(self, threads: int = 1) -> subprocess.Popen[bytes]:
        return self.start("dask_worker", f"--scheduler-file={self.file}", f"--nthreads={threads}", "--no-nanny")


@contextmanager
def daemons(folder: Path) -> Iterator[Daemons]:
    running = Daemons(folder)
    try:
        yield running
    finally:
        for process in running.processes:
            process.kill()
            process.wait()


def test_workers_killed_hung_and_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three workers: one is killed, one joins late, one is stopped. Bit-identical; nothing stored is computed again."""
    robot, rng = hopper(), np.random.default_rng(5)
    s, c = robot.simulation_box.sample(rng, 30), robot.controller_box.sample(rng, 8)
    fitness = fitness_function(logging_fitness(tmp_path))
    folder = tmp_path / "blocks"
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL", "20s")  # of the daemons
    with daemons(tmp_path) as cluster:
        killed, hung, _ = (cluster.worker() for _ in range(3))
        with connect(f"file:{cluster.file}") as client:
            client.wait_for_workers(3, timeout=120)
            client.run(exec, "import btr_mjx.evaluation.evaluation")  # not to be counted as a block's time
            blocks = BlockSettings(folder, 12, client)
            for number, block in enumerate(
                iterate_blocks(robot, s, c, engine="native", fitness=fitness, blocks=blocks), 1
            ):
                assert (folder / f"{block.name}.npz").is_file()
                if number == 3:
                    killed.kill()
                    cluster.worker()
                if number == 6:
                    hung.send_signal(signal.SIGSTOP)
    names = sorted(folder.iterdir())
    assert number == len(names) == 20
    log, stored = computations(tmp_path), {}
    for path in names:
        values = np.ascontiguousarray(read_arrays(path)["fitness"])
        stored[hashlib.sha256(values.tobytes()).hexdigest()] = path.stat().st_mtime
    assert {digest for _, digest in log} == set(stored)
    assert all(when <= stored[digest] for when, digest in log)
    # What the killed and the stopped worker had in hand, or had not been asked for yet, is computed twice.
    assert 20 <= len(log) <= 30
    whole = evaluate(robot, s, c, engine="native", fitness=fitness)
    table = evaluate_blocks(
        robot, s, c, engine="native", fitness=fitness, blocks=BlockSettings(folder, 12, "tcp://127.0.0.1:9")
    )  # everything is there: the cluster is not asked
    np.testing.assert_array_equal(table.fitness, whole.fitness)
    alone = tmp_path / "alone"
    evaluate_blocks(robot, s, c, engine="native", fitness=fitness, blocks=BlockSettings(alone, 12))
    assert [(p.name, p.read_bytes()) for p in sorted(alone.iterdir())] == [(p.name, p.read_bytes()) for p in names]


def test_lost_scheduler_is_one_line_and_the_rest_goes_on(tmp_path: Path) -> None:
    robot, rng = hopper(), np.random.default_rng(6)
    s, c = robot.simulation_box.sample(rng, 12), robot.controller_box.sample(rng, 4)
    fitness, folder = fitness_function(logging_fitness(tmp_path)), tmp_path / "blocks"
    with daemons(tmp_path) as cluster:
        cluster.worker()
        running = iterate_blocks(
            robot, s, c, engine="native", fitness=fitness, blocks=BlockSettings(folder, 4, f"file:{cluster.file}")
        )
        next(running)
        cluster.scheduler.kill()
        with pytest.raises(InputError, match="scheduler was lost"):
            list(running)
    kept = len(list(folder.iterdir()))
    assert 1 <= kept < 12
    before = len(computations(tmp_path))
    evaluate_blocks(robot, s, c, engine="native", fitness=fitness, blocks=BlockSettings(folder, 4))
    assert len(computations(tmp_path)) - before == 12 - kept


def test_worker_with_several_threads_is_refused(tmp_path: Path) -> None:
    with daemons(tmp_path) as cluster:
        cluster.worker(threads=2)
        with pytest.raises(InputError, match="runs 2 tasks at a time"):
            list(map_cases(abs, [-1, -2], f"file:{cluster.file}"))


def test_local_workers_agree_bit_for_bit() -> None:
    """On lanes, whose programs are compiled for as many devices as a process has cores."""
    robot, rng = hopper(), np.random.default_rng(7)
    s, c = robot.simulation_box.sample(rng, 40), robot.controller_box.sample(rng, 30)
    alone = evaluate(robot, s, c, engine="lanes")

    def bad_case(case: int) -> int:
        raise InputError(f"case {case}: expected another")

    with connect("local:2") as client:
        cores = list(client.run(os.sched_getaffinity, 0).values())
        table = evaluate_blocks(robot, s, c, engine="lanes", blocks=BlockSettings(None, 200, client))
        assert dict(map_cases(abs, [-1, 2, -3, 2], client)) == {-1: 1, 2: 2, -3: 3}
        with pytest.raises(InputError, match="case 4: expected another"):
            list(map_cases(bad_case, [4], client))
        lock = threading.Lock()
        with pytest.raises(InputError, match="cannot be sent to a worker"):
            list(map_cases(lambda case: lock, [4], client))
    if len(os.sched_getaffinity(0)) > 1:
        assert not cores[0] & cores[1]
    np.testing.assert_array_equal(table.fitness, alone.fitness)
    np.testing.assert_array_equal(table.solver_capped, alone.solver_capped)


SCAN = ("--engine=native", "--duration=0.03", "--grid=20", "--trials=6", "--behaviours=random", "--block=12")


def test_killed_scans_resume_to_identical_files(tmp_path: Path) -> None:
    """kill -9 at random moments, once between start and end of every block on average."""
    fitness = logging_fitness(tmp_path)
    command = [sys.executable, "-m", "btr_mjx.scan", *SCAN, f"--fitness={fitness}", "--out=run", "--no-progress"]

    def scan(name: str, *flags: str) -> subprocess.Popen[bytes]:
        (tmp_path / name).mkdir(exist_ok=True)
        return subprocess.Popen([*command, *flags], cwd=tmp_path / name, stdout=subprocess.DEVNULL)

    assert scan("whole").wait() == 0
    wait, kills = random.Random(8), 0
    blocks = tmp_path / "killed" / "run" / "blocks"
    process = scan("killed")
    for target in (1, 4, 7):
        while process.poll() is None and len(list(blocks.glob("*.npz")) if blocks.is_dir() else []) < target:
            time.sleep(0.01)
        time.sleep(wait.uniform(0, 0.4))
        process.kill()
        process.wait()
        kills += 1
        process = scan("killed", "--resume")
    assert process.wait() == 0
    assert kills == 3
    found = [
        {str(p.relative_to(tmp_path / name)): p.read_bytes() for p in (tmp_path / name).rglob("*") if p.is_file()}
        for name in ("whole", "killed")
    ]
    for files in found:
        for told_of_time in ("environment.json", "report.html"):
            del files[f"run/{told_of_time}"]
        del files["run/.lock"]
    assert found[0].keys() == found[1].keys()
    assert found[0] == found[1]
