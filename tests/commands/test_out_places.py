"""A place that cannot be written to: one error that names it and the flag, before any work."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from btr_mjx import coevolve, diagnose, replay, scan
from btr_mjx.doctor import DoctorConfig
from btr_mjx.errors import InputError
from btr_mjx.runs import RunFolder, check_file_place

SMALL = ["--engine=native", "--no-progress", "--no-figures", "--duration=0.02"]


def in_the_way(folder: Path) -> Path:
    (folder / "file").write_text("kept")
    return folder / "file"


def below_a_file(folder: Path) -> Path:
    return in_the_way(folder) / "deep" / "run"


def no_place(folder: Path) -> Path:
    return Path("/proc/run")


PLACES = {"a file": in_the_way, "below a file": below_a_file, "a file system that takes nothing": no_place}
COMMANDS: dict[str, Callable[[Path, Path], list[str]]] = {
    "coevolve": lambda out, folder: ["--out", str(out), *SMALL],
    "scan": lambda out, folder: ["--out", str(out), *SMALL, "--behaviours=random", "--grid=2", "--trials=2"],
    "diagnose": lambda out, folder: ["--demo", "--robot=pendulum", "--out", str(out), "--no-progress"],
}
MAINS = {"coevolve": coevolve.main, "scan": scan.main, "diagnose": diagnose.main}


def error_of(main: Callable[[list[str]], None], arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]
    return line


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_run_folder(command: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = PLACES[place](tmp_path)
    line = error_of(MAINS[command], COMMANDS[command](out, tmp_path), capsys)
    assert f"--out {out}: " in line
    assert "choose another --out" in line
    if place != "a file system that takes nothing":
        assert str(tmp_path / "file") + " is a file" in line or f"{tmp_path / 'file'}: is a file" in line
        assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.parametrize("place", PLACES)
def test_a_film(place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run").mkdir()
    out = PLACES[place](tmp_path) if place != "a file" else tmp_path / "folder.gif"
    if place == "a file":
        out.mkdir()
    else:
        out = out / "film.gif"
    line = error_of(replay.main, [str(tmp_path / "run"), "--out", str(out)], capsys)
    assert f"--out {out}: " in line


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs permissions of POSIX")
def test_a_folder_without_permission() -> None:
    """As another user where this one is the superuser, who may write anywhere."""
    with tempfile.TemporaryDirectory() as name:
        locked = Path(name) / "locked"
        locked.mkdir()
        for folder, mode in ((locked, 0o555), (Path(name), 0o755)):
            folder.chmod(mode)
        superuser = os.geteuid() == 0
        if superuser:
            os.seteuid(65534)
        try:
            for out in (locked, locked / "run"):
                with pytest.raises(InputError, match="choose another --out") as raised:
                    RunFolder.create(out, DoctorConfig())
                assert str(raised.value).startswith(f"--out {out}: cannot be written: {locked}: Permission denied")
            with pytest.raises(InputError, match="Permission denied"):
                check_file_place(locked / "film.gif")
        finally:
            if superuser:
                os.seteuid(0)
            locked.chmod(0o755)
