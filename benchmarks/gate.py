"""Freeze the answers of a version of the search to many hidden cases, and compare two versions case by case.

    uv run python benchmarks/gate.py --suites hexapod pendulum --json before.json     # answers of this code, kept
    uv run python benchmarks/gate.py --suites hexapod pendulum --against before.json  # or a code digest: kept answers
    uv run python benchmarks/gate.py --compare before.json after.json                 # runs nothing

`gates/suites.py` lists the suites. A case is made once and kept, fixed by its seed. An answer is kept under the digest
of the code that computed it: unchanged code solves no case again, and the same command continues a killed run. A
checkout of another commit shares both through `--out`. An answer is right if all that is hidden is named and nothing
else; suites of laws, changes and drives judge numbers. Two versions are compared with McNemar's exact test, and by the
geometric mean of the ratios of their CPU time. `benchmarks/baselines/` has answers of version 0.1.0, of another
processor, to `hexapod` (40), `pairs` (12), and `quadruped`, `arm` and `pendulum` (20). Exit code: 1 where a case has no
answer, 2 for bad input.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tyro
from gates.answers import CODE
from gates.cases import Case, in_processes
from gates.pairing import paired, show_pairs
from gates.rows import NO_ANSWER, Row, show
from gates.suites import SUITES

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, progress, read_json, write_json


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    suites: tuple[str, ...] = ("hexapod", "quadruped", "arm", "pendulum", "pairs")
    """Names of suites."""
    cases: int | None = None
    """Number of cases of each suite; by default its own."""
    seed: int | None = None
    """Seed of the cases; by default that of each suite. Others are fresh cases."""
    workers: int = 2
    """Number of processes at a time; several get one core each."""
    limit: float = 1800.0
    """Time after which the process of a case is killed [s]; the case has no answer then."""
    out: Path = Path("runs/gate")
    """Folder of the cases and of the answers of all versions."""
    json: Path | None = None
    """Write rows and answers here."""
    against: str | None = None
    """Earlier version to compare with: a file written by --json, or the code digest of kept answers."""
    compare: tuple[Path, Path] | None = None
    """Two files written by --json: compare their rows and run nothing."""


def check(config: Config) -> None:
    """Check settings.

    Raises:
      InputError: an unknown suite, or a number out of range.
    """
    for name in config.suites:
        if name not in SUITES:
            raise InputError(f"--suites: there is no suite {name}; known are {', '.join(SUITES)}")
    for name, least in (("cases", 1), ("seed", 0), ("workers", 1)):
        value = getattr(config, name)
        if value is not None and value < least:
            raise InputError(f"--{name}: got {value}, expected at least {least}")
    if not config.limit > 0:
        raise InputError(f"--limit: got {config.limit:g}, expected more than 0 s")


def cases_of(config: Config) -> list[Case]:
    """The cases that are asked for."""
    suites = [SUITES[name] for name in dict.fromkeys(config.suites)]
    seeds = [suite.seed if config.seed is None else config.seed for suite in suites]
    return [
        Case(suite, seed, index, config.out)
        for suite, seed in zip(suites, seeds, strict=True)
        for index in range(config.cases or suite.cases)
    ]


def saved(path: str | Path, *keys: str) -> dict[str, Any]:
    """Content of a file written by --json.

    Raises:
      InputError: another file.
    """
    content = read_json(path)
    if not isinstance(content, dict) or not set(keys) <= set(content):
        raise InputError(f"{path}: expected a file written by --json of this benchmark")
    return content


def earlier_answers(config: Config, cases: Sequence[Case]) -> dict[str, dict[str, Any]]:
    """Answers of the version to compare with, by case name.

    Saved answers may belong to recordings that differ in the last bits: other processors round differently.

    Raises:
      InputError: neither a file of this benchmark, nor a code digest of which there are answers.
    """
    against, folder = str(config.against), config.out / "answers"
    if not re.fullmatch("[0-9a-f]{12}", against):
        return dict(saved(against, "answers")["answers"])
    known = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    if against not in known:
        raise InputError(f"--against {against}: {folder} has answers of {', '.join(known) or 'no version'}")
    kept = {case.name: replace(case, version=against).kept() for case in cases}
    return {name: answer for name, answer in kept.items() if answer}


def solve_cases(cases: Sequence[Case], workers: int, limit: float) -> None:
    """Make the cases that are missing, and solve those without an answer of this code; see `in_processes`."""
    unmade = [case for case in cases if not case.truth.is_file()]
    with progress(total=len(unmade), description="making", unit="cases", show=bool(unmade)) as bar:
        for _ in in_processes(unmade, "make", workers, limit):
            bar.update(1)
    left = [case for case in cases if case.truth.is_file() and not case.is_solved()]
    with progress(total=len(left), description=f"code {CODE}", unit="cases", show=bool(left)) as bar:
        for _ in in_processes(left, "solve", workers, limit):
            bar.update(1)


def rows_of(cases: Sequence[Case], answers: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """Rows of the cases that have an answer, which may be that there is none."""
    return [case.row(answers[case.name]) for case in cases if case.name in answers]


def gate(config: Config) -> list[Row]:
    """Solve cases, write the file, print tables; returns the rows of this code."""
    check(config)
    cases = cases_of(config)
    earlier_answers(config, cases) if config.against else None  # bad input is told before hours of work
    solve_cases(cases, config.workers, config.limit)
    answers = {case.name: answer for case in cases if (answer := case.kept())}
    rows = rows_of(cases, answers)
    if config.json is not None:
        environment = describe_environment()
        write_json(config.json, {"code": CODE, "environment": environment, "rows": rows, "answers": answers})
    print(f"code {CODE}")
    show(rows)
    if config.against:
        print()
        made = [case for case in cases if case.truth.is_file()]
        show_pairs(paired(rows_of(made, earlier_answers(config, cases)), rows))
    return rows


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        if config.compare is not None:
            before, after = ([Row.read(row) for row in saved(path, "rows")["rows"]] for path in config.compare)
            show_pairs(paired(before, after))
            return
        rows = gate(config)
    if failed := [row.case for row in rows if row.said == NO_ANSWER]:
        print(f"no answer: {', '.join(failed)}")
        raise SystemExit(1)


if __name__ == "__main__":
    main()
