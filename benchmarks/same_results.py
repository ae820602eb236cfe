"""Bit-wise comparison of two versions' results: `uv run python benchmarks/same_results.py --before REVISION`.

Both versions run the same commands, each in a working tree of its own. Then result.json, tables and arrays are
compared. Only seconds, paths, versions and names of modules may differ. The results of a revision are kept in the
output folder, so that a second comparison runs this version only.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from hidden_cases import make_case

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import note, read_json, write_json

COMMANDS = {
    "quick": "coevolve --seed 0",
    "paper": "coevolve --preset paper --iterations 1",
    "scan": "scan --parameter bl_14",
    "pendulum": "diagnose {pendulum} --seed 1",
    "hexapod": "diagnose {hexapod} --seed 38",
}
"""Commands by the name of their run folder; {robot} is the folder of a hidden case of that robot and seed."""
CASES = {"pendulum": 1, "hexapod": 38}
"""Seeds of the hidden cases by robot, which this version makes for both."""

TIMES = ("seconds",)
"""Keys of result.json that hold times."""

_MODULE = re.compile(r"btr_mjx(\.\w+)+")
"""A dotted name of a module of this package."""

_PATH = re.compile(r'"/[^"]*"')
"""An absolute path in a text file."""

_SKIPPED = ("environment.json", "config.json", "search")
"""Files and folders that describe how a run was made; config.json has the path of its folder."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    before: str
    """Revision to compare with: a commit, a tag or a branch."""
    only: tuple[str, ...] = ()
    """Names of the commands to compare; all by default."""
    out: Path = Path("runs/same_results")
    """Folder of both versions' runs."""
    again: bool = True
    """Run this version again; without it, its results in the folder are compared."""
    json: Path | None = None
    """Also write the differences to this file."""


def run_command(tree: Path, name: str, folder: Path, cases: Path) -> None:
    """Run one command in a working tree, into a run folder; hidden cases are in another one, made where absent.

    Raises:
      InputError: the command failed; its last line is in the message.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if name in CASES and not (cases / name).is_dir():
        make_case(cases / name, CASES[name], name)
    module, *flags = COMMANDS[name].format(**{robot: (cases / robot).resolve() for robot in CASES}).split()
    command = [
        "uv",
        "run",
        "python",
        "-m",
        f"btr_mjx.{module}",
        *flags,
        "--out",
        str(folder.resolve()),
        "--no-progress",
    ]
    environment = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(f"{' '.join(command)} in {tree} ended with {done.returncode}: {last}")


def comparable(value: Any) -> Any:
    """A value of result.json without times, names of modules and paths."""
    if isinstance(value, dict):
        return {key: comparable(item) for key, item in value.items() if key not in TIMES}
    if isinstance(value, list):
        return [comparable(item) for item in value]
    if isinstance(value, str):
        return "PATH" if value.startswith(os.sep) else _MODULE.sub("btr_mjx", value)
    return value


def content(path: Path) -> Any:
    """Content of a file, equal for two files where every bit of their data is; None for pictures and pages."""
    match path.suffix:
        case ".json":
            return json.dumps(comparable(read_json(path)), sort_keys=True)
        case ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                return {name: (a.dtype.str, a.shape, a.tobytes()) for name, a in sorted(arrays.items())}
        case ".csv" | ".xml" | ".toml":
            return _MODULE.sub("btr_mjx", _PATH.sub('"PATH"', path.read_text(encoding="utf-8")))
    return None


def differences(before: Path, after: Path) -> list[str]:
    """Files of two run folders that differ, one line each."""
    found = []
    for name in sorted({str(p.relative_to(f)) for f in (before, after) for p in f.rglob("*") if p.is_file()}):
        if name.split(os.sep)[0] in _SKIPPED or name.endswith((".png", ".html", ".lock")):
            continue
        pair = before / name, after / name
        missing = [path for path in pair if not path.is_file()]
        if missing:
            found.append(f"{name}: not in {missing[0].parent}")
        elif content(pair[0]) != content(pair[1]):
            found.append(f"{name}: differs")
    return found


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"git {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout.strip()


def compare(config: Config) -> dict[str, list[str]]:
    """Run both versions and compare them.

    Returns:
      Differences by command; empty lists where there are none.

    Raises:
      InputError: an unknown revision or command, or a command that failed.
    """
    names = config.only or tuple(COMMANDS)
    for name in names:
        if name not in COMMANDS:
            raise InputError(f"only: got {name!r}, expected some of {', '.join(COMMANDS)}")
    here, commit = Path(_git("rev-parse", "--show-toplevel")), _git("rev-parse", f"{config.before}^{{commit}}")
    earlier, this = config.out / commit[:12], config.out / "this"
    found = {}
    tree = config.out.resolve() / f"tree-{commit[:12]}"
    try:
        for name in names:
            if not (earlier / name / "result.json").is_file():
                if not tree.is_dir():
                    _git("worktree", "add", "--detach", str(tree), commit)
                note(f"{name}: {commit[:12]}")
                run_command(tree, name, earlier / name, config.out / "cases")
            if config.again or not (this / name / "result.json").is_file():
                note(f"{name}: this version")
                run_command(here, name, this / name, config.out / "cases")
            found[name] = differences(earlier / name, this / name)
    finally:
        if tree.is_dir():
            _git("worktree", "remove", "--force", str(tree))
    return found


def main(argv: list[str] | None = None) -> None:
    """Entry point of the command; exits with 1 where anything differs."""
    config = tyro.cli(Config, args=sys.argv[1:] if argv is None else argv, description=__doc__, prog="same_results.py")
    with cli_errors():
        found = compare(config)
        if config.json is not None:
            write_json(config.json, found)
    for name, lines in found.items():
        print(f"{COMMANDS[name]:45} {'; '.join(lines) or 'the same'}")
    raise SystemExit(1 if any(found.values()) else 0)


if __name__ == "__main__":
    main()
