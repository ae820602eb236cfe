"""Check of versions: what the package requires, and releases of jaxlib that are known to be slow."""

import platform
import re
from importlib import metadata

from btr_mjx.health.result import CheckResult, worst

DISTRIBUTION = "btr-mjx"
"""Name of this package's distribution."""

SHOWN_VERSIONS = ("btr-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy")
"""Distributions whose versions are printed."""

SLOW_JAXLIB = {"0.10.2": 16.0, "0.11.0": 16.0, "0.11.2": 2.3}
"""Releases of jaxlib that run `lanes` so many times slower than 0.12.0 (`uv run python benchmarks/throughput.py`)."""


def measure_versions() -> dict[str, str | None]:
    """Installed version of Python, of this package and of all that it requires; None where it is not installed."""
    from packaging.requirements import Requirement

    names = [*SHOWN_VERSIONS, *(Requirement(line).name for line in _requirements())]
    return {"python": platform.python_version()} | {name: _version(name) for name in dict.fromkeys(names)}


def judge_versions(installed: dict[str, str | None]) -> CheckResult:
    """Compare versions with the requirements of this package's distribution.

    Args:
      installed: version by distribution and "python", see `measure_versions`.

    Returns:
      off where a requirement is not met, mujoco and mujoco-mjx differ or jaxlib is one of `SLOW_JAXLIB`.
    """
    from packaging.requirements import Requirement
    from packaging.specifiers import SpecifierSet

    shown = ", ".join(f"{name} {installed.get(name)}" for name in ("python", *SHOWN_VERSIONS))
    found = [CheckResult("ok", shown)]
    if installed.get(DISTRIBUTION) is None:
        return CheckResult("off", f"{DISTRIBUTION} is not installed in this environment", "uv sync")
    needed = metadata.metadata(DISTRIBUTION)["Requires-Python"]
    if needed and not SpecifierSet(needed).contains(str(installed["python"]), prereleases=True):
        found.append(
            CheckResult(
                "off",
                f"Python {installed['python']}, expected {needed}",
                f"uv python install {_lowest(needed)}; uv sync",
            )
        )
    for line in _requirements():
        requirement = Requirement(line)
        version = installed.get(requirement.name)
        if version is None:
            found.append(CheckResult("off", f"{requirement.name} is not installed", f"pip install '{requirement}'"))
        elif not requirement.specifier.contains(version, prereleases=True):
            text = f"{requirement.name} {version}, expected {requirement.specifier}"
            found.append(CheckResult("off", text, f"pip install '{requirement}'"))
    if installed.get("mujoco") != installed.get("mujoco-mjx"):
        text = f"mujoco {installed.get('mujoco')} beside mujoco-mjx {installed.get('mujoco-mjx')}, expected one version"
        found.append(CheckResult("off", text, f"pip install mujoco-mjx=={installed.get('mujoco')}"))
    if slower := SLOW_JAXLIB.get(str(installed.get("jaxlib"))):
        text = f"jaxlib {installed['jaxlib']} runs the engine lanes about {slower:g} times slower than 0.12.0"
        found.append(CheckResult("off", text, "pip install --upgrade 'jax>=0.12' 'jaxlib>=0.12'"))
    return worst(*found)


def _requirements() -> list[str]:
    """Requirements of this package that apply here, without those of extras."""
    from packaging.requirements import Requirement

    try:
        lines = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return []
    parsed = [(line, Requirement(line).marker) for line in lines]
    return [line for line, marker in parsed if marker is None or marker.evaluate({"extra": ""})]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _lowest(specifier: str) -> str:
    found = re.search(r"\d+\.\d+", specifier)
    return found.group() if found else "3.12"
