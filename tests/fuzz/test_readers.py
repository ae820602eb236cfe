"""Every reader of files on hostile inputs: it ends without an error, or in one line of bad input.

`benchmarks/fuzz.py` runs many thousands of the same inputs in worker processes.
"""

import random
from pathlib import Path

import mujoco
import pytest
from hostile import PARSERS, run_input, write_input
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

QUICK = settings(
    max_examples=40, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
)
"""The same inputs in every run."""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes a log into the folder where it runs."""
    monkeypatch.chdir(tmp_path)
    mujoco.set_mju_user_warning(lambda _: None)


@pytest.mark.parametrize("name", PARSERS)
def test_readers_accept_or_refuse_in_one_line(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    @QUICK
    @given(st.randoms(use_true_random=False))
    def check(source: random.Random) -> None:
        folder = tmp_path_factory.mktemp("input")
        write_input(PARSERS[name].make(source), folder)
        assert run_input(PARSERS[name], folder)

    check()


@pytest.mark.parametrize("name", PARSERS)
def test_seeds_are_valid(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a mutation every reader accepts its input; else the tests above would test nothing."""
    monkeypatch.setattr("hostile.mutations.mutate_bytes", lambda data, source: data)
    monkeypatch.setattr("hostile.mutations.mutate_value", lambda value, source: value)
    monkeypatch.setattr("hostile.mutations.mutate_mjcf", lambda text, source: text)
    monkeypatch.setattr("hostile.mutations.mutate_template", lambda text, source: text)
    for module in ("parsers", "logs"):
        name_of = f"hostile.{module}.bytes_or"
        monkeypatch.setattr(name_of, lambda source, data, structured: data)
    source = random.Random(1)
    monkeypatch.setattr(source, "random", lambda: 0.1)
    write_input(PARSERS[name].make(source), tmp_path / "input")
    assert run_input(PARSERS[name], tmp_path / "input") == "accepted"
