"""Follow README.md as a newcomer does: `uv run python benchmarks/readme.py`.

A clone in an empty folder, a home and caches of its own, nothing installed but Python: every command of the page's
blocks is typed as it stands, in order; the Python recipe runs as a script. A command that is to be typed "in another
terminal" runs beside the one before it. A table has the time of each; the exit code is 1 where one fails.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import tyro

from btr_mjx.errors import cli_errors
from btr_mjx.runs import write_json

ROOT = Path(__file__).parents[1]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)


@dataclass(frozen=True)
class ReadmeConfig:
    """Settings; every field is a flag."""

    folder: Path | None = None
    """Folder of the clone; by default one that is removed at the end."""
    json: Path | None = None
    """Also write the times to this file."""


def steps_of(text: str) -> list[list[str]]:
    """The commands of a page, each with those that run beside it."""
    steps: list[list[str]] = []
    for language, block in _FENCE.findall(text):
        if language == "python":
            steps.append([f"uv run python - <<'RECIPE'\n{block}RECIPE"])
            continue
        for line in block.replace("\\\n", " ").splitlines():
            command, _, comment = line.partition(" #")
            if "in another terminal" in comment:
                steps[-1].append(command.strip())
            elif command.strip():
                steps.append([command.strip()])
    return steps


def _newcomer(folder: Path) -> Mapping[str, str]:
    """Environment variables of somebody who has Python and git only."""
    venv.create(folder / "python", with_pip=True)
    network = ("UV_", "PIP_", "SSL_", "HTTP", "http", "NO_PROXY", "no_proxy")  # how packages are reached from here
    kept = {k: v for k, v in os.environ.items() if k in ("LANG", "TERM", "MUJOCO_GL") or k.startswith(network)}
    kept.pop("UV_CACHE_DIR", None)
    home = folder / "home"
    home.mkdir()
    own = [folder / "python" / "bin", Path(sys.base_prefix) / "bin"]
    path = os.pathsep.join([*map(str, own), "/usr/local/bin", "/usr/bin", "/bin"])
    return kept | {"HOME": str(home), "PATH": path, "XDG_CACHE_HOME": str(home / ".cache")}


def _run(step: list[str], folder: Path, env: Mapping[str, str]) -> tuple[float, int, str]:
    """Seconds, exit code and the last lines of a step's first command."""
    start = time.perf_counter()
    first, *others = [
        subprocess.Popen(
            command,
            shell=True,
            cwd=folder,
            env=dict(env),
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        for command in step
    ]
    output, _ = first.communicate()
    for other in others:
        os.killpg(other.pid, signal.SIGTERM)
        other.communicate()
    return time.perf_counter() - start, first.returncode, "\n".join(output.splitlines()[-12:])


def follow(folder: Path) -> list[dict[str, object]]:
    """Type every command in a clone inside `folder`."""
    env, clone = _newcomer(folder), folder / "btr_mjx"
    subprocess.run(["git", "clone", "--quiet", "--depth", "1", ROOT.as_uri(), clone], check=True)
    rows = []
    for step in steps_of((clone / "README.md").read_text(encoding="utf-8")):
        seconds, code, tail = _run(step, clone, env)
        shown = step[0].splitlines()[0]
        print(f"{seconds:7.1f} s   exit code {code}   {shown}", flush=True)
        if code:
            print(tail, flush=True)
        rows.append({"command": shown, "seconds": seconds, "exit_code": code})
    return rows


def main() -> None:
    """Run the benchmark."""
    config = tyro.cli(ReadmeConfig, description=__doc__)
    with cli_errors(), tempfile.TemporaryDirectory() as temporary:
        folder = config.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rows = follow(folder.resolve())
        minutes = sum(float(str(row["seconds"])) for row in rows) / 60
        failed = sum(row["exit_code"] != 0 for row in rows)
        print(f"{len(rows)} commands, {minutes:.1f} minutes, {failed} failed")
        if config.json:
            write_json(config.json, {"commands": rows, "minutes": minutes})
    sys.exit(min(failed, 1))


if __name__ == "__main__":
    main()
