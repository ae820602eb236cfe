"""The benchmark of real machines: reading, open-loop errors and rivals, on a pendulum with known numbers."""

import importlib
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
from btr_mjx.runs import write_json

FOLDER = Path(__file__).parents[2] / "benchmarks"
XML = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
<joint name="hinge" axis="0 -1 0"/><inertial pos="0 0 -0.3" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
TRUE = {"dof_frictionloss": 0.15, "dof_damping": 0.08, "dof_armature": 0.03, "gain": 0.8, "offset": 0.1}


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER / "decathlon"))
    monkeypatch.syspath_prepend(str(FOLDER))
    modules = ("decathlon", "held_out", "machine", "open_loop", "page", "rivals", "sections", "toolbox")
    return SimpleNamespace(**{name: importlib.import_module(name) for name in modules})


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
    return SimpleNamespace(
        **{"horizon": None, "skip": 0, "dofs": (), "measure": "rms", "share": 1.0, "unit": "rad"} | more
    )


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


def row(**more: Any) -> dict[str, Any]:
    """A row of the benchmark's JSON, of a machine for which nothing was named."""
    texts = dict.fromkeys(("source", "licence", "citation", "split", "figure"), "text")
    said = {"refused": "", "failed": "", "verdict": "unexplained", "effects": [], "sentence": "Something is missing."}
    errors = {"believed": 0.5, "steady": 0.7, "published": None}
    return texts | said | {"name": "one", "unit": "rad", "horizon": None, "cpu_seconds": 9.6, "errors": errors} | more


def empty_page(path: Path) -> None:
    path.write_text(
        "# Title\n\nbefore\n"
        "<!-- table: made by benchmarks/decathlon.py -->\n| machine | old |\n<!-- end of table -->\n"
        "between\n<!-- sections: made by benchmarks/decathlon.py -->\n<!-- end of sections -->\nafter\n"
    )


def test_the_table_of_the_page(parts: Any) -> None:
    place = {"location": "joint:a", "effect": "dry_friction"}
    errors = {"believed": "Infinity", "mended": 0.0123456, "steady": 0.001, "published": None, "known": 0.02}
    effects = [place, place | {"location": "joint:b"}, place | {"effect": "damping"}]
    line = parts.page.table([row(errors=errors | {"toolbox": 0.03}, effects=effects)])[2]
    cells = "[one](#one) | rad, whole recordings | diverged | **0.0123** | 0.001 | - | 0.03 | - (0.02)"
    assert line == f"| {cells} | dry friction (2 places), damping (a) | text | text |"


def test_sections_say_what_was_named_and_what_was_not(parts: Any, tmp_path: Path) -> None:
    def number(value: float, low: float, high: float, unit: str) -> dict[str, Any]:
        return {"value": value, "low": low, "high": high, "unit": unit, "edge": False}

    friction = {"torque[a]": number(2.0, 1.5, 2.5, "N m"), "torque[b]": number(-0.0, -0.0, 0.5, "N m")}
    stribeck = {"torque": number(1.0, 0.5, 1.5, "N m"), "speed": number(3.0, 2.0, 4.0, "rad/s")}
    effects = [
        {"effect": "dry_friction", "location": "each:all", "parameters": friction},
        {"effect": "stribeck_friction", "location": "joint:b", "parameters": stribeck},
        {"effect": "servo_stiffness", "location": "joint:a", "parameters": {"change": number(-0.5, -0.75, -0.25, "1")}},
    ]
    halves = {"same_names": True, "both": ["x"], "first_only": [], "second_only": [], "numbers": 5, "overlap": 4}
    more = {"about": "First.\n\nSecond\nline.\n", "sentence": "It is this. They explain 9 %.", "halves": halves}
    named = parts.sections.section(row(effects=effects, **more), tmp_path)
    text = "\n".join(named)
    assert "| | dry friction [N m] | stribeck friction torque [N m] | stribeck friction speed [rad/s] |" in text
    assert "| a | 2.00 [1.50, 2.50] |  |  | −50 [−75, −25] |" in text
    assert "| b | 0.00 [0.00, 0.50] | 1.00 [0.50, 1.50] | 3.0 [2.0, 4.0] |  |" in text
    assert "\nSecond line.\n" in text
    assert "\nThey explain 9 %.\n" in text
    assert "the same names; 4 of 5 intervals overlap" in text
    assert "images" not in text
    (tmp_path / "one.svg").touch()
    notes = ["r0.parquet: 3 of 9 samples are used", "Predictions of held-out recordings: 1", "velocities lag"]
    shown = {"recording": "r2", "coordinate": "hinge", "start": 1.5}
    toolbox = {"refused": "not run: a free joint"}
    more = {"notes": notes, "unexplained": ["joint a: a force"], "curve": shown, "toolbox": toolbox, "horizon": 0.5}
    text = "\n".join(parts.sections.section(row(**more), tmp_path))
    assert "![Measured and predicted motion of one](images/machines/one.svg)" in text
    assert "Held out: hinge in recording r2, from 1.50 s on." in text
    assert "Something is missing. Joint a: a force." in text
    assert "- *mujoco.sysid*: not run: a free joint." in text
    assert [line for line in text.splitlines() if "noted" in line] == ["- *noted*: Velocities lag."]
    refused = row(refused="the file has no rows") | {"effects": None, "sentence": None}
    assert "gave no result: the file has no rows" in "\n".join(parts.sections.section(refused, tmp_path))


