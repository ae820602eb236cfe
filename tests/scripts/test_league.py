"""The league: budgets hold, truths stay sealed, scores mean what they say, and realities are those of their numbers."""

import ast
import importlib
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import btr_mjx as btr
from btr_mjx.errors import InputError

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The modules; what a process of its own would measure is measured in this one."""
    for folder in (FOLDER, FOLDER / "league"):
        monkeypatch.syspath_prepend(str(folder))
    own = {name: importlib.import_module(name) for name in ("contest", "contestants", "league", "rows", "sealed")}

    def here(*words: str) -> None:
        if words[0] == "measure":
            own["sealed"].measure(words[1], Path(words[2]), int(words[3]), "--exact" in words)
        else:
            budget = own["contest"].Budget(**json.loads(Path(words[4]).read_text()))
            own["sealed"].oracle(words[1], Path(words[2]), int(words[3]), budget)

    monkeypatch.setattr(own["contest"], "run_sealed", here)
    monkeypatch.setattr(own["rows"], "run_sealed", here)
    yield SimpleNamespace(**own)
    own["sealed"].reality.cache_clear()


def controllers(parts: Any, name: str, count: int) -> np.ndarray:
    return parts.contest.league_robot(name).controller_box.sample(np.random.default_rng(3), count)


def test_no_more_trials_than_the_budget(parts: Any, tmp_path: Path) -> None:
    room, rows = parts.contest.Room("finger-0", tmp_path, 3), controllers(parts, "finger-0", 4)
    first = room.measure(rows[:2], 0)
    np.testing.assert_array_equal(room.measure(rows[:2], 0), first)  # asked for once more, not tried once more
    with pytest.raises(InputError, match="4 trials were asked for, and 3 may be measured"):
        room.measure(rows[2:], 2)
    assert sorted(path.name for path in tmp_path.glob("measured/trial-*")) == ["trial-0.csv", "trial-1.csv"]
    tried, fitness = room.tried()
    np.testing.assert_array_equal(tried, rows[:2])
    np.testing.assert_array_equal(fitness, first[:, 0])


def imported(module: str) -> set[str]:
    """Modules of the benchmarks that a module imports, and those that these import."""
    seen, left = set[str](), [module]
    while left:
        name = left.pop()
        places = (FOLDER / f"{name}.py", FOLDER / "league" / f"{name}.py", FOLDER / name / "__init__.py")
        path = next((path for path in places if path.is_file()), None)
        if path is None or name in seen:
            continue
        seen.add(name)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                left += [alias.name.partition(".")[0] for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                left.append(str(node.module).partition(".")[0])
    return seen


def test_contestants_do_not_import_the_truth() -> None:
    assert imported("contestants") == {"contestants", "contest"}
    assert imported("league") == {"league", "rows", "contestants", "contest"}
    assert {"hidden_cases", "contest"} < imported("sealed")


def test_the_score_of_the_oracle_is_1(parts: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    budget = parts.contest.Budget(controllers=6, generations=2, rounds=1)
    yard = parts.rows.yardstick("finger-0", budget, tmp_path / "oracle")
    fresh = parts.rows.fresh_controllers("finger-0")
    middle = fresh[np.argsort(yard["fresh"])[len(fresh) // 2]]
    for controller, score in ((np.array(yard["controller"]), 1.0), (middle, 0.0)):

        def contestant(task: Any, controller: np.ndarray = controller) -> Any:
            task.reality.measure(controller, 0)
            return parts.contest.Answer(controller)

        monkeypatch.setattr(parts.rows, "CONTESTANTS", {"own": contestant})
        row = parts.rows.contest("finger-0", "own", 0, 8, budget, tmp_path / "exchange")
        judged = parts.league.judged(row, yard, 8)
        # Of 12 random controllers, the median lies between two.
        assert judged["score"] == (1.0 if score else pytest.approx(0.0, abs=0.2))
        # Nothing is worse than a random controller; sensors have noise.
        assert judged["regret"] == pytest.approx(1 - max(judged["score"], 0.0), abs=0.02)
        assert judged["delta"] is None


def test_a_contestant_that_crashes_counts_as_a_random_controller(
    parts: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def contestant(task: Any) -> Any:
        task.reality.measure(controllers(parts, "finger-0", 1), 0)
        raise ZeroDivisionError("no such\nnumber")

    monkeypatch.setattr(parts.rows, "CONTESTANTS", {"own": contestant})
    row = parts.rows.contest("finger-0", "own", 0, 8, parts.contest.Budget(), tmp_path)
    assert row["failed"] == "ZeroDivisionError: no such number"
    yard = {"fitness": 2.0, "fresh": [1.0], "sort": "library", "hidden": []}
    judged = parts.league.judged(row, yard, 8)
    assert (judged["score"], judged["regret"], judged["delta"]) == (0.0, 1.0, None)
    assert parts.league.tables([judged])[0][1][:4] == ["own", "0.00", "0 of 1", "1.00"]


@pytest.mark.parametrize("name", ["thrower-0", "finger-0", "cart-0", "hopper-0", "quadruped-0"])
def test_a_reality_without_secrets_is_the_library_s(parts: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the true numbers, two implementations of a robot move alike."""
    monkeypatch.setattr(parts.sealed, "CALIBRATION", 0.0)
    monkeypatch.setattr(parts.sealed, "EMPTY", len(parts.contest.REALITIES))
    monkeypatch.setattr(parts.sealed, "OUTSIDERS", 0)
    own = parts.sealed.reality(name)
    truth = own.robot.nominal_simulation
    for word in own.hidden:
        number, _, value = word.partition(" = ")
        truth[own.robot.simulation_box.index(number)] = float(value)
    row = controllers(parts, name, 1)[0]
    real = parts.sealed.moved(own, parts.sealed.signal_table(own.robot, row))
    settings = btr.EngineSettings(timestep=parts.sealed.STEP, integrator="implicit")
    times = [0.1, 0.2, 0.3]
    simulated = btr.evaluate(own.robot, truth, row, engine="native", times=times, states=True, settings=settings)
    assert simulated.outcome.qpos is not None
    at = np.rint(np.array(times) * parts.sealed.RATE).astype(int)
    far = np.abs(real["qpos"][at] - real["qpos"][0]).max()
    np.testing.assert_allclose(real["qpos"][at], simulated.outcome.qpos[0, 0], atol=0.02 * far)
    believed = btr.evaluate(own.robot, own.robot.nominal, row, engine="native", times=times, states=True)
    assert believed.outcome.qpos is not None
    assert np.abs(real["qpos"][at] - believed.outcome.qpos[0, 0]).max() > 0.02 * far


