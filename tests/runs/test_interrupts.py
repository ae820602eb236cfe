import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from btr_mjx.errors import Interrupted
from btr_mjx.runs import RunFolder
from btr_mjx.runs import progress_bar as progress
from btr_mjx.runs.config_json import read_config

ROOT = Path(__file__).parents[2]

WORKER = """
import sys, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from btr_mjx.errors import cli_errors
from btr_mjx.runs import RunFolder, graceful_interrupt, write_json

@dataclass(frozen=True)
class Config:
    seed: int = 0
    steps: int = 80

@cli_errors(resume="again")
def work(folder, resume, config=Config(), pause=0.2):
    with RunFolder.create(folder, config, resume=resume) as run, graceful_interrupt() as stop:
        checkpoint = run.load_latest()
        history = run.history("history.csv", checkpoint)
        if checkpoint is None:
            rng, state, first = np.random.default_rng(config.seed), np.zeros(2000), 0
        else:
            rng, state = np.random.default_rng(), checkpoint.arrays["state"]
            rng.bit_generator.state = checkpoint.meta["rng"]
            first = checkpoint.step + 1
        print(f"first {first}\\n", end="", flush=True)
        for step in range(first, config.steps):
            state = np.sin(state + rng.standard_normal(2000))
            history.append({"step": step, "mean": float(state.mean()), "bad": np.nan if step % 3 else None})
            run.save_checkpoint(step, {"state": state}, {"rng": rng.bit_generator.state})
            stop.checkpoint()
            time.sleep(pause)
        write_json(run.path / "result.json", {"mean": state.mean(), "draw": rng.random(), "rows": len(history)})

if __name__ == "__main__":
    work(sys.argv[2], sys.argv[1] == "resume")
"""

KILLS = """
import os, signal, sys
from pathlib import Path
from worker import Config, work
from btr_mjx.runs.checkpoints import list_checkpoints

def fork(folder, resume, kill_at=None):
    # A fresh process without the second that imports take, killed before its n-th change of the file system.
    pid = os.fork()
    if pid == 0:
        count = 0
        def counted(call):
            def counting(*arguments, **options):
                nonlocal count
                count += 1
                if count == kill_at:
                    os.kill(os.getpid(), signal.SIGKILL)
                return call(*arguments, **options)
            return counting
        os.fsync = counted(lambda descriptor: None)  # slow, and against power cuts, not kills
        for name in ("replace", "unlink", "mkdir"):
            setattr(os, name, counted(getattr(os, name)))
        code = 1
        try:
            work(folder, resume, Config(steps=4), pause=0)
            code = 0
        finally:
            os._exit(code)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    assert status in (0, -signal.SIGKILL), status
    return status == 0

root = Path(sys.argv[1])
assert fork(root / "whole", False)
kills = 0
while not fork(folder := root / f"killed-{kills}", False, kills + 1):
    kills += 1
    found = list_checkpoints(folder) if folder.exists() else []
    if kills % 3 == 0 and len(found) > 1:  # a disk that loses the end of the newest file
        found[-1][1].write_bytes(found[-1][1].read_bytes()[:200])
    assert fork(folder, folder.exists())
print(kills)
"""


@pytest.fixture(scope="module")
def worker(tmp_path_factory):
    script = tmp_path_factory.mktemp("worker") / "worker.py"
    script.write_text(WORKER)
    script.with_name("kills.py").write_text(KILLS)
    # Without git, whose three calls would take most of the time and of the kills
    settings = {"PYTHONPATH": str(ROOT), "PATH": "", "POLARS_MAX_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def start(*arguments, file="worker.py"):
        command = [sys.executable, str(script.with_name(file)), *map(str, arguments)]
        return subprocess.Popen(
            command,
            env=os.environ | settings,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=script.parent,
        )

    return start


def outcome(folder):
    """All files that two equal runs have in common."""
    names = [path.name for path in folder.iterdir() if path.name not in (".lock", "environment.json")]
    return {name: (folder / name).read_bytes() for name in sorted(names)}


def test_runs_that_are_killed_at_any_moment_resume_to_the_same_bytes(worker, tmp_path):
    output, problems = worker(tmp_path, file="kills.py").communicate(timeout=300)
    kills = int(output.splitlines()[-1]) if output else 0
    assert kills >= 40, problems
    assert problems.count("trying the checkpoint before it") >= 3
    assert "Traceback" not in problems
    expected = outcome(tmp_path / "whole")
    assert list(expected) == [
        "checkpoint-000002.npz",
        "checkpoint-000003.npz",
        "config.json",
        "history.csv",
        "result.json",
    ]
    for kill in range(kills):
        assert outcome(tmp_path / f"killed-{kill}") == expected, f"killed before change {kill + 1}"


@dataclass(frozen=True)
class WorkerConfig:
    seed: int = 0
    steps: int = 0


def test_the_first_signal_stops_at_a_safe_point_and_the_lock_keeps_others_out(worker, tmp_path):
    folder = tmp_path / "run"
    process = worker("fresh", folder)
    assert process.stdout.readline() == "first 0\n"
    while not (folder / "checkpoint-000001.npz").exists():
        time.sleep(0.01)
    second = worker("resume", folder)
    _, problems = second.communicate(timeout=60)
    assert second.returncode == 2
    assert problems.startswith(f"error: {folder} is in use by another run (process {process.pid})")
    assert problems.count("\n") == 1
    process.send_signal(signal.SIGTERM)
    _, problems = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "stopping at the next safe point" in problems
    assert problems.endswith("stopped at a safe point (SIGTERM)\nresume with: again\n")
    assert "Traceback" not in problems
    RunFolder.create(folder, read_config(folder, WorkerConfig), resume=True).close()


def test_graceful_interrupt():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with progress.graceful_interrupt() as stop:
        stop.checkpoint()
        assert not stop.requested
        with progress.graceful_interrupt() as inner:
            assert inner is stop
        assert signal.getsignal(signal.SIGINT) == stop._handle
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested
        with pytest.raises(Interrupted, match=r"safe point \(SIGTERM\)") as caught:
            stop.checkpoint()
        assert caught.value.signum == signal.SIGTERM
        with pytest.raises(Interrupted, match=r"at once \(SIGINT\)"):
            signal.raise_signal(signal.SIGINT)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    assert not issubclass(Interrupted, Exception)


def test_anywhere():
    """One signal stops at once what may be stopped anywhere, and no more than that."""
    with progress.graceful_interrupt() as stop:
        with pytest.raises(Interrupted, match=r"at once \(SIGTERM\)"), stop.anywhere():
            signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Interrupted), stop.anywhere():
            pytest.fail("a stop was requested before")
    with progress.graceful_interrupt() as stop:
        with stop.anywhere():
            pass
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested


def test_graceful_interrupt_in_a_thread():
    import threading

    seen = []

    def work():
        with progress.graceful_interrupt() as stop:
            stop.checkpoint()
            seen.append(stop.requested)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]
