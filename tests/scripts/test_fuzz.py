"""The fuzzing command finds what it is for: tracebacks, ended processes and hangs, and keeps their inputs."""

import importlib.util
import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest
from hostile import Parser

from btr_mjx.errors import InputError


def behave(folder: Path) -> None:
    """What the number in an input says."""
    match int((folder / "a.txt").read_bytes()) % 5:
        case 0:
            raise InputError("refused")
        case 1:
            raise KeyError("a bug")
        case 2:
            os._exit(11)
        case 3:
            time.sleep(60)


def test_outcomes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
    spec = importlib.util.spec_from_file_location("benchmark_fuzz", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PARSERS", {"odd": Parser(lambda source: {"a.txt": source}, behave)})
    monkeypatch.setattr(module, "source", lambda name, seed, number: str(number).encode())
    monkeypatch.setattr(module, "limit_memory", lambda limit: None)
    monkeypatch.setattr(module, "get_context", lambda method: multiprocessing.get_context("fork"))
    counts = module.fuzz("odd", module.FuzzConfig(inputs=10, limit=1.0, keep=tmp_path))
    assert counts == {"accepted": 2, "refused": 2, "traceback": 2, "crash": 2, "hang": 2}
    assert {path.name for path in tmp_path.iterdir()} == {f"odd-0-{i}" for i in (1, 2, 3, 6, 7, 8)}
    assert "KeyError" in (tmp_path / "odd-0-6" / "problem.txt").read_text()
    assert (tmp_path / "odd-0-7" / "a.txt").read_bytes() == b"7"
