import json
import math
import os
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from run_configs import Config, Mutation

from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.runs import RunFolder, claimed_folder, config_to_json, files
from btr_mjx.runs.checkpoints import checkpoint_path, list_checkpoints
from btr_mjx.runs.config_json import read_config
from btr_mjx.runs.run_folder import History


def test_history_is_a_table(tmp_path):
    rows = [
        {
            "step": 1,
            "x": np.float32(0.1),
            "mixed": 1,
            "none": None,
            "late": None,
            "s": np.array([0.4, 1.6]),
            "ok": True,
        },
        {"step": 2, "x": math.nan, "mixed": 2.5, "none": None, "late": "text", "s": [math.inf, 1.0], "ok": np.bool_(0)},
    ]
    whole, first = History(tmp_path / "a.csv"), History(tmp_path / "b.csv")
    for row in rows:
        whole.append(row)
    whole.write()
    first.append(rows[0])
    first.write()
    second = History(tmp_path / "b.csv", first.rows)
    second.append(rows[1])
    second.write()
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    table = files.read_table(tmp_path / "a.csv").to_dict(as_series=False)
    assert np.array(table.pop("x")) == pytest.approx([0.1, math.nan], nan_ok=True)
    assert [json.loads(text) for text in table.pop("s")] == [[0.4, 1.6], [math.inf, 1.0]]
    assert table == {
        "step": [1, 2],
        "mixed": [1.0, 2.5],
        "none": [None] * 2,
        "late": [None, "text"],
        "ok": [True, False],
    }
    with pytest.raises(ValueError, match="expected the columns"):
        second.append({"step": 3})


def test_history_is_cut_to_the_checkpoint(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        history = run.history("history.csv")
        for step in range(3):
            history.append({"step": step, "half": 0})
            history.append({"step": step, "half": 1})
            run.save_checkpoint(step, {})
        history.append({"step": 3, "half": 0})
        history.write()
    checkpoint_path(run.path, 2).write_bytes(b"")
    with RunFolder.create(tmp_path / "run", Config(), resume=True) as run:
        checkpoint = run.load_latest()
        assert checkpoint.step == 1
        assert [row["step"] for row in run.history("history.csv", checkpoint).rows] == [0, 0, 1, 1]
        assert len(run.history("other.csv", checkpoint)) == 0
        assert len(run.history("history.csv", None)) == 0
        # The file is never read back: one that was damaged is written again.
        (run.path / "history.csv").write_bytes(b"step\n7")
        run.history("history.csv", checkpoint)
        assert files.read_table(run.path / "history.csv")["step"].to_list() == [0, 0, 1, 1]


def test_finished_files_are_guarded_by_checkpoints(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        files.write_arrays(run.path / "archive.npz", {"x": np.zeros(3)})
        run.add_file("archive.npz")
        run.save_checkpoint(0, {})
    sound = (tmp_path / "run" / "archive.npz").read_bytes()
    for name, damage, what in (
        ("archive.npz", sound[:-1], "was altered"),
        ("archive.npz", None, "is missing"),
    ):
        path = tmp_path / "run" / name
        before = path.read_bytes()
        path.unlink() if damage is None else path.write_bytes(damage)
        with pytest.raises(InputError, match=rf"{name}.* {what}"):  # noqa: SIM117
            with RunFolder.create(tmp_path / "run", Config(), resume=True) as run:
                run.load_latest()
        path.write_bytes(before)
    with RunFolder.create(tmp_path / "run", Config(), resume=True) as run:
        assert run.load_latest().step == 0


def test_a_resumed_run_needs_the_same_inputs(tmp_path, capsys):
    RunFolder.create(tmp_path / "run", Config(), inputs={"the robot": "a", "the data": "b"}).close()
    before = snapshot(tmp_path / "run")
    with pytest.raises(InputError, match="the data changed since the run was started; restore"):
        RunFolder.create(tmp_path / "run", Config(), resume=True, inputs={"the robot": "a", "the data": "c"})
    assert snapshot(tmp_path / "run") == before
    RunFolder.create(tmp_path / "run", Config(), resume=True, inputs={"the robot": "a", "the data": "b"}).close()
    (tmp_path / "run" / "inputs.json").unlink()
    capsys.readouterr()
    RunFolder.create(tmp_path / "run", Config(), resume=True, inputs={"the robot": "a"}).close()
    assert "inputs.json is missing: whether the robot" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b'{"resumed": 3}', b"\xff"])
def test_a_damaged_description_of_the_environment_stops_no_run(tmp_path, capsys, content):
    RunFolder.create(tmp_path / "run", Config()).close()
    (tmp_path / "run" / "environment.json").write_bytes(content)
    RunFolder.create(tmp_path / "run", Config(), resume=True).close()
    assert "environment.json" in capsys.readouterr().err
    assert len(files.read_json(tmp_path / "run" / "environment.json")["resumed"]) == 1


def test_folders_are_claimed_one_by_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named = Config(out=tmp_path / "mine")
    with claimed_folder(named, "quick") as config:
        assert config is named
    with claimed_folder(Config(out=None), "quick") as first, claimed_folder(Config(out=None), "quick") as second:
        assert (first.out, second.out) == (Path("runs/quick"), Path("runs/quick-2"))
        (second.out / "config.json").touch()
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["quick-2"]  # an empty one is given back
    with pytest.raises(InputError, match="--resume: say which run"), claimed_folder(Config(out=None, resume=True), "q"):
        pass


