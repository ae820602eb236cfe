"""All checks of the installation, and the function that runs them."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from secrets import token_hex
from typing import Any

from btr_mjx.errors import one_line
from btr_mjx.health import folders, machine, programs, versions
from btr_mjx.health.child import CannotCheck, measured, remedy_of_environment, run_probes
from btr_mjx.health.result import CheckResult

PROBE_TIMEOUT, FULL_PROBE_TIMEOUT = 240.0, 1200.0
"""Time for all measurements of one process, without and with `mjx`, which compiles for minutes [s]."""


@dataclass
class HealthSettings:
    """Settings and shared measurements of one run of the checks.

    Attributes:
      folder: where run folders are kept.
      full: compare the engine mjx too.
      names: the checks that will run: only what they need is measured.
      token: name of the program by which the cache of compiled programs is tested.
      reports: what processes have measured, by section.
    """

    folder: Path = Path("runs")
    full: bool = False
    names: tuple[str, ...] = ()
    token: str = field(default_factory=lambda: f"btr_mjx_doctor_{token_hex(6)}")
    reports: dict[str, dict[str, Any]] = field(default_factory=dict)

    def section(self, name: str) -> str:
        """The section of the probes of a kind: "agreement", "written" and "read" have arguments."""
        arguments = {
            "agreement": "agreement:lanes:mjx" if self.full else "agreement:lanes",
            "written": f"cache:{self.token}:first",
            "read": f"cache:{self.token}:second",
        }
        return arguments.get(name, name)

    def groups(self) -> list[list[str]]:
        """Sections of each process that is needed; the first one runs before the others."""
        groups: list[list[str]] = [[], [], []]
        for kinds, needed_by, group in SECTIONS_NEEDED:
            if not set(needed_by).isdisjoint(self.names):
                groups[group].append(self.section(kinds))
        return groups


SECTIONS_NEEDED = (
    ("devices", ("processor", "devices", "speed"), 0),
    ("written", ("cache",), 0),
    ("agreement", ("engines",), 0),
    ("speed", ("speed",), 0),
    ("read", ("cache",), 1),
    ("pictures", ("pictures",), 2),
)
"""Sections of the probes, the checks that need them and the process that measures them."""


def _probe(settings: HealthSettings, name: str) -> dict[str, Any]:
    """What a section measured.

    Each process runs once, when the first of its sections is asked for. Speed is measured while nothing else runs; the
    processes after that run side by side.
    """
    section, timeout = settings.section(name), FULL_PROBE_TIMEOUT if settings.full else PROBE_TIMEOUT
    if section not in settings.reports:
        first, *others = settings.groups()
        groups = [first] if section in first else [group for group in others if group]
        with ThreadPoolExecutor() as pool:
            for report in pool.map(lambda group: run_probes(group, timeout), groups):
                settings.reports |= report
    return measured(settings.reports, section)


def _processor(settings: HealthSettings) -> CheckResult:
    return machine.judge_processor(machine.measure_processor(), _probe(settings, "devices")["features"])


def _devices(settings: HealthSettings) -> CheckResult:
    cores = machine.measure_cores()["usable"]
    return programs.judge_devices(_probe(settings, "devices"), cores, programs.has_accelerator())


def _cache(settings: HealthSettings) -> CheckResult:
    written = _probe(settings, "written")
    usable = written["enabled"] and written["folder"] is not None
    return programs.judge_cache(written, _probe(settings, "read") if usable else None)


def _remove_entries(settings: HealthSettings) -> None:
    """Remove what the check has added to the cache of compiled programs."""
    folder = settings.reports.get(settings.section("written"), {}).get("result", {}).get("folder")
    for path in Path(folder).glob(f"*{settings.token}*") if folder else ():
        path.unlink(missing_ok=True)


def _speed(settings: HealthSettings) -> CheckResult:
    return programs.judge_speed(_probe(settings, "speed"), programs.width_of(_probe(settings, "devices")))


CHECKS: Mapping[str, Callable[[HealthSettings], CheckResult]] = {
    "versions": lambda _: versions.judge_versions(versions.measure_versions()),
    "cores": lambda _: machine.judge_cores(machine.measure_cores()),
    "memory": lambda _: machine.judge_memory(machine.measure_memory()),
    "clock": lambda settings: machine.judge_clock(*machine.measure_clock(settings.folder)),
    "runs": lambda settings: folders.judge_space(folders.measure_space(settings.folder), "choose another --out"),
    "tmp": lambda _: folders.judge_space(folders.measure_space(Path(tempfile.gettempdir())), "set TMPDIR"),
    "locks": lambda settings: folders.judge_locks(folders.measure_locks(settings.folder)),
    "processor": _processor,
    "devices": _devices,
    "engines": lambda settings: programs.judge_agreement(_probe(settings, "agreement")),
    "speed": _speed,
    "cache": _cache,
    "pictures": lambda settings: programs.judge_pictures(_probe(settings, "pictures")),
}
"""Checks by name, in the order of the output: what costs nothing first."""


def run_checks(settings: HealthSettings) -> Iterator[tuple[str, CheckResult]]:
    """Run the checks that the settings name, in the order of `CHECKS`.

    Yields:
      Name and result of each. A check that fails itself yields "off: could not be checked".
    """
    try:
        for name in CHECKS:
            if name in settings.names:
                yield name, run_check(partial(CHECKS[name], settings))
    finally:
        _remove_entries(settings)


def run_check(check: Callable[[], CheckResult]) -> CheckResult:
    """The result of a check; any error of its own is a result that is off."""
    try:
        return check()
    except CannotCheck as reason:
        return CheckResult("off", f"could not be checked ({reason})", remedy_of_environment())
    except Exception as error:  # a fault that no check foresees must be reported, not end the command
        text = f"could not be checked ({type(error).__name__}: {one_line(error)})"
        return CheckResult("off", text, "report it with the output of this command")
