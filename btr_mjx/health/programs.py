"""Checks of what runs: devices, compiled programs and their cache, agreement and speed of engines, pictures."""

import os
from pathlib import Path
from typing import Any

from btr_mjx.health.machine import vector_width
from btr_mjx.health.result import CheckResult, worst

TOLERANCE = {"float32": 1e-4, "float64": 1e-8}
"""Accepted difference between an engine and native MuJoCo, by the engine's precision [m, rad].

Over the few tenths of a second that are simulated, rounding errors stay a hundred times below.
"""

LANES_RATE = {512: 685_000, 256: 600_000, 128: 300_000}
"""Expected steps of the hexapod per second and core of `lanes`, by vector width [bits].

512: half of the two cores' rate of `uv run python benchmarks/throughput.py`, 256: by the same command's ratio to native
MuJoCo on AVX2. 128 is assumed, not measured.
"""

NATIVE_RATE = 55_000
"""Expected steps of the hexapod per second and core of native MuJoCo (the same command)."""

LANES_RATIO = {512: 12.6, 256: 10.9, 128: 5.5}
"""Expected ratio of `lanes` to native MuJoCo, by vector width [bits] (the same command); 128 is assumed."""

SLOW, FAR_TOO_SLOW = 3.0, 8.0
"""How many times slower than expected a check warns or fails; other processors and other work take up to the first."""


def judge_devices(found: dict[str, Any], cores: int, accelerator: bool) -> CheckResult:
    """Judge the devices that JAX sees.

    Args:
      found: section "devices" of the probes.
      cores: cores that this process may use.
      accelerator: whether this machine shows an accelerator.

    Returns:
      off without devices, warning where an accelerator is not used or where there are fewer CPU devices than cores.
    """
    text = f"{found['count']} x {found['platform']} ({found['kind']})"
    if not found["count"]:
        return CheckResult("off", "JAX sees no device", "unset JAX_PLATFORMS; uv sync --reinstall")
    if found["platform"] != "cpu":
        return CheckResult("ok", text)
    results = [CheckResult("ok", text)]
    if accelerator:
        remedy = "to use it: pip install 'jax[cuda13]'; the engine lanes runs on the CPU without it"
        results.append(CheckResult("warning", f"{text}, but there is an NVIDIA GPU", remedy))
    if found["count"] < cores:
        text = f"{text} for {cores} cores: batches use {found['count']} of them"
        remedy = "remove jax_num_cpu_devices and --xla_force_host_platform_device_count from the settings"
        results.append(CheckResult("warning", text, remedy))
    return worst(*results)


def has_accelerator() -> bool:
    """Whether the operating system shows an NVIDIA GPU."""
    return Path("/dev/nvidia0").exists()


def judge_cache(written: dict[str, Any], read: dict[str, Any] | None) -> CheckResult:
    """Judge whether what one process compiles is found by the next.

    Args:
      written: section "cache" of the first process.
      read: likewise of a second one; None where there is no cache.

    Returns:
      off where there is no folder or nothing is found in it, warning where the user switched the cache off.
    """
    if not written["enabled"]:
        text = "switched off: every process compiles its programs again (about 15 s)"
        return CheckResult("warning", text, "unset JAX_ENABLE_COMPILATION_CACHE")
    remedy = "make its folder writable, free space there, or set XDG_CACHE_HOME to another folder"
    if written["folder"] is None or read is None:
        home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
        return CheckResult("off", f"no folder can be made in {home}: every process compiles again (15 s)", remedy)
    if not read["hit"]:
        text = f"{written['folder']}: a program saved by one process is not found by the next"
        return CheckResult("off", text, remedy)
    return CheckResult("ok", f"{written['folder']}: written, and read by another process")


def judge_agreement(found: dict[str, Any]) -> CheckResult:
    """Judge the differences between engines (section "agreement"): off beyond `TOLERANCE`, or where not finite."""
    allowed = TOLERANCE[found["precision"]]
    parts, results = [], []
    for robot, differences in found["difference"].items():
        for engine, value in differences.items():
            parts.append(f"{engine} {robot} {value:.1e}")
            if not value <= allowed:  # NaN counts as too far
                text = f"{engine} differs from native MuJoCo by {value:.2g} for the {robot}, expected {allowed:g}"
                remedy = "remove XLA_FLAGS; use --engine native; report it with the output of this command"
                results.append(CheckResult("off", text, remedy))
    return worst(CheckResult("ok", f"against native, {found['precision']}: {', '.join(parts)}"), *results)


def judge_speed(found: dict[str, Any], width: int | None) -> CheckResult:
    """Judge the rates of engines.

    Args:
      found: section "speed" of the probes.
      width: of the vectors that compiled programs use [bits]; None where `lanes` does not run on the CPU.

    Returns:
      off where `lanes` is `FAR_TOO_SLOW` times slower against native MuJoCo than expected, which other work on the
      machine does not change; warning where that ratio or a rate per core is `SLOW` times below the expected.
    """
    lanes, native = found["lanes"] / found["cores"], found["native"] / found["cores"]
    shown = f"steps/s per core: lanes {lanes:,.0f}, native {native:,.0f}, ratio {lanes / native:.1f}"
    if width is None:
        return CheckResult("ok", shown)
    late = {
        name: expected / value
        for name, value, expected in (
            ("ratio", lanes / native, LANES_RATIO[width]),
            ("lanes", lanes, LANES_RATE[width]),
            ("native", native, NATIVE_RATE),
        )
        if value * SLOW < expected
    }
    if not late:
        return CheckResult("ok", shown)
    text = f"{shown}; {', '.join(f'{name} {times:.1f}' for name, times in late.items())} times below the expected"
    if "ratio" in late:
        remedy = "install the versions of uv.lock (uv sync), remove XLA_FLAGS"
        return CheckResult("off" if late["ratio"] > FAR_TOO_SLOW else "warning", text, remedy)
    return CheckResult("warning", text, "wait until other work has ended, or use a faster machine")


def width_of(devices: dict[str, Any]) -> int | None:
    """Vector width of compiled programs [bits], None where JAX does not run on the CPU."""
    return vector_width(devices["features"]) if devices["platform"] == "cpu" else None


def judge_pictures(found: dict[str, Any]) -> CheckResult:
    """Judge section "pictures": warning where robots are not rendered."""
    if found["backend"] is None:
        asked = f"MUJOCO_GL={found['asked']} does not render" if found["asked"] else "neither EGL nor OSMesa works"
        remedy = "unset MUJOCO_GL" if found["asked"] else "on Debian: apt install libegl1; elsewhere: a driver with EGL"
        return CheckResult("warning", f"{asked}: no pictures of robots, no films", remedy)
    return CheckResult("ok", f"rendered with {found['backend'] or 'the default of the system'}")
