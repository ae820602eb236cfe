"""What a command loads before it refuses bad input: modules that take seconds are for work that can be done."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = (
    "jax",
    "matplotlib",
    "scipy.stats",
    "scipy.optimize",
    "scipy.signal",
    "scipy.interpolate",
    "mujoco.mjx",
    "cmaes",
)
"""Modules of which each takes half a second or more to load."""

SCRIPT = """
import contextlib, io, json, sys
import btr_mjx.{command} as module
codes = []
for argv in json.loads(sys.argv[1]):
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            module.main(argv)
            codes.append(0)
        except SystemExit as stop:
            codes.append(stop.code)
print(json.dumps([codes, sorted(sys.modules)]))
"""

ARM = """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
<actuator><position name="m" joint="j"/></actuator></mujoco>"""


def modules_after(command: str, *refused: list[str]) -> set[str]:
    """Modules that a process has loaded after a command has refused each of these arguments."""
    words = [sys.executable, "-c", SCRIPT.format(command=command), json.dumps(refused)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120)
    codes, modules = json.loads(done.stdout.splitlines()[-1])
    assert codes == [2] * len(refused)
    return set(modules)


def dataset(folder: Path, toml: str, csv: str = "") -> str:
    folder.mkdir()
    (folder / "model.xml").write_text(ARM)
    (folder / "dataset.toml").write_text(toml)
    (folder / "a.csv").write_text(csv)
    return str(folder)


def test_diagnose_checks_its_arguments_before_it_loads_mujoco(tmp_path: Path) -> None:
    loaded = modules_after(
        "diagnose", ["--no-such-flag"], ["no_such_folder"], [], [str(tmp_path), "--max-effects", "0"]
    )
    assert loaded.isdisjoint((*HEAVY, "mujoco"))


def test_diagnose_reads_the_data_before_it_loads_a_search(tmp_path: Path) -> None:
    model, row = '[model]\nfile = "model.xml"\n', '[[recording]]\nfile = "a.csv"\n'
    folders = [
        dataset(tmp_path / "toml", "[model\n"),
        dataset(tmp_path / "no_recording", model),
        dataset(tmp_path / "columns", model + row, "time,qpos/k,ctrl/m\n0,0,0\n"),
        dataset(tmp_path / "text", model + row, "time,qpos/j,ctrl/m\n0,zero,0\n"),
        str(tmp_path),
    ]
    loaded = modules_after("diagnose", *([folder] for folder in folders), [folders[0], "--effects", "no_such_effect"])
    assert loaded.isdisjoint((*HEAVY, "btr_mjx.gap.inference"))


@pytest.mark.parametrize(
    ("command", "unknown"), [("coevolve", ["--unknown", "no_such"]), ("scan", ["--parameter", "no_such"])]
)
def test_evolution_checks_its_settings_before_it_loads_jax(command: str, unknown: list[str], tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text("[robot\n")
    refused = [["--no-such-flag"], ["--robot", str(tmp_path / "none.toml")], ["--robot", str(robot)], unknown]
    assert modules_after(command, *refused).isdisjoint(HEAVY)


def test_plots_reads_the_folder_before_it_loads_matplotlib(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{")
    assert modules_after("plots", ["no_such_folder"], [str(tmp_path)], ["--no-such-flag"]).isdisjoint(HEAVY)