@pytest.mark.slow
def test_what_is_hidden(parts: Any) -> None:
    own = {name: parts.sealed.reality(name) for name in parts.contest.REALITIES}
    assert Counter(one.sort for one in own.values()) == {"library": 16, "outside": 2, "nothing": 2}
    for name, one in own.items():
        count = len(one.hidden) - len(parts.contest.unknown_of(one.robot))
        assert count in {"nothing": [0], "outside": [1], "library": [1, 2, 3]}[one.sort], name


@pytest.mark.slow
def test_controllers_matter_in_every_reality(parts: Any) -> None:
    """A robot that something hidden holds fast tells nothing."""
    for name in parts.contest.REALITIES:
        robot, rows = parts.contest.league_robot(name), controllers(parts, name, 6)
        real = replace(robot, simulator=parts.sealed.TrueSimulator(name))
        spreads = [np.ptp(parts.contest.predicted(own, own.nominal_simulation[None], rows)) for own in (robot, real)]
        assert spreads[1] > 0.2 * spreads[0] > 0, name


@pytest.mark.slow
def test_the_league_goes_on_where_it_was_killed(tmp_path: Path) -> None:
    words = [sys.executable, FOLDER / "league.py", "--quick", "--trials", "8", "--realities", "finger-2"]
    words += ["--contestants", "believed", "no_simulator", "--out", tmp_path, "--json", tmp_path / "all.json"]
    texts = []
    for _ in range(2):
        done = subprocess.run(list(map(str, words)), capture_output=True, text=True, check=True)
        texts.append(done.stdout)
        for path in tmp_path.rglob("finger-2-no_simulator-0-8.json"):
            path.unlink()
        times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("finger-2-believed-0-8.json")}
    assert {path: path.stat().st_mtime_ns for path in times} == times
    rows = json.loads((tmp_path / "all.json").read_text())["rows"]
    assert [row["contestant"] for row in rows] == ["believed", "no_simulator"]
    assert all(len(row["measured"]) == 8 and 0 < row["score"] < 1.5 for row in rows)
    cells = [[cell.strip() for cell in line.split("|")][1:-1] for line in texts[0].splitlines() if line]
    assert cells[4:6] == [["contestant", "finger", "outside", "mean"], ["---"] * 4]
    for row, total, part in zip(rows, cells[2:4], cells[6:], strict=True):
        score = f"{row['score']:.2f}"
        assert total[:3] == [row["contestant"], score, f"{int(row['score'] >= 0.9)} of 1"]
        assert part == [row["contestant"], *[score] * 3]
