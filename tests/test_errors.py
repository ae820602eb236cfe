import os
import subprocess
import sys
from pathlib import Path

import pytest

from btr_mjx import errors
from btr_mjx.errors import UNREAD_CODE, InputError, Interrupted, cli_errors, resume_command


class OurError(ValueError):
    __module__ = "btr_mjx.engines.base"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("m is 9, expected m < M;\n  give fewer"), "error: m is 9, expected m < M; give fewer"),
        (OurError("unsupported"), "error: unsupported"),
        (FileNotFoundError(2, "No such file or directory", "x.csv"), "error: x.csv: No such file or directory"),
        (PermissionError(13, "Permission denied", "a", None, Path("b")), "error: a -> b: Permission denied"),
        (OSError("odd"), "error: odd"),
        (InputError(), "error: InputError"),
    ],
)
def test_bad_input_is_one_line(error, line, capsys):
    @cli_errors()
    def command():
        raise error

    with pytest.raises(SystemExit) as caught:
        command()
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", line + "\n")


@pytest.mark.parametrize(
    "error", [TypeError(), AssertionError(), ValueError("numpy"), KeyError(1), RuntimeError(), SystemExit(7)]
)
def test_bugs_pass(error, capsys):
    with pytest.raises(type(error)) as caught, cli_errors():
        raise error
    assert caught.value is error
    assert capsys.readouterr().err == ""


def test_traceback_on_request(monkeypatch):
    monkeypatch.setenv("BTR_MJX_TRACEBACK", "1")
    with pytest.raises(InputError), cli_errors():
        raise InputError("x")


def test_interrupts_exit_with_130(capsys):
    for error, text in ((KeyboardInterrupt(), "interrupted"), (Interrupted("stopped"), "stopped")):
        with pytest.raises(SystemExit) as caught, cli_errors(), cli_errors(resume="python -m x --resume"):
            raise error
        assert caught.value.code == 130
        assert capsys.readouterr().err == f"\n{text}\nresume with: python -m x --resume\n"
    assert errors.one_line(Interrupted()) == "interrupted"


def test_resume_command(monkeypatch):
    monkeypatch.delenv("UV_RUN_RECURSION_DEPTH", raising=False)
    command = resume_command("btr_mjx.coevolve", ["--seed", "3", "--no-resume", "--note", "a b"], out=Path("runs/x"))
    assert command == "python -m btr_mjx.coevolve --seed 3 --note 'a b' --out runs/x --resume"
    monkeypatch.setattr(sys, "argv", ["x.py", "--out=y", "--resume"])
    assert resume_command("btr_mjx.scan", out="y") == "python -m btr_mjx.scan --out=y --resume"
    monkeypatch.setenv("UV_RUN_RECURSION_DEPTH", "1")
    assert resume_command("btr_mjx.scan", out="y") == "uv run python -m btr_mjx.scan --out=y --resume"
    monkeypatch.setattr("sys.argv", ["/environment/bin/btr-scan", "--out=y"])
    assert resume_command("btr_mjx.scan", out="y") == "uv run btr-scan --out=y --resume"


@pytest.mark.parametrize("command", ["coevolve", "diagnose", "doctor", "plots", "replay", "report", "scan"])
def test_help_that_nobody_reads_to_the_end_ends_quietly(command: str) -> None:
    """As in `--help | head`: the other end of the pipe is closed."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as pipe:
        line = [sys.executable, "-m", f"btr_mjx.{command}", "--help"]
        done = subprocess.run(line, stdout=pipe, stderr=subprocess.PIPE, text=True, timeout=120)
    assert done.stderr == ""
    assert done.returncode == UNREAD_CODE
