"""A sound dataset of a pendulum, and a search that is a stand-in, for tests of the command of a diagnosis."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from gap_results import FOUND
from hidden_cases import CaseSettings, make_case

from btr_mjx.gap import inference
from btr_mjx.gap.data import Dataset
from btr_mjx.gap.simulate import Journal


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "data"
    make_case(folder, 4, "pendulum", CaseSettings(verdict="none", recordings=(2, 1), duration=0.8))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A sound dataset."""
    return shutil.copytree(made, tmp_path / "data")


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Arguments of each search; its answer is `FOUND`."""
    calls: list[dict[str, Any]] = []

    def stand_in(
        dataset: Dataset,
        effects: Any,
        max_effects: int,
        seed: int,
        progress: Callable[[str], None],
        counter: Journal,
        residual: bool,
    ) -> Any:
        assert not residual
        progress("windows")
        calls.append(
            {"dataset": dataset, "effects": [e.name for e in effects], "max_effects": max_effects, "seed": seed}
        )
        return FOUND

    monkeypatch.setattr(inference, "identify", stand_in)
    return calls
