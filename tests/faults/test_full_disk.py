"""A disk that is full: one clear line, and a folder from which the run goes on when there is room again."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import faults
import pytest
from fault_runs import RUNS

from btr_mjx.errors import WAITING_CODE

PAGE = 4096


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted here")
    yield folder
    subprocess.run(["umount", folder], check=True)


def fill(disk: Path, free: int) -> Path:
    """Leave only so many bytes free; returns the file that takes up the rest."""
    space = os.statvfs(disk)
    filler = disk / "filler"
    filler.write_bytes(b"\0" * max(space.f_bavail * space.f_frsize - free, 0))
    return filler


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_full_disk_damages_nothing(name: str, tmp_path: Path, disk: Path) -> None:
    run = RUNS[name].prepared(tmp_path)
    whole = run.session(tmp_path / "whole")
    assert whole.code == 0, whole.text
    expected = faults.content(tmp_path / "whole" / "run")
    room = sum(-(-path.stat().st_size // PAGE) for path in (tmp_path / "whole" / "run").rglob("*") if path.is_file())
    refused = 0
    for part in range(8):
        filler = fill(disk, PAGE * (part * room // 8))
        session = run.session(disk / f"part-{part}")
        filler.unlink()
        if session.code:
            assert session.code == WAITING_CODE or session.refused, session.text
            assert session.code == WAITING_CODE or "No space left on device" in session.text
            refused += 1
        resumed = run.session(disk / f"part-{part}", resume=(disk / f"part-{part}" / "run").exists())
        assert resumed.code == 0, resumed.text
        assert faults.content(disk / f"part-{part}" / "run") == expected
        subprocess.run(["rm", "-rf", disk / f"part-{part}"], check=True)
    assert refused >= 7
