"""Commands that are killed at every kind of moment, and run folders that are damaged: what the tests of faults share.

A command runs in a process that is forked from a server which has imported the package, so that a kill costs no second
of imports. It is killed at the n-th change of the file system: deterministic, and it meets each moment between two
writes. A session of a run is one such process; a run is resumed in sessions until it ends.
"""

import importlib
import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

SEED = 20261126
LIMIT = 300.0
"""Longest duration of a session [s]; a longer one hangs."""

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(
    ["btr_mjx.coevolve", "btr_mjx.diagnose", "btr_mjx.scan", "btr_mjx.plots", "btr_mjx.report", "jax", "polars"]
)


@dataclass(frozen=True)
class Session:
    """How a process of a command ended.

    Attributes:
      code: exit code; -9 for a kill.
      text: what it printed.
      changes: how often it changed the file system.
    """

    code: int
    text: str
    changes: int

    @property
    def killed(self) -> bool:
        """Whether it was killed."""
        return self.code == -signal.SIGKILL

    @property
    def refused(self) -> bool:
        """Whether it ended in one clear line."""
        errors = [line for line in self.text.splitlines() if line.startswith("error: ")]
        return self.code == 2 and len(errors) == 1 and "Traceback" not in self.text


def run_session(module: str, words: Sequence[str], folder: Path, kill_at: int | None = None) -> Session:
    """Run a command in a process and a folder of its own; killed before its `kill_at`-th change of the file system."""
    folder.mkdir(parents=True, exist_ok=True)
    log = Path(tempfile.mkdtemp()) / "session.log"  # not on the disk that is full
    process = _context.Process(target=_work, args=(module, [*map(str, words)], folder, log, kill_at))
    process.start()
    process.join(LIMIT)
    if process.is_alive():
        process.kill()
        raise AssertionError(f"{module} hangs: {log.read_text()}")
    changes = log.with_suffix(".changes")
    return Session(
        process.exitcode or 0,
        log.read_text(errors="replace") if log.is_file() else "",
        int(changes.read_text()) if changes.is_file() else 0,
    )


def _work(module: str, words: list[str], folder: Path, log: Path, kill_at: int | None) -> None:
    os.chdir(folder)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    changes = _count_changes(kill_at)
    code = 0
    try:
        importlib.import_module(module).main(words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    log.with_suffix(".changes").write_text(str(changes()))
    sys.stdout.flush()
    os._exit(code)


def _count_changes(kill_at: int | None) -> Callable[[], int]:
    """Count calls that change the file system or end a write of a file; kill this process before the n-th."""
    count = 0

    def counted(call):
        def counting(*arguments, **options):
            nonlocal count
            count += 1
            if count == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return counting

    os.fsync = counted(lambda descriptor: None)  # against power cuts, not kills, and slow
    for name in ("replace", "unlink", "mkdir", "rmdir"):
        setattr(os, name, counted(getattr(os, name)))
    return lambda: count


def kill_points(changes: int, count: int) -> Iterator[int]:
    """`count` moments of a run with so many changes, spread over all of it, first and last included."""
    rng = random.Random(SEED)
    yield from sorted({1, changes, *rng.sample(range(2, changes), min(count - 2, changes - 2))})


def content(folder: Path) -> dict[str, bytes]:
    """The results of a run: its files without those that tell of the time, and without checkpoints."""
    found = {}
    for path in sorted(folder.iterdir()):
        name = path.name
        if not path.is_file() or path.name in (".lock", "environment.json") or path.match("checkpoint-*"):
            continue
        found[name] = path.read_bytes()
    result = json.loads(found.get("result.json", b"{}"))
    if "seconds" in result:
        del result["seconds"]
        found["result.json"] = json.dumps(result).encode()
        for name in ("SHA256SUMS", "report.html"):
            found.pop(name, None)
    return found


def flips(content: bytes, count: int, rng: random.Random) -> Iterator[bytes]:
    """Copies of a file's bytes with one bit changed each, the first and last byte among them."""
    places = [0, len(content) - 1, *(rng.randrange(len(content)) for _ in range(count - 2))][:count]
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.randrange(8)
        yield bytes(damaged)


def damages(content: bytes, count: int, rng: random.Random) -> Iterator[tuple[str, bytes | None]]:
    """What may happen to a file: (in words, its bytes after it, None where it is gone)."""
    for damaged in flips(content, count, rng) if content else ():
        yield "a flipped bit", damaged
    yield "cut short", content[: len(content) // 2]
    yield "deleted", None


def copied(folder: Path, to: Path) -> Path:
    """A copy of a folder in place of what was there."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(folder, to)
    return to
