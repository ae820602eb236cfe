import math
import random

import numpy as np
import pytest

from btr_mjx.errors import DamagedFile
from btr_mjx.runs.checkpoints import (
    checkpoint_path,
    list_checkpoints,
    load_latest,
    read_checkpoint,
    save_checkpoint,
)


def save(folder, step, **options):
    state = {"genomes": np.arange(100) % (step + 2) == 0}
    return save_checkpoint(folder, step, state, {"best": math.nan, "step": step}, **options)


def test_checkpoints_keep_the_last_ones(tmp_path):
    assert load_latest(tmp_path) is None
    for step in range(5):
        save(tmp_path, step)
    assert [step for step, _ in list_checkpoints(tmp_path)] == [3, 4]
    latest = load_latest(tmp_path, warn=pytest.fail)
    assert (latest.step, latest.meta["step"], math.isnan(latest.meta["best"])) == (4, 4, True)
    assert latest.arrays["genomes"].dtype == bool
    assert list(latest.arrays) == ["genomes"]
    save(tmp_path, 3)  # the course is taken up again: what lay ahead is void
    assert [step for step, _ in list_checkpoints(tmp_path)] == [3]
    save(tmp_path, 1_234_567)
    assert load_latest(tmp_path).step == 1_234_567


@pytest.mark.parametrize(
    ("step", "arrays", "error"),
    [
        (-1, {}, ValueError),
        (0, {"__meta__": 1}, ValueError),
        (0, {"x": [object()]}, TypeError),
    ],
)
def test_checkpoint_arguments(tmp_path, step, arrays, error):
    with pytest.raises(error):
        save_checkpoint(tmp_path, step, arrays)
    assert list(tmp_path.iterdir()) == []


def test_any_altered_byte_is_noticed(tmp_path):
    save(tmp_path, 7)
    path = save(tmp_path, 8)
    sound = path.read_bytes()
    rng = random.Random(0)
    for position in [*range(40), *range(len(sound) - 90, len(sound)), *rng.sample(range(len(sound)), 100)]:
        data = bytearray(sound)
        data[position] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    for length in [0, 1, 63, 64, 70, 71, 72, *rng.sample(range(len(sound)), 50), len(sound) - 1]:
        path.write_bytes(sound[:length])
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    for data in (sound + b"\0", bytes(len(sound)), sound + sound):
        path.write_bytes(data)
        with pytest.raises(DamagedFile, match="checkpoint-000008"):
            read_checkpoint(path)
    path.write_bytes(sound)
    assert read_checkpoint(path).step == 8


def test_a_damaged_checkpoint_gives_way_to_the_one_before(tmp_path):
    save(tmp_path, 1)
    path = save(tmp_path, 2)
    path.write_bytes(path.read_bytes()[:-100])
    lines: list[str] = []
    assert load_latest(tmp_path, warn=lines.append).step == 1
    assert len(lines) == 1
    assert lines[0].startswith("warning: ")
    assert "checkpoint-000002.npz" in lines[0]
    path.write_bytes(checkpoint_path(tmp_path, 1).read_bytes())
    assert load_latest(tmp_path, warn=lines.append).step == 1
    assert "was renamed, it holds step 1" in lines[-1]
    checkpoint_path(tmp_path, 1).write_bytes(b"")
    with pytest.raises(DamagedFile, match=r"no sound checkpoint.*000002.*000001.*another --out"):
        load_latest(tmp_path, warn=lines.append)


def test_fallback_warns_on_stderr(tmp_path, capfd):
    save(tmp_path, 1)
    save(tmp_path, 2).write_bytes(b"x")
    assert load_latest(tmp_path).step == 1
    assert capfd.readouterr().err.startswith("warning: ")
