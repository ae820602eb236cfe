"""Checks of the machine: processor, cores, memory and clock."""

import os
import platform
import re
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from btr_mjx.health.folders import scratch_folder
from btr_mjx.health.result import CheckResult, worst

GIB = 2**30
"""Bytes of a GiB."""

MEMORY_WARNING, MEMORY_OFF = 2 * GIB, GIB
"""Free memory below which a check warns or fails [bytes]; a scan takes about 0.5 GiB (`benchmarks/scaling.py`)."""

EARLIEST = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
"""A clock before this date is wrong: this version is newer [s since 1970]."""

FILE_CLOCK_TOLERANCE = 10.0
"""Accepted difference between the clocks of this machine and of a file system [s]."""


def measure_processor() -> dict[str, Any]:
    """Name, machine and instruction sets of the processor; None for what this system does not tell."""
    lines = (_read("/proc/cpuinfo") or "").splitlines()
    pairs = [line.partition(":") for line in lines]
    entries = {key.strip().lower(): value.strip() for key, _, value in reversed(pairs)}
    flags = entries.get("flags", entries.get("features"))
    return {
        "name": entries.get("model name") or platform.processor() or platform.machine(),
        "machine": platform.machine(),
        "flags": None if flags is None else flags.split(),
    }


def judge_processor(found: dict[str, Any], features: str) -> CheckResult:
    """Compare the processor's vectors with those that XLA's code uses.

    Args:
      found: see `measure_processor`.
      features: target features of a program compiled by XLA, such as "+avx2,-avx512f".

    Returns:
      off without AVX2 on x86, which libraries of this package need; warning where XLA uses narrower vectors.
    """
    used = vector_width(features)
    if found["machine"].lower() in ("arm64", "aarch64"):
        return CheckResult("ok", f"{found['name']}: NEON; compiled programs use {used} bits")
    flags = found["flags"]
    own = used if flags is None else 512 if "avx512f" in flags else 256 if "avx2" in flags else 128
    name = {512: "AVX-512", 256: "AVX2", 128: "no AVX2"}[own]
    text = f"{found['name']}: {name}; compiled programs use {used} bits"
    if own == 128 and found["machine"].lower() in ("x86_64", "amd64"):
        return CheckResult("off", text, "use a processor with AVX2, or let the virtual machine pass it on")
    if used < own:
        return CheckResult("warning", text, "remove xla_cpu_max_isa from XLA_FLAGS")
    return CheckResult("ok", text)


def vector_width(features: str) -> int:
    """Width of the vectors that LLVM's target features allow [bits]: 512, 256 or 128."""
    return 512 if re.search(r"\+avx512f\b", features) else 256 if re.search(r"\+avx2\b", features) else 128


def measure_cores() -> dict[str, Any]:
    """Cores of the machine, cores that this process may use, quota of its container [cores] and load average."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota, _, period = (_read("/sys/fs/cgroup/cpu.max") or "max").strip().partition(" ")
    return {
        "machine": os.cpu_count() or 1,
        "usable": usable,
        "quota": None if quota == "max" else int(quota) / int(period or 100_000),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0,
    }


def judge_cores(found: dict[str, Any]) -> CheckResult:
    """Judge what `measure_cores` returns.

    Returns:
      off where a container's quota is below half of the cores that programs would use, since its threads then wait for
      one another; warning where other work keeps the cores busy.
    """
    usable, quota = found["usable"], found["quota"]
    text = f"{usable} of {found['machine']} usable"
    if quota is not None and quota < usable / 2:
        cores = max(1, round(quota))
        remedy = f"raise the container's limit, or start commands with: taskset -c 0-{cores - 1}"
        return CheckResult("off", f"{text}, but the container's quota is {quota:g}", remedy)
    if found["load"] > 2 * usable:
        return CheckResult("warning", f"{text}, load average {found['load']:.1f}", "wait until other work has ended")
    return CheckResult("ok", f"{text}, load average {found['load']:.1f}")


def measure_memory() -> dict[str, float | None]:
    """Free and total memory [bytes], within the container's limit; None where this system does not tell."""
    lines = dict(line.split(":", 1) for line in (_read("/proc/meminfo") or "").splitlines() if ":" in line)
    kib = {name: int(value.split()[0]) * 1024 for name, value in lines.items()}
    total, free = kib.get("MemTotal"), kib.get("MemAvailable")
    limit, used = _read("/sys/fs/cgroup/memory.max"), _read("/sys/fs/cgroup/memory.current")
    if limit and used and limit.strip().isdigit():
        total = min(total or int(limit), int(limit))
        free = min(free or total, int(limit) - int(used))
    if total is None and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return {"total": total, "free": free}


def judge_memory(found: dict[str, float | None]) -> CheckResult:
    """Judge what `measure_memory` returns: warning below 2 GiB, off below 1 GiB."""
    total = found["total"]
    free = total if found["free"] is None else found["free"]
    if free is None or total is None:
        return CheckResult("warning", "this system does not tell how much memory is free")
    text = f"{free / GIB:.1f} GiB free of {total / GIB:.1f}"
    remedy = "close other programs or raise the container's limit"
    if free < MEMORY_OFF:
        return CheckResult("off", text, remedy)
    return CheckResult("warning", text, remedy) if free < MEMORY_WARNING else CheckResult("ok", text)


def judge_clock(now: float, file_time: float | None) -> CheckResult:
    """Judge the clock.

    Args:
      now: this machine's time [s since 1970].
      file_time: time that the file system gave to a file written now; None where none could be written.

    Returns:
      off before `EARLIEST`; warning where the file system's clock differs.
    """
    date = datetime.fromtimestamp(now, UTC).isoformat(timespec="seconds")
    results = [CheckResult("ok", date)]
    if now < EARLIEST:
        results.append(CheckResult("off", f"the clock says {date}", "set the clock: timedatectl set-ntp true"))
    if file_time is not None and abs(file_time - now) > FILE_CLOCK_TOLERANCE:
        text = f"files get times that differ from the clock by {file_time - now:+.0f} s"
        results.append(CheckResult("warning", text, "set the clocks of this machine and of the file server (NTP)"))
    return worst(*results)


def measure_clock(folder: Path) -> tuple[float, float | None]:
    """This machine's time and that of a file just written in a folder [s since 1970], see `judge_clock`."""
    try:
        with scratch_folder(folder) as scratch:
            (scratch / "now").write_bytes(b"")
            return time.time(), (scratch / "now").stat().st_mtime
    except OSError:  # the check of the folder reports it
        return time.time(), None


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
