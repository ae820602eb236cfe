"""What each constant of the search in forces pays: the same cases with and without it.

    uv run python benchmarks/force_rules.py --cases 15 --nulls 20 --json rules.json

The cases are those of `gate.py`, suites field and field_nulls: robots that lack one to three effects, and robots that
lack nothing, with faults of data. A rule is taken away by the value of its constant that makes it say nothing; a tuning
is doubled or halved. The table counts cases that are right only with it or only without it (right: every hidden effect
is named, and nothing else; of a null: nothing is named or unexplained). A rule pays where the difference exceeds two
standard errors, the root of the number of cases that differ. Answers are kept, so that the same command continues a
run.
"""

import os
import time
import traceback
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import tyro
from convention_rules import compared, set_constants
from gates.answers import CODE
from gates.cases import Case
from gates.pairing import cpu_ratio
from gates.rows import Row
from gates.suites import SUITES

from btr_mjx.runs import note, read_json, write_json

BASE = "all constants as they are"
NEVER = float("inf")
RULES: Mapping[str, Sequence[tuple[str, str, object]]] = {
    BASE: [],
    "random force of a tenth of the actuators' is large": [("forces.identify", "_LARGE", NEVER)],
    "what held-out recordings leave is beyond the noise": [("forces.identify", "_BEYOND", 0.0)],
    "finalists are compared by predictions": [("forces.search", "_unbeaten", lambda side, rows, needed: rows)],
    "another shape is told": [("forces.identify", "_TOLD", NEVER)],
    "another shape: a tenth of what names explain": [("forces.identify", "_LEFT", 0.0)],
    "predictions: differ by a tenth": [("forces.predictions", "RELATIVE_ERROR", 0.0)],
    "predictions decide before the likelihood": [("forces.predictions", "RELATIVE_ERROR", NEVER)],
    "a further name: a hundredth of the others' gain": [("forces.search", "RELATIVE_ERROR", 0.0)],
    "numbers smaller than 0.3 steps are not named": [("forces.answer.final_numbers", "_SEEN", 0.0)],
    "nine beside calibration": [("forces.elimination", "_DOUBT", 0.0)],
    "a whole drive as one answer": [("forces.search", "drive_points", lambda *_: [])],
    "commands act within 0.75 of a sample": [("forces.unknowns", "_WITHIN", 0.5)],
    "calibration: five times the laboratory's": [("effects.library", "_FIELD", 2.5)],
    "no joint is without friction": [("forces.unknowns", "_UNKNOWN", 0.0)],
    "three finalists": [("forces.search", "_FINALISTS", 6)],
    "leads are as large as pays": [("forces.search", "_SMALLEST", NEVER)],
    "eight leads go one step": [("forces.search", "_TRIED", 3)],
    "variances are extrapolated": [("forces.settling", "_FARTHEST", 1.0)],
    "derivatives of three rounds": [("forces.settling", "_FRESH", 20)],
    "forces are unusual for 30 ms": [("forces.kalman_filter", "LASTS", 0.0)],
    "horizons: errors of a tenth of the motion": [("forces.horizons", "FOLLOWS", 0.2)],
    "horizons: four times longer": [("forces.horizons", "_LONGER", 2.0)],
}
"""Rules, each with the constants that are changed: module of `btr_mjx.gap`, name, value."""


@dataclass(frozen=True)
class Config:
    """Settings."""

    cases: int = 15
    """Cases with one to three effects."""
    nulls: int = 20
    """Cases in which nothing is missing."""
    seed: int = 3
    """Seed of the cases."""
    only: tuple[str, ...] = ()
    """Only rules whose name holds one of these."""
    processes: int = 2
    """Processes side by side."""
    out: Path = Path("runs/gate")
    """Folder of cases and answers."""
    json: Path | None = None
    """Also write the rows here."""


def _row(case: Case) -> Row:
    """Row of a case, with the constants of this process."""
    try:
        if not case.truth.is_file():
            case.make()
        if not case.is_solved():
            case.solve()
    except Exception:
        case.fail(traceback.format_exc())
    return case.row(read_json(case.answer))


def rows_of(config: Config, rule: str) -> list[Row]:
    """Rows of all cases without a rule."""
    words = "_".join("".join(c if c.isalnum() else " " for c in rule).split())
    version = CODE if rule == BASE else f"{CODE}/{words}"
    counts = {"field": config.cases, "field_nulls": config.nulls}
    cases = [Case(SUITES[n], config.seed, i, config.out, version) for n, count in counts.items() for i in range(count)]
    with ProcessPoolExecutor(config.processes, get_context("spawn"), set_constants, (RULES[rule],)) as pool:
        return list(pool.map(_row, cases))


def main(config: Config) -> None:
    """Print the table."""
    print(f"{'without or with another value':52} {'right only with/without':>24} {'pays':>5} {'CPU':>6}")
    base, found = list[Row](), dict[str, Any]()
    for rule in RULES:
        if base and config.only and not any(word in rule for word in config.only):
            continue
        begun = time.monotonic()
        rows = rows_of(config, rule)
        base = base or rows
        right, other = (np.array([row.right for row in own], bool) for own in (base, rows))
        gained, lost, pays = compared(right, other, True)
        cpu, _ = cpu_ratio([row.cpu_seconds for row in base], [row.cpu_seconds for row in rows])
        shown = f"{right.sum()} of {len(right)} right" if rows is base else f"{gained} / {lost}"
        print(f"{rule:52} {shown:>24} {'yes' if pays else 'no':>5} {cpu:6.2f}", flush=True)
        for row, first in zip(rows, base, strict=True):
            if row.right != first.right:
                note(f"    {row.case} {row.hidden}: {first.words} -> {row.words}")
        found[rule] = {"rows": rows, "seconds": time.monotonic() - begun}
        if config.json:
            write_json(config.json, found)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