def test_writing_the_page_again_changes_nothing(parts: Any, tmp_path: Path) -> None:
    page, rows = tmp_path / "page.md", [row(), row(name="two")]
    empty_page(page)
    parts.page.write_page(rows, page)
    once = page.read_text()
    parts.page.write_page(rows, page)
    assert page.read_text() == once
    lines = once.splitlines()
    assert (lines[:3], lines[-1]) == (["# Title", "", "before"], "after")
    assert lines.count("between") == lines.count("### one") == lines.count("### two") == 1
    assert "| machine | old |" not in lines
    parts.page.write_page(rows[:1], page)
    assert "two" not in page.read_text()
    page.write_text("nothing")
    with pytest.raises(InputError, match="lacks one of the lines"):
        parts.page.write_page(rows, page)


def test_the_curve_is_that_of_the_median_stretch(parts: Any, trial: Any, tmp_path: Path) -> None:
    model, loop = mujoco.MjModel.from_xml_string(XML), parts.open_loop
    mended = parts.rivals.predictor(trial, {name: [1.2 * value] for name, value in TRUE.items()})
    rules, log = rule(horizon=1.0), trial.logs[2]
    missed = loop.misses(rules, trial, model, mended)
    place = parts.held_out.median_place(loop.stretch_errors(rules, missed))

    def alone(first: int) -> float:  # the stretch as a recording of its own
        rows = slice(first, first + 501)
        own = replace(log, time=log.time[rows], ctrl=log.ctrl[rows], qpos=log.qpos[rows], qvel=log.qvel[rows])
        return parts.open_loop.held_out_error(rule(), replace(trial, logs=(own,)), model, mended)

    errors = [alone(first) for first in (0, 500, 1000, 1500)]
    assert errors[place] == sorted(errors)[1]
    stretch = loop.stretches(rules, trial)[place]
    assert stretch[1:] == (500 * place, 500 * place + 500)
    found = parts.held_out.curve(rules, model, stretch, {"mended": mended, "steady": loop.steady(model)})
    parts.held_out.save(found, tmp_path / "curves" / "one.npz")
    again = parts.held_out.read(tmp_path / "curves" / "one.npz")
    assert np.sqrt(np.mean((again.predicted["mended"] - again.measured) ** 2)) == pytest.approx(errors[place])
    assert (again.recording, again.coordinate, again.unit, again.start) == ("r2", "hinge", "rad", log.time[500 * place])
    assert again.time[-1] == pytest.approx(1.0)


