"""Bits that flip and files that are cut short or deleted: the same result or one clear error, never another result."""

import random
from pathlib import Path

import faults
import pytest
from fault_runs import RUNS, Run


def outcomes(run: Run, start: Path, expected: dict[str, bytes], tmp_path: Path) -> dict[str, int]:
    """Resume a run from copies of a folder in which one file each is damaged; how many ended in which way."""
    rng, counts = random.Random(faults.SEED), {"same": 0, "refused": 0}
    for path in chosen(start / "run", rng):
        name = path.relative_to(start)
        for what, content in faults.damages(path.read_bytes(), 2, rng):
            folder = faults.copied(start, tmp_path / "damaged")
            (folder / name).unlink() if content is None else (folder / name).write_bytes(content)
            session = run.session(folder, resume=True)
            if session.code == 0:
                assert faults.content(folder / "run") == expected, f"{name}: {what}\n{session.text}"
                counts["same"] += 1
            else:
                assert session.refused, f"{name}: {what}\n{session.text}"
                counts["refused"] += 1
    return counts


def chosen(folder: Path, rng: random.Random) -> list[Path]:
    """All files of a run folder itself, and three of each folder in it: results of hundreds of calls are alike."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    found = [path for path in files if path.parent == folder]
    for inner in sorted({path.parent for path in files} - {folder}):
        if inner.name != "measured":  # what people write is theirs to change
            own = [path for path in files if path.parent == inner]
            found += rng.sample(own, min(3, len(own)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("part", [0.4, 1.0])
def test_a_damaged_file_never_changes_the_result(name: str, part: float, tmp_path: Path) -> None:
    run = RUNS[name].prepared(tmp_path)
    whole = run.session(tmp_path / "whole")
    assert whole.code == 0, whole.text
    expected = faults.content(tmp_path / "whole" / "run")
    start = tmp_path / "start"
    if part < 1.0:
        assert run.session(start, kill_at=round(part * whole.changes)).killed
    else:
        faults.copied(tmp_path / "whole", start)
    counts = outcomes(run, start, expected, tmp_path)
    assert counts["same"] > 0
    assert counts["refused"] > 0