def test_sums_are_those_of_sha256sum(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        files.write_json(run.path / "result.json", {"x": 1})
        files.write_table(run.path / "table.csv", {"x": [1]})
        (run.path / "figure.png").write_bytes(b"1")
        run.seal()
    checked = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=tmp_path / "run", capture_output=True, text=True)
    assert checked.stdout.split() == ["config.json:", "OK", "result.json:", "OK", "table.csv:", "OK"]
    assert files.read_table(tmp_path / "run" / "table.csv")["x"].to_list() == [1]
    (tmp_path / "run" / "table.csv").write_text("x\n2\n")
    with pytest.raises(DamagedFile, match=r"table\.csv: the file was altered since SHA256SUMS was written"):
        files.read_table(tmp_path / "run" / "table.csv")


def test_a_kill_after_the_last_checkpoint_leaves_no_file_too_many(tmp_path, monkeypatch):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        for step in range(2):
            run.save_checkpoint(step, {})

        def killed(path, missing_ok=False):
            raise InterruptedError(path.name)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "unlink", killed)
            with pytest.raises(InterruptedError, match="checkpoint-000000"):
                run.save_checkpoint(2, {})
    assert len(list_checkpoints(run.path)) == 3
    with RunFolder.create(tmp_path / "run", Config(), resume=True) as run:
        assert run.load_latest().step == 2
        assert [step for step, _ in list_checkpoints(run.path)] == [1, 2]


def snapshot(folder):
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}


def test_an_existing_folder_is_left_alone(tmp_path):
    with RunFolder.create(tmp_path / "run", Config()) as run:
        assert not run.resumed
        assert (run.path / "environment.json").exists()
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x")
    for folder in (tmp_path / "run", foreign):
        before = snapshot(folder)
        with pytest.raises(InputError, match=r"is not empty.*--resume.*--out"):
            RunFolder.create(folder, Config(seed=1))
        assert snapshot(folder) == before
    with pytest.raises(InputError, match=r"foreign is not a run folder: it holds no config\.json"):
        RunFolder.create(foreign, Config(), resume=True)
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]
    with pytest.raises(InputError, match="is a file"):
        RunFolder.create(foreign / "thesis.tex", Config())
    with pytest.raises(InputError, match="nothing to resume"):
        RunFolder.create(tmp_path / "typo", Config(), resume=True)
    assert not (tmp_path / "typo").exists()
    (tmp_path / "empty").mkdir()
    RunFolder.create(tmp_path / "empty", Config()).close()


def test_resume_needs_the_same_config(tmp_path):
    RunFolder.create(tmp_path / "run", Config()).close()
    before = snapshot(tmp_path / "run")
    other = Config(seed=5, mutation=Mutation(coding="binary"), resume=True, out=Path("./runs/demo/."))
    with pytest.raises(
        InputError, match=r"seed: saved 0, now 5; mutation: saved .*'gray'.*now .*'binary'.*--out"
    ) as caught:
        RunFolder.create(tmp_path / "run", other, resume=True)
    assert "resume:" not in str(caught.value)
    assert snapshot(tmp_path / "run") == before
    with pytest.raises(InputError, match="resume: saved False, now True"):
        RunFolder.create(tmp_path / "run", Config(resume=True), resume=True, ignore=())
    with RunFolder.create(tmp_path / "run", Config(resume=True), resume=True) as run:
        assert run.resumed
    assert read_config(tmp_path / "run", Config) == Config()
    assert len(files.read_json(tmp_path / "run" / "environment.json")["resumed"]) == 1


@pytest.mark.parametrize("left", [[], [".lock"], [".lock", ".config.json.0123.tmp"], [".lock", "config.json"]])
def test_a_create_that_was_killed_can_be_resumed(tmp_path, left):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in left:
        (folder / name).write_text("12345")
    if "config.json" in left:
        files.write_json(folder / "config.json", config_to_json(Config()))
    with RunFolder.create(folder, Config(), resume=True) as run:
        assert run.load_latest() is None
        assert {path.name for path in folder.iterdir()} == {".lock", "config.json", "environment.json"}


def test_damaged_config(tmp_path):
    RunFolder.create(tmp_path / "run", Config()).close()
    (tmp_path / "run" / "config.json").write_text('{"seed": ')
    with pytest.raises(DamagedFile, match=r"config\.json: not valid JSON"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    (tmp_path / "run" / "config.json").write_text("[]")
    with pytest.raises(DamagedFile, match="expected a JSON object"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    with pytest.raises(InputError, match="there is no such folder"):
        read_config(tmp_path / "typo", Config)


def test_a_lock_that_is_let_go_of_soon_is_waited_for(tmp_path):
    """A killed run may leave what it was starting with its descriptors for a moment."""
    run = RunFolder.create(tmp_path / "run", Config())
    with pytest.raises(InputError, match="in use by another run"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    timer = threading.Timer(0.2, run.close)
    timer.start()
    RunFolder.create(tmp_path / "run", Config(), resume=True).close()
    timer.join()


def test_one_writer_at_a_time(tmp_path):
    run = RunFolder.create(tmp_path / "run", Config())
    with pytest.raises(InputError, match=rf"in use by another run \(process {os.getpid()}\)"):
        RunFolder.create(tmp_path / "run", Config(), resume=True)
    run.close()
    run.close()
    run = RunFolder.create(tmp_path / "run", Config(), resume=True)
    del run  # forgotten, not closed
    RunFolder.create(tmp_path / "run", Config(), resume=True).close()