def test_coordinates_that_count(parts: Any) -> None:
    xml = """<mujoco><worldbody><body><freejoint name="base"/><geom size="1"/><body>
    <joint name="hinge"/><geom size="1"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    assert parts.held_out.coordinates(rule(), model) == {"base x": 0, "base y": 1, "base z": 2, "hinge": 7}
    assert parts.held_out.coordinates(rule(dofs=(2, 6)), model) == {"base z": 2, "hinge": 7}
    assert parts.held_out.coordinates(rule(measure="spin"), model) == {"base wx": 3, "base wy": 4, "base wz": 5}


def test_a_model_that_diverges_does_not_stretch_the_picture(parts: Any, tmp_path: Path) -> None:
    time = np.linspace(0, 40, 400)
    measured = np.sin(time)
    wild = np.where(time < 20, np.exp(time), np.nan)
    predicted = {"steady": 0.1 * time, "believed": wild, "mended": measured + 0.01 * np.cos(time)}
    found = parts.held_out.Curve("r", 0.0, "hinge", "rad", time, measured, predicted)
    left, right = parts.held_out.picture(found).axes
    assert left.get_ylim() == pytest.approx((-1.5, 1.5), abs=0.01)
    assert right.get_ylim() == pytest.approx((-0.03, 0.03), abs=0.001)
    assert left.get_lines()[0].get_xdata().max() <= 30
    assert left.get_ylabel() == "hinge [rad]"
    parts.held_out.save(found, tmp_path / "one.npz")
    for name in ("a", "b"):
        parts.held_out.draw(tmp_path / "one.npz", tmp_path / name / "one.svg")
    assert (tmp_path / "a" / "one.svg").read_bytes() == (tmp_path / "b" / "one.svg").read_bytes()
    assert (tmp_path / "a" / "one.svg").stat().st_size < 60_000


def test_a_page_without_data(parts: Any, trial: Any, tmp_path: Path) -> None:
    config, page = parts.decathlon.Config(out=tmp_path, json=tmp_path / "all.json"), tmp_path / "docs" / "page.md"
    with pytest.raises(InputError, match="--data"):
        parts.decathlon.decathlon(config)
    model = mujoco.MjModel.from_xml_string(XML)
    found = parts.held_out.curve(rule(), model, (trial.logs[2], 0, 50), {"steady": parts.open_loop.steady(model)})
    parts.held_out.save(found, tmp_path / "curves" / "one.npz")
    write_json(tmp_path / "all.json", {"rows": [row(), row(name="two")]})
    page.parent.mkdir()
    empty_page(page)
    parts.decathlon.decathlon(replace(config, page=page))
    assert (page.parent / "images/machines/one.svg").is_file()
    assert page.read_text().count("![") == 1


def test_the_toolbox_recovers_known_numbers(parts: Any, trial: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts.toolbox, "LENGTH", 1.0)
    monkeypatch.setattr(parts.toolbox, "MOST", 4)
    late = [replace(log, ctrl=parts.open_loop.commands(log, "linear", log.time + 0.01)) for log in trial.logs[:2]]
    delayed = replace(trial, logs=(*late, trial.logs[2]))
    found, _ = parts.toolbox.fitted(rule(), delayed, 60.0)
    for name, value in TRUE.items():
        assert found[name][0] == pytest.approx(value, abs=0.02), name
    assert found["delay"] == pytest.approx(0.01, abs=0.001)
    stopped, predict = parts.toolbox.fitted(rule(), trial, 0.0)
    assert not stopped["ended"]
    assert predict is not None


def test_commands_that_act_late(parts: Any, trial: Any) -> None:
    log, loop = trial.logs[2], parts.open_loop
    slow = loop.simulated(lambda _: (mujoco.MjModel.from_xml_string(XML), ()), "linear", 0.02)(log, 500, 900)[0]
    shifted = replace(log, ctrl=np.roll(log.ctrl, 10, axis=0))  # ten samples of 2 ms
    expected = loop.simulated(lambda _: (mujoco.MjModel.from_xml_string(XML), ()), "linear")(shifted, 500, 900)[0]
    assert slow == pytest.approx(expected)


def test_no_toolbox_for_free_joints(parts: Any) -> None:
    xml = '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
    found, predict = parts.toolbox.fitted(rule(), parts.machine.Trial(xml, (), None))
    assert "free joint" in found["refused"]
    assert predict is None
