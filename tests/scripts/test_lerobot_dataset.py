"""The benchmark that writes public recordings of an SO-101 as LeRobot datasets."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, open_dataset

FOLDER = Path(__file__).parents[2] / "benchmarks"
NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def model() -> str:
    """A chain of six joints with servos, named like those of the SO-101."""
    bodies = "".join(
        f'<body pos="0 0 0.1"><joint name="{name}" axis="{i % 2} {1 - i % 2} 0" range="-1.9 1.9"/>'
        '<geom size="0.02" mass="0.1" contype="0" conaffinity="0"/>'
        for i, name in enumerate(NAMES)
    )
    servos = "".join(f'<position name="{name}" joint="{name}" kp="10" kv="1"/>' for name in NAMES)
    end = f"{'</body>' * len(NAMES)}</worldbody><actuator>{servos}</actuator></mujoco>"
    return f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}{end}'


def line(time: float, values: np.ndarray) -> str:
    return f'X,{1e6 * time},"{[round(float(v), 4) for v in values]}"'


def motion(seed: int) -> np.ndarray:
    """Positions (100, 6): five angles [rad] and a share."""
    rng, time = np.random.default_rng(seed), np.arange(100) / 50
    angles = rng.uniform(0.3, 1.0, 5) * np.sin(time[:, None] * rng.uniform(2, 6, 5))
    angles = np.round(angles / (2 * np.pi / 4096)) * 2 * np.pi / 4096
    return np.hstack([angles, 0.5 + 0.3 * np.sin(time[:, None])])


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER / "decathlon"))
    monkeypatch.syspath_prepend(str(FOLDER))
    import lerobot_dataset

    return lerobot_dataset


@pytest.mark.parametrize("version", ["v3.0", "v2.1"])
def test_what_is_written_is_read(script: Any, tmp_path: Path, version: str) -> None:
    def text(repository: str, revision: str, path: str) -> str:
        rows = motion(ord(path.split("/")[-2][0]))
        return "\n".join(["type,timestamp,positions", *(line(0.02 * k, row) for k, row in enumerate(rows))])

    copies = SimpleNamespace(names=lambda *_: ["a", "b", "c", "d", "e"], text=text)
    script.write(script.motions(copies, 2), tmp_path / "recordings", version)
    (tmp_path / "arm.xml").write_text(model())
    found = open_dataset(tmp_path / "arm.xml", logs=[tmp_path / "recordings"])
    assert isinstance(found, Dataset)
    assert len(found.recordings) == 3
    for recording, seed in zip(found.recordings, "ace", strict=True):
        np.testing.assert_allclose(recording.qpos[:, :5], motion(ord(seed))[:, :5], atol=1e-3)
    info = json.loads((tmp_path / "recordings" / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["total_frames"], info["fps"]) == (version, 300, 50)
    files = sorted(path.name for path in (tmp_path / "recordings" / "data").rglob("*.parquet"))
    assert files == (["file-000.parquet"] if version == "v3.0" else [f"episode_00000{i}.parquet" for i in range(3)])
