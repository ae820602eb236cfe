"""The command: settings, errors in one line, the run folder, the demo. The search itself is a stand-in here."""

import dataclasses
import html
import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import pytest
from failing_pages import SAID, failing_page
from gap_results import FOUND

from btr_mjx import diagnose
from btr_mjx.demo import cases as demo_cases
from btr_mjx.errors import InputError
from btr_mjx.gap import inference
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.results import (
    Estimate,
    JointError,
    NamedEffect,
    detail_sentences,
    detail_statements,
    misfit_in_words,
    misfit_of,
    off_by,
    place_in_words,
    times_noise,
    verdict_sentence,
    verdict_statements,
)
from btr_mjx.gap.simulate import Journal
from btr_mjx.runs import progress, read_json

NOTHING = dataclasses.replace(FOUND, found=(), equivalent=())


def test_a_run_folder(folder: Path, searches: list, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = tmp_path / "run"
    diagnose.main([str(folder), "--out", str(run), "--max-effects", "1", "--seed", "3"])
    out = capsys.readouterr().out
    assert out.startswith("preflight\n")
    assert "2 recordings to fit and 1 held out" in out
    assert "dry friction" in out
    assert str(run) in out
    assert searches[0]["max_effects"] == 1
    assert searches[0]["seed"] == 3
    assert searches[0]["effects"] == [effect.name for effect in EFFECTS]

    result = json.loads((run / "result.json").read_text())
    assert result["verdict"] == "effect"
    (effect,) = result["effects"]
    assert (effect["effect"], effect["location"]) == ("dry_friction", "joint:servo")
    assert effect["parameters"]["torque"] | {"null": 0} == {
        "value": 0.031,
        "low": 0.028,
        "high": 0.034,
        "unit": "N m",
        "null": 0,
        "edge": False,
    }
    assert {"unit", "before", "after", "noise_reached", "explained"} <= set(result["misfit"])
    assert {"ranking", "equivalent", "next_experiment"} <= set(result)
    assert result["confounds"] == [dataclasses.asdict(FOUND.confounds[0])]
    assert "<li>More viscous damping.</li>" in (run / "report.html").read_text()
    check_all_say_the_same(run, out)
    names = {path.name for path in run.iterdir()}
    assert {"config.json", "environment.json", "preflight.csv", "ranking.csv", "report.html", "mended.xml"} <= names


def test_quiet(folder: Path, searches: list, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The result, and nothing on stderr; findings that are no warning are in the files only."""
    diagnose.main([str(folder), "--out", str(tmp_path / "run"), "--quiet"])
    out, other = capsys.readouterr()
    assert "2 recordings to fit" not in out
    assert "dry friction" in out
    assert other == ""
    assert "2 recordings to fit" in (tmp_path / "run" / "preflight.csv").read_text()


def flat(text: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def check_all_say_the_same(run: Path, printed: str) -> None:
    """Terminal, page, result.json and mended.xml have the sentences and numbers that follow from the saved numbers."""
    result, page = read_json(run / "result.json"), flat((run / "report.html").read_text(encoding="utf-8"))
    assert result["sentence"] == verdict_sentence(result)
    assert result["details"] == detail_sentences(result)
    misfit = misfit_of([JointError(**{k: v for k, v in row.items() if k != "floor"}) for row in result["joint_errors"]])
    assert misfit is not None
    assert result["misfit"]["before"] == pytest.approx(misfit.before, rel=1e-12)
    for one in (*verdict_statements(result), *detail_statements(result)):
        assert flat(one.text) in flat(printed.replace("\n    ", " "))
        assert all(flat(part) in page for part in one.text.split(". "))
    said = {key: value for one in detail_statements(result) for key, value in one.claims.items()}
    assert f"{said['misfit']} misfit, believed model" in page or f"misfit, believed model {said['misfit']}" in page
    for row in result["joint_errors"]:
        cells = [off_by(row, key) for key in ("before", "after", "constant_velocity", "noise", "time_step", "floor")]
        numbers = " ".join(cell.removesuffix("°").split()[0] for cell in cells)
        unit = "°" if row["unit"] == "rad" else cells[0].split()[-1]
        assert f"{row['joint']} {numbers} {unit} {misfit_in_words(times_noise(row, 'before'))}" in page
    assert said["misfit after"] in (run / "mended.xml").read_text().splitlines()[0]


def test_a_page_that_fails_is_one_line_after_the_result(
    folder: Path, searches: list, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    printed: list[str] = []
    monkeypatch.setattr("btr_mjx.gap.report.draw_report", failing_page(capsys, printed))
    diagnose.main([str(folder), "--out", str(tmp_path / "run"), "--no-progress"])
    assert "The missing effect is dry friction" in " ".join(printed[0].split())
    assert "mended.xml" in printed[0]
    assert capsys.readouterr().err.splitlines()[-1] == SAID


def test_effects_that_are_searched_where_nothing_is_touched_are_mended(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fading = NamedEffect("fading_motor", "actuator:servo", {"rate": Estimate(-0.01, -0.02, -0.005, "1/s")}, 80.0, 30.0)
    found = dataclasses.replace(FOUND, found=(fading,))
    monkeypatch.setattr(inference, "identify", lambda *args, **kwargs: found)
    diagnose.main([str(folder), "--out", str(tmp_path / "run"), "--no-progress"])
    mended = json.loads((tmp_path / "run" / "mended.json").read_text())
    assert [term["effect"] for term in mended["terms"]] == ["fading_motor"]
    assert not any("could not be mended" in note for note in mended["notes"])


def test_reading_shows_a_bar(
    folder: Path, searches: list, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Of long recordings only, in bytes."""
    diagnose.main([str(folder), "--out", str(tmp_path / "short"), "--no-figures"])
    assert "reading" not in capsys.readouterr().err
    monkeypatch.setattr("btr_mjx.gap.examining.LONG_READING", 1)
    diagnose.main([str(folder), "--out", str(tmp_path / "long"), "--no-figures"])
    size = sum(path.stat().st_size for path in folder.iterdir() if path.suffix in (".npz", ".csv", ".parquet"))
    lines = capsys.readouterr().err.splitlines()
    assert re.match(r"reading: +0%.* 0\.00/", lines[0])
    assert any(re.match(rf"reading: 100%.* {size / 1000:.3g}k", line) for line in lines), lines


def test_a_search_in_recordings_shows_the_time_left(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """From its first steps on, whatever their number."""

    def stand_in(dataset: Any, library: Any, most: int, seed: int, note: Any, counter: Journal, **more: Any) -> Any:
        note("state estimates")
        for _ in range(4):
            counter.add(1_000_000)
        return NOTHING

    monkeypatch.setattr(inference, "identify", stand_in)
    monkeypatch.setattr("btr_mjx.gap.simulate.following.progress", partial(progress, interval=0.0))
    diagnose.main([str(folder), "--out", str(tmp_path / "run"), "--no-figures"])
    lines = capsys.readouterr().err.splitlines()
    searching = [line for line in lines if line.startswith("state estimates") and "steps" in line]
    assert len(searching) == 4
    assert all(re.search(r" [1-9]\d?%\|.*<\d\d:\d\d, [1-4]\.00M steps", line) for line in searching), lines
    assert "100%" in lines[-1]


def test_a_finished_run_is_only_drawn_again(folder: Path, searches: list, tmp_path: Path) -> None:
    run = tmp_path / "run"
    diagnose.diagnose(dataset=folder, out=run, progress=False)
    before = (run / "result.json").read_bytes()
    (run / "report.html").unlink()
    diagnose.diagnose(dataset=folder, out=run, progress=False, resume=True)
    assert len(searches) == 1
    assert (run / "result.json").read_bytes() == before
    assert (run / "report.html").is_file()
    with pytest.raises(InputError, match="not empty"):
        diagnose.diagnose(dataset=folder, out=run, progress=False)
    with pytest.raises(InputError, match="another config"):
        diagnose.diagnose(dataset=folder, out=run, progress=False, resume=True, seed=5)


@pytest.mark.slow
@pytest.mark.parametrize("robot", list(diagnose.DEMO_SEEDS))
def test_the_demo_is_named_and_mended(robot: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The first thing a visitor runs, and the only place where tests search for what a walking robot lacks."""
    diagnose.main(["--demo", "--robot", robot, "--out", str(tmp_path), "--no-progress"])
    result = read_json(tmp_path / "result.json")
    check_all_say_the_same(tmp_path, capsys.readouterr().out)
    truth = json.loads((tmp_path / "truth.json").read_text())
    found = [(effect["effect"], effect["location"]) for effect in result["effects"]]
    assert found == [(effect["effect"], effect["location"]) for effect in truth["effects"]]
    assert result["misfit"]["after"] < result["misfit"]["before"]
    mujoco.MjModel.from_xml_path(str(tmp_path / "mended.xml"))


def test_an_interrupted_demo_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The case is made once; the command that goes on is printed; the answer comes last."""
    run = tmp_path / "run"
    monkeypatch.setattr(demo_cases, "_FIT", 2)
    monkeypatch.setattr(demo_cases, "_TEST", 1)

    def interrupted(*args: Any, **more: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(inference, "identify", interrupted)
    argv = ["--demo", "--robot", "pendulum", "--seed", "6", "--out", str(run), "--no-progress", "--no-figures"]
    with pytest.raises(SystemExit) as stop:
        diagnose.main(argv)
    assert stop.value.code == 130
    assert f"--out {run} --no-progress --no-figures --resume" in capsys.readouterr().err
    truth = (run / "truth.json").read_bytes()
    monkeypatch.setattr(inference, "identify", lambda *a, **k: NOTHING)
    diagnose.main([*argv, "--resume"])
    assert (run / "truth.json").read_bytes() == truth
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("hidden was: ")
    (hidden,) = json.loads(truth)["effects"]
    assert place_in_words(hidden["location"]) in last
    assert json.loads((run / "result.json").read_text())["verdict"] == "none"


def test_a_killed_search_goes_on(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stopped in the middle of the search and resumed: what was simulated is read back, and the result is the same."""
    argv = [str(folder), "--effects", "dry_friction", "viscous_damping", "--max-effects", "1", "--no-figures"]
    diagnose.main([*argv, "--out", str(tmp_path / "whole"), "--no-progress"])
    steps = json.loads((tmp_path / "whole" / "result.json").read_text())["steps"]
    run, journal = tmp_path / "run", Journal

    def killed(path: Path, report: Callable[[int], None], code: bytes, expect: Callable[[float], None]) -> Journal:
        def count(done: int) -> None:
            report(done)
            if done > 0.6 * steps:
                raise KeyboardInterrupt

        return journal(path, count, code, expect)

    monkeypatch.setattr("btr_mjx.gap.simulate.following.Journal", killed)
    with pytest.raises(SystemExit):
        diagnose.main([*argv, "--out", str(run)])
    saved = {path: path.stat().st_mtime_ns for path in (run / "search").iterdir()}
    assert len(saved) > 1
    err = capsys.readouterr().err
    assert re.search(r"k steps, .*steps/s", err)
    kept: list[bool] = []

    def watched(path: Path, report: Callable[[int], None], code: bytes, expect: Callable[[float], None]) -> Journal:
        def count(done: int) -> None:
            report(done)
            kept.append(all(p.stat().st_mtime_ns == t for p, t in saved.items() if p.exists()))

        return journal(path, count, code, expect)

    monkeypatch.setattr("btr_mjx.gap.simulate.following.Journal", watched)
    diagnose.main([*argv, "--out", str(run), "--no-progress", "--resume"])
    assert all(kept)  # no answer was written again
    assert len(kept) > len(saved)
    assert not (run / "search").exists()
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("whole", "run")]
    for result in results:
        del result["seconds"]
    assert results[0] == results[1]
    assert (run / "ranking.csv").read_bytes() == (tmp_path / "whole" / "ranking.csv").read_bytes()
