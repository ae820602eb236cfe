"""Check this installation: `python -m btr_mjx.doctor`.

Checks versions, the folder of runs, devices, that the engines lanes and mjx agree with native MuJoCo, and their speed.
One line a check: ok, warning (it works, but slower or with less) or off (something does not work), and the remedy.
Takes about a minute the first time, to compile.

Leaves no files behind but entries of the cache of compiled programs, which the next command uses. The exit code is 1 if
something is off, else 0.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.health import CHECKS, CheckResult, run_checks
from btr_mjx.runs import parsed

OFF_CODE = 1
"""Exit code where something is off."""


@dataclass(frozen=True)
class DoctorConfig:
    """Settings of the command; every field is a flag."""

    out: Path = Path("runs")
    """Folder in which run folders are kept: whether it can be written to, and its space. It need not exist."""
    only: tuple[str, ...] = ("all",)
    """Checks to run, by the names in the first column of the output, or "all"."""
    json: bool = False
    """Print JSON for scripts: {"ok": ..., "checks": [{"name", "state", "finding", "remedy"}]}."""


def examine_installation(config: DoctorConfig = DoctorConfig()) -> dict[str, CheckResult]:
    """Run checks and print each result, or all as JSON.

    Raises:
      InputError: a name that is no check.
    """
    for name in config.only:
        if name not in ("all", *CHECKS):
            raise InputError(f"--only: got {name!r}, expected all, {', '.join(CHECKS)}")
    names = CHECKS if "all" in config.only or not config.only else config.only
    results: dict[str, CheckResult] = {}
    for name, result in run_checks(config.out, names):
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
    config = parsed(DoctorConfig, argv, description=__doc__, prog="btr_mjx.doctor")
    results = examine_installation(config)
    if any(result.state == "off" for result in results.values()):
        raise SystemExit(OFF_CODE)


if __name__ == "__main__":
    main()
