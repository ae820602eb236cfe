"""The benchmark of real machines: reading, open-loop errors and rivals, on a pendulum with known numbers."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset

FOLDER = Path(__file__).parents[2] / "benchmarks"
XML = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
<joint name="hinge" axis="0 -1 0"/><inertial pos="0 0 -0.3" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
TRUE = {"dof_frictionloss": 0.15, "dof_damping": 0.08, "dof_armature": 0.03, "gain": 0.8, "offset": 0.1}


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER / "decathlon"))
    monkeypatch.syspath_prepend(str(FOLDER))
    import decathlon
    import machine
    import open_loop
    import page
    import rivals

    return SimpleNamespace(decathlon=decathlon, machine=machine, open_loop=open_loop, page=page, rivals=rivals)


@pytest.fixture
def trial(parts: Any) -> Any:
    """Two motions to fit and one held out, of a pendulum that has the true numbers."""
    model = parts.rivals.with_numbers(mujoco.MjModel.from_xml_string(XML), {k: [v] for k, v in TRUE.items()})
    time = 0.002 * np.arange(2500)
    logs = []
    for i, split in enumerate(("fit", "fit", "test")):
        ctrl = 2.5 * np.sin((2 + i) * time) + 1.5 * np.sin((5.5 + i) * time + i)
        log = parts.machine.Log(f"r{i}", split, time, ctrl[:, None], np.zeros((2500, 1)), np.zeros((2500, 1)))
        qpos, qvel = parts.open_loop.simulated(lambda _: (model, ()), "linear")(log, 0, 2499)
        logs.append(replace(log, qpos=qpos, qvel=qvel))
    return parts.machine.Trial(XML, tuple(logs), "linear")


def rule(**more: Any) -> Any:
    return SimpleNamespace(**{"horizon": None, "skip": 0, "dofs": (), "measure": "rms", "share": 1.0} | more)


def test_the_regression_recovers_known_numbers(parts: Any, trial: Any) -> None:
    found = parts.rivals.regression(trial, with_gain=True)
    for name, value in TRUE.items():
        assert found[name][0] == pytest.approx(value, rel=0.1), name
    model = mujoco.MjModel.from_xml_string(XML)
    errors = [
        parts.open_loop.held_out_error(rule(), trial, model, parts.rivals.predictor(trial, numbers))
        for numbers in ({}, parts.rivals.regression(trial, with_gain=False), found)
    ]
    assert errors[2] < 0.05
    assert errors[2] < 0.3 * errors[1] < errors[0]


def test_no_regression_of_free_joints(parts: Any) -> None:
    xml = '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
    assert parts.rivals.regression(parts.machine.Trial(xml, (), None), False) is None


def test_errors_by_hand(parts: Any, trial: Any) -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    time = 0.1 * np.arange(41)
    log = replace(trial.logs[2], time=time, qpos=time[:, None] ** 2, qvel=2 * time[:, None], ctrl=np.zeros((41, 1)))
    short = replace(trial, logs=(log,))

    def error(**more: Any) -> float:
        return parts.open_loop.held_out_error(rule(**more), short, model, parts.open_loop.steady(model))

    since = 0.1 * np.arange(11)  # constant velocity leaves the square of the time
    assert error(horizon=1.0) == pytest.approx(np.sqrt(np.mean(since**4)))
    assert error(horizon=1.0, measure="mean") == pytest.approx(np.mean(since**2))
    assert error(horizon=1.0, skip=5) == pytest.approx(np.sqrt(np.mean(since[5:] ** 4)))
    assert error() == pytest.approx(np.sqrt(np.mean(time**4)))
    log.qpos[35] = np.nan  # one of four predictions
    assert error(horizon=1.0) == np.inf
    assert error(horizon=1.0, share=0.75) == pytest.approx(np.sqrt(np.mean(since**4)))


def test_a_start_without_velocities(parts: Any, trial: Any) -> None:
    model, log = mujoco.MjModel.from_xml_string(XML), trial.logs[2]
    slope = parts.open_loop.start_velocity(model, replace(log, qvel=None), 700)
    assert slope == pytest.approx(log.qvel[700], abs=0.02)


def test_folders_and_halves(parts: Any, trial: Any, tmp_path: Path) -> None:
    trial = replace(trial, models={"own.xml": XML}, logs=(*trial.logs[:2], replace(trial.logs[2], own_model="own.xml")))
    parts.machine.write_trial(trial, tmp_path)
    read = open_dataset(tmp_path)
    assert [r.split for r in read.recordings] == ["fit", "fit", "test"]
    assert np.array_equal(read.recordings[1].qpos, trial.logs[1].qpos)
    first, second = parts.machine.halves(trial)
    assert [[log.name for log in half.logs] for half in (first, second)] == [["r0", "r2"], ["r1", "r2"]]
    first, second = parts.machine.halves(replace(trial, logs=trial.logs[1:]))
    assert [log.name for log in (*first.logs, *second.logs)] == ["r1_0", "r2", "r1_1", "r2"]
    assert np.array_equal(np.concatenate([first.logs[0].time, second.logs[0].time]), trial.logs[1].time)


def test_copies(parts: Any, tmp_path: Path) -> None:
    clone, bare, plain = (tmp_path / name for name in ("clone", "bare", "plain"))
    (plain / "a").mkdir(parents=True)
    (plain / "a" / "b.txt").write_text("plain")
    git = ["git", "-c", "user.name=n", "-c", "user.email=e", "-C", str(clone)]
    subprocess.run(["git", "init", "-q", clone], check=True)
    (clone / "b.txt").write_text("committed")
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*git, "commit", "-qm", "m"], check=True)
    subprocess.run(["git", "clone", "-q", "--bare", clone, bare], check=True, capture_output=True)
    (clone / "b.txt").write_text("changed")
    copies = parts.machine.Copies(tmp_path)
    assert copies.text("owner/plain", "HEAD", "a/b.txt") == "plain"
    for name in ("clone", "bare"):
        assert copies.text(f"owner/{name}", "HEAD", "b.txt") == "committed"
    with pytest.raises(InputError, match="git clone"):
        copies.place("owner/none")
    with pytest.raises(InputError, match="missing"):
        copies.read("owner/bare", "HEAD", "missing")


def test_agreement_of_halves(parts: Any) -> None:
    def effect(name: str, low: float, high: float) -> dict[str, Any]:
        return {"effect": name, "location": "joint:a", "parameters": {"n": {"low": low, "high": high}}}

    found = parts.decathlon.agreement(
        [effect("damping", 1, 2), effect("friction", 1, 2)],
        [effect("damping", 1.5, 3), effect("friction", 2.5, 3), effect("delay", 0, 1)],
    )
    assert (found["same_names"], found["numbers"], found["overlap"]) == (False, 2, 1)
    assert found["second_only"] == ["delay@joint:a"]


def test_every_machine_says_what_it_is(parts: Any) -> None:
    assert len(parts.decathlon.MACHINES) == 11
    for name, machine in parts.decathlon.MACHINES.items():
        assert all((machine.source, machine.licence, machine.citation, machine.split, machine.figure)), name
        assert len((FOLDER / "decathlon" / f"{name}.py").read_text().splitlines()) <= 80, name
    assert sys.modules["machine"].__file__ == str(FOLDER / "decathlon" / "machine.py")


def test_the_table_of_the_page(parts: Any, tmp_path: Path) -> None:
    place = {"location": "joint:a", "effect": "dry_friction"}
    errors = {"believed": "Infinity", "mended": 0.0123456, "steady": 0.001, "published": None, "known": 0.02}
    row = {"name": "one", "unit": "rad", "horizon": None, "licence": "MIT", "citation": "Somebody", "errors": errors}
    row |= {"refused": "", "effects": [place, place | {"location": "joint:b"}, place | {"effect": "damping"}]}
    page = tmp_path / "page.md"
    page.write_text("before\n\n| machine | old |\n|---|---|\n| two | 1 |\n\nafter\n")
    parts.page.write_page([row], page)
    lines = page.read_text().splitlines()
    assert (lines[0], lines[-1], len(lines)) == ("before", "after", 7)
    cells = "one | rad, whole recordings | diverged | **0.0123** | 0.001 | - | - (0.02)"
    assert lines[4] == f"| {cells} | dry friction (2 places), damping (a) | MIT | Somebody |"
    page.write_text("nothing")
    with pytest.raises(InputError, match="no table"):
        parts.page.write_page([row], page)
