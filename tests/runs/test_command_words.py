"""Command lines: wrong words are one line and exit code 2, with the name of the flag that was meant."""

import importlib
from dataclasses import dataclass
from typing import Literal

import pytest

from btr_mjx.errors import InputError
from btr_mjx.runs import parsed


@dataclass(frozen=True)
class Config:
    grid: int = 4
    """Points."""
    kind: Literal["even", "odd"] = "even"
    """Which."""
    progress: bool = True
    """Show progress."""


@dataclass(frozen=True)
class Plain:
    grid: int
    """Points."""


def test_config_of_words() -> None:
    assert parsed(Config, ["--grid", "3", "--kind", "odd"], prog="p") == Config(3, "odd")
    assert parsed(Config, [], prog="p", default=Config(7)) == Config(7)


def test_quiet_is_another_name() -> None:
    for words in (["--quiet"], ["--no-progress"]):
        assert parsed(Config, words, prog="p") == Config(progress=False)
    assert parsed(Plain, ["--quiet", "--grid", "2"], prog="p") == Plain(2)


@pytest.mark.parametrize(
    ("kind", "words", "told"),
    [
        (Config, ["--gird", "3"], r"--gird.*perhaps --grid"),
        (Config, ["--kind", "prime"], r"prime.*--kind.*even.*odd"),
        (Config, ["--grid", "many"], r"--grid.*many"),
        (Config, ["--grid"], r"--grid"),
        (Plain, [], r"--grid"),
    ],
)
def test_wrong_words(
    kind: type, words: list[str], told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")  # boxes are broken into lines
    with pytest.raises(InputError, match=told) as caught:
        parsed(kind, words, prog="btr-thing")
    assert str(caught.value).endswith("; btr-thing --help describes all flags")
    assert not set(str(caught.value)) & set("│╭╮╰╯─\n")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("command", ["coevolve", "scan", "diagnose", "replay", "report", "plots", "doctor"])
def test_every_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    main = importlib.import_module(f"btr_mjx.{command}").main
    with pytest.raises(SystemExit) as caught:
        main(["run", "--quiet", "--no-such-flag"])
    assert caught.value.code == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.startswith("error: ")
    assert "--no-such-flag" in error
    assert "--quiet" not in error
    assert error.count("\n") == 1
