"""The checks of an installation, and the function that runs them."""

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from btr_mjx.errors import one_line
from btr_mjx.runs import atomic_write, package_version

DISTRIBUTION = "btr-mjx"
"""Name of this package's distribution."""

SHOWN_VERSIONS = ("btr-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy")
"""Distributions whose versions are printed."""

FREE_SPACE = 1 << 30
"""Free space of a disk below which a check warns [bytes]; a run of the paper's settings saves tens of MiB."""

ENGINE_CHECKS = ("devices", "engines", "speed")
"""Checks that load JAX and MuJoCo; `btr_mjx.health.engine_checks` has their functions."""

ENGINE_TIMEOUT = 600.0
"""Time for all of these checks; the engines compile for about half a minute [s]."""

MARK = "btr_mjx.health: "
"""Start of a result's line in what the process of these checks prints; libraries may print other lines."""


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check.

    Attributes:
      state: ok: as expected. warning: the package works, but slower or with less. off: something does not work.
      finding: what was found, in one line.
      remedy: what to do about it; empty where nothing needs to be done.
    """

    state: Literal["ok", "warning", "off"]
    finding: str
    remedy: str = ""


def check_versions() -> CheckResult:
    """Versions of Python and of all that this package's distribution requires; warns of a release known to err."""
    from packaging.requirements import Requirement
    from packaging.specifiers import SpecifierSet

    try:
        needed = [Requirement(line) for line in metadata.requires(DISTRIBUTION) or []]
        python = metadata.metadata(DISTRIBUTION)["Requires-Python"] or ""
    except metadata.PackageNotFoundError:
        return CheckResult("off", f"{DISTRIBUTION} is not installed in this environment", "uv sync")
    wrong = {}
    if not SpecifierSet(python).contains(platform.python_version(), prereleases=True):
        wrong[f"Python {platform.python_version()}, expected {python}"] = f"install Python {python}"
    for one in needed:
        if one.marker is not None and not one.marker.evaluate({"extra": ""}):
            continue
        version = package_version(one.name)
        if version is None:
            wrong[f"{one.name} is not installed"] = f"pip install '{one}'"
        elif not one.specifier.contains(version, prereleases=True):
            wrong[f"{one.name} {version}, expected {one.specifier}"] = f"pip install '{one}'"
    if wrong:
        return CheckResult("off", "; ".join(wrong), "; ".join(dict.fromkeys(wrong.values())))
    if package_version("mujoco") == "4.0.0":
        finding = "mujoco 4.0.0, whose solver errs where Jacobians are sparse (from 60 degrees of freedom on)"
        return CheckResult("warning", finding, "pip install 'mujoco!=4.0.0'")
    shown = [f"{name} {package_version(name)}" for name in SHOWN_VERSIONS]
    return CheckResult("ok", ", ".join([f"python {platform.python_version()}", *shown]))


def check_folder(folder: Path) -> CheckResult:
    """Write a file where run folders are kept, or in the nearest folder above that exists."""
    folder = folder.absolute()
    folder = next(place for place in (folder, *folder.parents) if place.exists())
    probe = folder / f".btr_mjx-{os.getpid()}"
    try:
        with atomic_write(probe) as file:
            file.write(bytes(1 << 20))
        probe.unlink()
    except OSError as error:
        return CheckResult("off", f"{folder} cannot be written to: {error.strerror or error}", "choose another --out")
    free = shutil.disk_usage(folder).free
    text = f"{folder}: {free / 2**30:.1f} GiB free"
    return CheckResult("ok", text) if free >= FREE_SPACE else CheckResult("warning", text, "delete files")


def run_engine_checks(names: Sequence[str], timeout: float = ENGINE_TIMEOUT) -> Mapping[str, CheckResult]:
    """Run some of `ENGINE_CHECKS` in a process of their own, which may crash, or hang until the timeout [s]."""
    output: str | bytes | None
    try:
        done = subprocess.run(
            [sys.executable, "-m", "btr_mjx.health.engine_checks", *names],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout,
        )
        output, end = done.stdout, _ending(done.returncode, done.stderr)
    except subprocess.TimeoutExpired as expired:
        output, end = expired.stdout, f"no answer within {timeout:g} s"
    text = output.decode("utf-8", "replace") if isinstance(output, bytes) else output or ""
    found = [json.loads(line.removeprefix(MARK)) for line in text.splitlines() if line.startswith(MARK)]
    results = {name: CheckResult(**result) for one in found for name, result in one.items()}
    missing = CheckResult("off", f"could not be checked ({end})", remedy_of_environment())
    return {name: results.get(name, missing) for name in names}


def _ending(code: int, errors: str) -> str:
    """How a process ended, with the last line that it wrote to stderr."""
    named = -code in signal.valid_signals()
    how = f"the process was ended by {signal.Signals(-code).name}" if named else f"the process ended with {code}"
    return ": ".join([how, *[line.strip() for line in errors.splitlines() if line.strip()][-1:]])


def remedy_of_environment() -> str:
    """What to try where a library fails to load or to start: settings of the environment first."""
    names = [name for name in sorted(os.environ) if name.startswith(("MUJOCO_GL", "XLA_", "JAX_"))]
    if names:
        return f"unset {' '.join(names)} and try again"
    return "reinstall: uv sync --reinstall, or pip install --force-reinstall btr-mjx"


def run_check(check: Callable[[], CheckResult]) -> CheckResult:
    """The result of a check; an error that it does not foresee is reported and does not end the command."""
    try:
        return check()
    except Exception as error:
        return CheckResult(
            "off", f"could not be checked ({type(error).__name__}: {one_line(error)})", remedy_of_environment()
        )


CHECKS = ("versions", "runs", *ENGINE_CHECKS)
"""Names of the checks, in the order of the output: what costs nothing first."""


def run_checks(folder: Path, names: Sequence[str]) -> Iterator[tuple[str, CheckResult]]:
    """Names and results of checks, in the order of `CHECKS`; `folder` is where run folders are kept."""
    if "versions" in names:
        yield "versions", run_check(check_versions)
    if "runs" in names:
        yield "runs", run_check(lambda: check_folder(folder))
    if chosen := [name for name in ENGINE_CHECKS if name in names]:
        yield from run_engine_checks(chosen).items()
