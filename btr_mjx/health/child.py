"""Runs the probes in a process of their own and reads what they measured."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import Any

MARK = "btr_mjx.health: "
"""Start of a line of measurements; libraries may print other lines."""


class CannotCheck(Exception):
    """A section could not be measured; the message says why."""


def run_probes(sections: Sequence[str], timeout: float) -> dict[str, dict[str, Any]]:
    """Measure sections in a new process of this Python, with this environment and working directory.

    Args:
      sections: arguments of `btr_mjx.health.probes`.
      timeout: time after which the process is killed [s].

    Returns:
      {"result": ...} or {"error": why there is none} by section.
    """
    output: str | bytes
    command = [sys.executable, "-m", "btr_mjx.health.probes", *sections]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, encoding="utf-8", errors="replace"
        )
        output, end = done.stdout, _ending(done.returncode, done.stderr)
    except subprocess.TimeoutExpired as expired:
        output = expired.stdout or b""
        end = f"no answer within {timeout:g} s"
    except OSError as error:
        output, end = "", f"{sys.executable} cannot be started: {error.strerror}"
    text = output.decode("utf-8", "replace") if isinstance(output, bytes) else output
    lines = [json.loads(line.removeprefix(MARK)) for line in text.splitlines() if line.startswith(MARK)]
    found = {line.pop("section"): line for line in lines}
    return {section: found.get(section, {"error": end}) for section in sections}


def measured(reports: Mapping[str, Mapping[str, Any]], section: str) -> dict[str, Any]:
    """What a section measured.

    Raises:
      CannotCheck: it measured nothing.
    """
    report = reports[section]
    if "error" in report:
        raise CannotCheck(report["error"])
    return dict(report["result"])


def remedy_of_environment() -> str:
    """What to try where a library fails to load or to start: settings of the environment first."""
    names = [name for name in sorted(os.environ) if name.startswith(("MUJOCO_GL", "XLA_", "JAX_"))]
    if names:
        return f"unset {' '.join(names)} and try again"
    return "reinstall: uv sync --reinstall, or pip install --force-reinstall btr-mjx"


def _ending(code: int, errors: str) -> str:
    """How a process ended, with the last line that it wrote to stderr."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    last = f": {lines[-1]}" if lines else ""
    if code < 0:
        try:
            return f"the process was ended by {signal.Signals(-code).name}{last}"
        except ValueError:
            return f"the process was ended by signal {-code}{last}"
    return f"the process ended with exit code {code}{last}"
