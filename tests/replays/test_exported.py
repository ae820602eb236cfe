"""Exports of a diagnosis: its recording and simulations as they are, and a failure is a line."""

import json
from pathlib import Path

import numpy as np
import pytest
from robot_logs import ARM, simulated_log

from btr_mjx import diagnose, report
from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset
from btr_mjx.replays import check_exports, export_motions, exported, read_replay, source
from btr_mjx.runs import RunFolder, content_digest, write_arrays, write_json, write_table


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A diagnosis of two joints, of which one has no encoder, that found nothing."""
    (tmp_path / "arm.xml").write_text(ARM)
    log = simulated_log(ARM, 3.0).every(5)
    columns = {"time": 7 + log.time, "qpos/shoulder": log.qpos[:, 0]}
    write_table(tmp_path / "log.csv", columns | {"ctrl/shoulder": log.ctrl[:, 0], "ctrl/elbow": log.ctrl[:, 1]})
    given = diagnose.DiagnoseConfig(tmp_path / "arm.xml", (tmp_path / "log.csv",), out=tmp_path / "run")
    inputs = {"the dataset": content_digest(open_dataset(tmp_path / "arm.xml", logs=given.logs))}
    assert given.out is not None
    with RunFolder.create(given.out, given, inputs=inputs) as folder:
        write_json(folder.path / "result.json", {"verdict": "none", "sentence": "", "effects": [], "misfit": None})
        curve = {f"{key}_0": np.arange(4) + k for k, key in enumerate(("measured", "before", "after"))}
        said = {"recordings": "log", "names": "joint elbow", "units": "rad"}
        texts = {key: np.array([text]) for key, text in said.items()}
        write_arrays(folder.path / "overlays.npz", texts | {"time_0": np.arange(4) / 10} | curve)
        folder.seal()
    return given.out


def messages_of(path: Path) -> dict[str, list[tuple[float, dict]]]:
    from mcap.reader import make_reader

    found: dict[str, list[tuple[float, dict]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, json.loads(message.data)))
    return found


def test_an_export_holds_every_sample_and_the_simulation_of_the_film(run: Path) -> None:
    assert export_motions(run, ("mcap",)) == [run / "diagnosis.mcap"]
    found = messages_of(run / "diagnosis.mcap")
    recording = open_dataset(run.parent / "arm.xml", logs=(run.parent / "log.csv",)).test[0]
    times = [time for time, _ in found["/recording/measured"]]
    np.testing.assert_allclose(times, recording.time, atol=1e-9)
    # Without an encoder there is no measurement of the elbow.
    assert {tuple(content) for _, content in found["/recording/measured"]} == {("shoulder",)}
    measured = [content["shoulder"] for _, content in found["/recording/measured"]]
    np.testing.assert_array_equal(measured, recording.qpos[:, 0])
    film = read_replay(run, 6, 0.5)  # at samples of the recording
    believed = np.array(
        [[content[name] for name in ("shoulder", "elbow")] for _, content in found["/recording/believed"]]
    )
    rows = np.searchsorted(recording.time - recording.time[0], film.times - 1e-9)
    np.testing.assert_allclose(believed[rows], film.motions[1].qpos, atol=1e-6)
    frames = {one["child_frame_id"] for _, content in found["/tf"] for one in content["transforms"]}
    assert frames == {f"{motion}/{body}" for motion in ("measured", "believed") for body in ("upper", "lower")}
    stretch = [[content["elbow"] for _, content in found[f"/stretch_1/{name}"]] for name in ("measured", "believed")]
    assert stretch == [[0, 1, 2, 3], [1, 2, 3, 4]]


def test_an_export_that_fails_is_a_line(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("of a bug")

    monkeypatch.setitem(exported.EXPORTS, "rerun", ("diagnosis.rrd", fails))
    monkeypatch.setattr(source, "find_spec", lambda name: name)  # as if it were installed
    report.main([str(run), "--export", "rerun", "mcap"])
    said = capsys.readouterr()
    assert said.err.splitlines() == ["no diagnosis.rrd: ZeroDivisionError: of a bug"]
    assert said.out.splitlines() == [str(run / "report.html"), str(run / "diagnosis.mcap")]
    (run.parent / "log.csv").unlink()
    assert export_motions(run, ("rerun", "mcap")) == []
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("no diagnosis.rrd and diagnosis.mcap: ")


def test_a_package_that_is_not_installed_is_named_before_anything_is_done(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(source, "find_spec", lambda name: None)
    model, log, out = (str(run.parent / name) for name in ("arm.xml", "log.csv", "other"))
    for command, arguments in ((diagnose, [model, log, "--out", out]), (report, [str(run)])):
        with pytest.raises(SystemExit) as stopped:
            command.main([*arguments, "--export", "rerun"])
        assert stopped.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "pip install 'btr-mjx[rerun]'" in line
    assert not Path(out).exists()
    assert not (run / "report.html").exists()


def test_kinds_of_exports_are_extras_and_modules() -> None:
    """The error names an extra that exists, and looks for the module that this extra brings."""
    import tomllib

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert set(exported.EXPORTS) <= set(project["optional-dependencies"])
    check_exports([kind for kind in exported.EXPORTS if kind != "rerun"])


def test_what_holds_no_motion_is_not_exported(tmp_path: Path) -> None:
    given = diagnose.DiagnoseConfig(tmp_path, export=("mcap",), signal="fitness")
    with pytest.raises(InputError, match="holds no motion"):
        diagnose.check_diagnosis(given)
    write_json(tmp_path / "result.json", {"spearman": 1.0})
    write_arrays(tmp_path / "scan.npz", {"a": np.zeros(1)})
    with pytest.raises(InputError, match="is for runs of"):
        report.check_report(report.ReportConfig((tmp_path,), ("mcap",)))
