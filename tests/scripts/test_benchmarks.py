"""Benchmarks at tiny sizes write the numbers that they print."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import jax
import pytest
from small_robots import hopper

FOLDER = Path(__file__).parents[2] / "benchmarks"


def load(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A benchmark as a module, with a small robot."""
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "hexapod", hopper)
    return module


@pytest.mark.slow
def test_scaling(tmp_path: Path) -> None:
    path = tmp_path / "numbers.json"
    flags = ("--max-pairs=100", "--steps=5", "--rounds=1", "--devices", "1", "--json", path)
    subprocess.run([sys.executable, FOLDER / "scaling.py", *flags], check=True, capture_output=True)
    numbers = json.loads(path.read_text())
    assert [(row["devices"], row["pairs"]) for row in numbers["rows"]] == [(1, 64), (1, 100)]
    assert all(row["s_per_pair"] > 0 and row["steps_per_s"] > 0 for row in numbers["rows"])
    assert numbers["unevenness"] == {"1": None}
    assert 0.1 < numbers["peak_memory_gib"] < 1.5
    assert numbers["small"]


def test_unevenness(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [{"pairs": n, "s_per_pair": cost} for n, cost in ((64, 9.0), (1024, 2.0), (4096, 1.8), (10_000, 2.1))]
    assert load("scaling", monkeypatch).unevenness(rows) == pytest.approx(0.1)


def test_accuracy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = load("accuracy", monkeypatch)

    def here(config: object, precision: str) -> dict:
        with jax.enable_x64(precision == "float64"):
            return (module.double if precision == "float64" else module.single)(config)

    monkeypatch.setattr(module, "in_own_process", here)
    path = tmp_path / "numbers.json"
    module.main(module.Config(steps=20, double_pairs=4, single_pairs=12, json=path))
    numbers = json.loads(path.read_text())
    wide, narrow = numbers["float64"], numbers["float32"]
    assert wide["steps"] == narrow["steps"] == [1, 10, 20]
    assert wide["fine"]
    assert max(wide["qpos_error"]) < 1e-12
    assert narrow["fine"]
    assert narrow["diverged"] == 0
    assert max(narrow["position_error_p90"]) < 1e-4


def test_window_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    module = load("window_lanes", monkeypatch)
    with jax.enable_x64(True):
        numbers = module.measure(module.Config(rows=16, chunk=8, steps=(1, 5), warm_up=50, rounds=1))
        with pytest.raises(ValueError, match="multiple of the chunk, 7"):
            module.measure(module.Config(rows=16, chunk=7))
    assert [row["steps"] for row in numbers["windows"]] == [1, 5]
    assert all(row["apart"] < 1e-9 for row in numbers["windows"])
    assert all(row["ratio"] > 0 for row in numbers["windows"])
    assert numbers["compile_s"] > 0
