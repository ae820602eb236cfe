"""Check this installation: `python -m btr_mjx.doctor`.

Checks versions, processor, cores, memory, clock, folders, file locks, devices, that the engines agree, their speed, the
cache of compiled programs and pictures of robots. One line a check: ok, warning (it works, but slower or with less) or
off (something does not work), and the remedy. Takes up to half a minute, longer where programs must be compiled first.

Leaves no files behind but entries of the cache of compiled programs, which the next command uses. The exit code is 1 if
something is off, else 0.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.health import CHECKS, CheckResult, HealthSettings, run_checks

OFF_CODE = 1
"""Exit code where something is off."""


@dataclass(frozen=True)
class DoctorConfig:
    """Settings of the command; every field is a flag."""

    out: Path = Path("runs")
    """Folder in which run folders are kept: its space and its locks are checked. It need not exist."""
    only: tuple[str, ...] = ("all",)
    """Checks to run, by the names in the first column of the output, or "all"."""
    full: bool = False
    """Compare the engine mjx too, which compiles for minutes."""
    json: bool = False
    """Print JSON for scripts: {"ok": ..., "checks": [{"name", "state", "finding", "remedy"}]}."""


def chosen_checks(only: Sequence[str]) -> tuple[str, ...]:
    """Names of the checks to run.

    Raises:
      InputError: a name that is no check.
    """
    for name in only:
        if name not in ("all", *CHECKS):
            raise InputError(f"--only: got {name!r}, expected all, {', '.join(CHECKS)}")
    return tuple(CHECKS) if "all" in only or not only else tuple(only)


def examine_installation(config: DoctorConfig = DoctorConfig()) -> dict[str, CheckResult]:
    """Run checks and print each result as soon as it is there, or all as JSON.

    Raises:
      InputError: a name that is no check.
    """
    names = chosen_checks(config.only)
    results: dict[str, CheckResult] = {}
    if config.full and not config.json:
        print("the engine mjx compiles for some minutes", file=sys.stderr)
    for name, result in run_checks(HealthSettings(config.out, config.full, names)):
        results[name] = result
        if not config.json:
            remedy = f" -> {result.remedy}" if result.remedy else ""
            print(f"{name:10} {result.state:8} {result.finding}{remedy}", flush=True)
    if config.json:
        rows = [{"name": name, **asdict(result)} for name, result in results.items()]
        print(json.dumps({"ok": all(row["state"] != "off" for row in rows), "checks": rows}, indent=2))
    return results


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    argv = sys.argv[1:] if argv is None else list(argv)
    config = tyro.cli(DoctorConfig, args=list(argv), description=__doc__, prog="btr_mjx.doctor")
    results = examine_installation(config)
    if any(result.state == "off" for result in results.values()):
        raise SystemExit(OFF_CODE)


if __name__ == "__main__":
    main()
