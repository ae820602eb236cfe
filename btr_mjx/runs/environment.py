"""Description of what a result may depend on besides the config: versions, machine, devices, source code."""

import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("btr-mjx", "numpy", "scipy", "jax", "jaxlib", "mujoco", "mujoco-mjx")
"""Distributions whose versions are recorded."""

COMPARED = ("python", "versions", "machine", "processor", "cpus_usable", "devices", "settings", "git")
"""Entries whose change is reported on resume, since it can change results."""


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


COMPILER_OPTIONS = "--xla_backend_extra_options=xla_slp_vectorizer_disabled,xla_cpu_disable_loop_unrolling"
"""Options that this package adds to XLA_FLAGS: without LLVM's loop unrolling and SLP vectoriser.

A step of `lanes` is one function of hundreds of short loops that are vectorised already: these passes double the
machine code and the compile time, and the larger code runs slower since it exceeds the instruction cache.
"""


def describe_environment() -> dict[str, Any]:
    """Describe this process and the machine it runs on, without importing jax or starting a device.

    Returns:
      A JSON-able dict: python, versions (null: not installed), system, machine, processor, cpus, cpus_usable, devices
      (null: jax is not running), settings (environment variables of jax and XLA), git (commit and whether the tree
      differs from it, or null), start (UTC), argv and pid.
    """
    return {
        "python": platform.python_version(),
        "versions": {name: package_version(name) for name in PACKAGES},
        "system": platform.platform(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cpus": os.cpu_count(),
        "cpus_usable": available_cores(),
        "devices": _running_devices(),
        "settings": _settings(),
        "git": git_state(Path(__file__).parent),
        "start": datetime.now(UTC).isoformat(timespec="seconds"),
        "argv": list(sys.argv),
        "pid": os.getpid(),
    }


def _settings() -> dict[str, str]:
    """Environment variables of JAX and XLA, without the options that this package adds when it starts JAX."""
    own = {name: os.environ[name].replace(COMPILER_OPTIONS, "").strip() for name in sorted(os.environ)}
    return {name: value for name, value in own.items() if name.startswith(("XLA_", "JAX_")) and value}


def environment_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two descriptions and can change results, one short line each."""
    changes = []
    for name in COMPARED:
        a, b = before.get(name), now.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            parts = [key for key in {**a, **b} if a.get(key) != b.get(key)]
            changes += [f"{key} changed from {a.get(key)} to {b.get(key)}" for key in parts]
        elif a != b and (name != "devices" or (a and b)):  # no devices were recorded if jax started later
            changes.append(f"{name} changed from {a} to {b}")
    return changes


def package_version(name: str) -> str | None:
    """Version of an installed distribution, None where it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def git_state(folder: Path) -> dict[str, Any] | None:
    """The commit that `folder` is checked out from and whether files differ from it; None where it is not tracked.

    A folder that lies inside a repository but is not tracked (an environment with this package installed) has no
    commit.
    """
    if not _git(folder, "ls-files", "."):
        return None
    commit = _git(folder, "rev-parse", "HEAD")
    status = _git(folder, "status", "--porcelain")
    return None if not commit or status is None else {"commit": commit, "dirty": bool(status)}


def _git(folder: Path, *arguments: str) -> str | None:
    command = ["git", "--no-optional-locks", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.decode("utf-8", "replace").strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _running_devices() -> list[str] | None:
    # Asking jax for its devices would start its backends with the present flags.
    bridge = sys.modules.get("jax._src.xla_bridge")
    started = getattr(bridge, "backends_are_initialized", None)
    try:
        found = sys.modules["jax"].devices() if started is not None and started() else None
    except Exception:  # private names may change; the description must not make a run fail
        return None
    return found and [f"{device.platform}:{device.id} {device.device_kind}" for device in found]
