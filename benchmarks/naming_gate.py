"""Paired comparison of two versions of the missing-effect search on fixed cases.

    uv run python benchmarks/naming_gate.py --json before.json        # answers of this code, cached
    uv run python benchmarks/naming_gate.py --against before.json     # or a code digest: that version's cached answers

The cases are those of `blind_gap.py --robot ROBOT --seed SEED`. A case is made once and kept, with the gain of its true
effect: all versions read the same recordings, and the same effects are detectable for all. An answer is cached under
the digest of the code that computed it: unchanged code solves no case again, and the same command continues a killed
run. A checkout of another commit shares the cache through `--out`. Two versions are compared case by case with
McNemar's exact test. `benchmarks/baselines/` has the answers of version 0.1.0 to 40 hexapods, to 12 that lack two
effects, and to 20 cases of every other robot. Exit code: 1 where a case failed, 2 for bad input.
"""

import hashlib
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import blind_gap
import case_runs
import gap_scores as scores
import mujoco
import numpy as np
import scipy
import tyro
from hidden_cases import case_robot
from scipy.stats import binomtest

import btr_mjx
from btr_mjx.cluster import check_cluster
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, progress, read_json, write_json

ROOMS_OUTSIDE_SEARCH = (
    *("backtoreality", "cluster", "demo", "engines", "evaluation", "optimise", "pages", "plotting", "replays"),
    *("gap/experiments", "gap/fitness_only", "gap/preflight", "gap/report"),
)
"""Rooms that the search does not import. It does not import the commands either, which are the files at the top."""
SHARES = (
    ("detectable effects right", "right_kind_and_place", "detectable"),
    ("both of a pair found", "pairs_both_found", "pairs_detectable"),
    ("truth in the equivalence set", "truth_in_equivalence_set", "detectable"),
    ("numbers within intervals", "within_intervals", "numbers"),
    ("nulls named", "nulls_named", "nulls"),
    ("outside called unexplained", "outside_flagged", "outside"),
    ("false unexplained", "false_unexplained", "explained"),
)
"""Rows of the table: title, share in `gap_scores.summary`, number of cases of which the share is taken."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: int = 40
    """Number of cases."""
    robot: Literal["hexapod", "pendulum", "quadruped", "arm"] = "hexapod"
    """Robot of the cases."""
    seed: int = 2026
    """Seed of the cases."""
    effects: Literal[1, 2] = 1
    """Effects that are missing at once; with 2 there are no nulls and nothing outside the library."""
    each: bool = False
    """A number of its own for every joint is missing, nothing else."""
    workers: int = 2
    """Number of processes that make cases, and of those that solve them; several solvers get one core each."""
    cluster: str | None = None
    """Use a Dask cluster whose workers see the same files: local:N, tcp://HOST:PORT or file:SCHEDULER.json."""
    out: Path = Path("runs/naming_gate")
    """Folder of the cases and of the answers of all versions."""
    against: str | None = None
    """Earlier version to compare with: a file written by --json, or the code digest of answers in the cache."""
    json: Path | None = None
    """Write summary and answers here."""
    duration: float | None = None
    """Another duration of the recordings [s], for a quick look."""


@dataclass(frozen=True)
class Files(case_runs.Files):
    """Paths of the files of a case and of its answer by one version of the code."""

    prefix: str
    code: str

    @property
    def name(self) -> str:
        """Name of the case."""
        return f"{self.prefix}-{self.index:04d}"

    @property
    def answer(self) -> Path:
        """Answer, written by the process that solves the case."""
        return self.folder / "answers" / self.code / f"{self.name}.json"


def _digest(root: Path, counts: Callable[[Path], bool], more: str = "") -> str:
    """SHA-256 of a text and of the selected files with their names; the first 12 hexadecimal digits."""
    total = hashlib.sha256(more.encode())
    for name in sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()):
        if counts(Path(name)):
            content = (root / name).read_bytes()
            total.update(f"\n{name} {len(content)}\n".encode() + content)
    return total.hexdigest()[:12]


def code_digest(package: Path) -> str:
    """Digest of the code on which an answer depends: modules of a package and versions of libraries.

    Args:
      package: folder of btr_mjx.

    Returns:
      12 hexadecimal digits.
    """

    def counts(path: Path) -> bool:
        if len(path.parts) == 1:
            return path.name == "errors.py"
        return path.suffix == ".py" and not any(path.is_relative_to(room) for room in ROOMS_OUTSIDE_SEARCH)

    return _digest(package, counts, ", ".join(f"{lib.__name__} {lib.__version__}" for lib in (mujoco, np, scipy)))


@cache
def data_digest(folder: Path) -> str:
    """Digest of a dataset; cached, as recordings do not change."""
    return _digest(folder, lambda _: True)


CODE = code_digest(Path(str(btr_mjx.__file__)).parent)
"""Digest of the code that this process imported."""


def make(config: Config, files: Files) -> None:
    """Make a case and write its truth; results from earlier recordings of the case are removed."""
    files.oracle.unlink(missing_ok=True)
    drawn = {name: getattr(config, name) for name in ("seed", "robot", "duration", "effects", "each")}
    blind_gap.make(blind_gap.Config(**drawn, only_effects=config.effects > 1), files)


def work(files: Files) -> None:
    """Solve a case; compute the gain of the true effect, too, where no version has done so."""
    if files.code != CODE:
        raise InputError(f"btr_mjx changed from {files.code} to {CODE} while the run started; start it again")
    begun = time.process_time()
    answer = blind_gap.solve(files.data)
    cpu = time.process_time() - begun
    if not files.oracle.is_file():
        blind_gap.score_truth(blind_gap.Config(), files)
    write_json(files.answer, answer | {"cpu_seconds": cpu, "data": data_digest(files.data)})


def cached(files: Files, saved: Mapping[str, Any] | None = None) -> dict[str, Any] | None:
    """The answer to a case: of the cache, where it holds one for these recordings, or among saved answers.

    Saved answers may belong to recordings that differ in the last bits: other processors round differently.
    """
    if not (files.truth.is_file() and files.oracle.is_file() and files.data.is_dir()):
        return None
    if saved is not None:
        return saved.get(files.name)
    answer = read_json(files.answer) if files.answer.is_file() else None
    return answer if answer and answer["data"] == data_digest(files.data) else None


def earlier(config: Config) -> tuple[str, dict[str, Any] | None]:
    """Code digest of the version to compare with, and its answers by case name; None for those in the cache.

    Raises:
      InputError: not a file of this benchmark, or a code digest of which the cache has no answers.
    """
    against, folder = str(config.against), config.out / "answers"
    if re.fullmatch("[0-9a-f]{12}", against):
        known = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
        if against not in known:
            raise InputError(f"--against {against}: {folder} has answers of {', '.join(known) or 'no version'}")
        return against, None
    saved = read_json(against)
    if not isinstance(saved, dict) or not {"code", "answers"} <= set(saved):
        raise InputError(f"--against {against}: expected a file written by --json of this benchmark, or a code digest")
    return str(saved["code"]), saved["answers"]


def judged(files: Files, answer: Mapping[str, Any], model: mujoco.MjModel) -> dict[str, Any]:
    """Row of `gap_scores.judge` with `correct` added: None for an effect that cannot be detected."""
    case = {"truth": read_json(files.truth), "answer": answer, "oracle": read_json(files.oracle)}
    row = scores.judge(model, case)
    correct = row["said"] == row["truth"]
    if row["truth"] == "effect":
        correct = row["right"] if row["detectable"] else None
    return {"case": files.name, **row, "cpu_seconds": answer["cpu_seconds"], "correct": correct}


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Numbers of `gap_scores.summary`, with CPU time."""
    numbers = scores.summary(rows)
    cpu = float(np.median([row["cpu_seconds"] for row in rows])) if rows else None
    return numbers | {"explained": numbers["cases"] - numbers["outside"], "cpu_seconds_median": cpu}


def mcnemar(before: Sequence[bool], after: Sequence[bool]) -> dict[str, Any]:
    """McNemar's exact test of whether two versions are right equally often.

    Args:
      before: whether the earlier version was right, by case.
      after: the same of the later version.

    Returns:
      Counts of cases that both, one or neither had right, and the two-sided p-value.
    """
    counts = Counter(zip(before, after, strict=True))
    both, lost, won, neither = (counts[pair] for pair in ((True, True), (True, False), (False, True), (False, False)))
    p = float(binomtest(won, lost + won, 0.5).pvalue) if lost + won else 1.0
    return {"both": both, "only_before": lost, "only_after": won, "neither": neither, "p": p}


def compared(before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Tests and changed answers of two versions, whose rows are of the same cases."""
    pairs = list(zip(before, after, strict=True))
    counted = [(b["correct"], a["correct"], b["truth"]) for b, a in pairs if b["correct"] is not None]
    effects = [pair for pair in counted if pair[2] == "effect"]
    tests = (("detectable effects", effects), ("with nulls and outside", counted))
    return {
        "tests": {name: mcnemar([b for b, _, _ in some], [a for _, a, _ in some]) for name, some in tests},
        "changed": [
            f"{b['case']}, hidden {b['hidden']} (gain {b['oracle']:.0f}): {_words(b)} -> {_words(a)}"
            for b, a in pairs
            if _words(b) != _words(a)
        ],
    }


def _words(row: Mapping[str, Any]) -> str:
    """The answer of a version, and whether it is correct where that can be decided."""
    said = row["named"] if row["said"] == "effect" else row["said"]
    return said + {None: "", True: " (right)", False: " (wrong)"}[row["correct"]]


def show(report: Mapping[str, Any]) -> None:
    """Print the table, the tests and the changed answers."""
    numbers = [version["numbers"] for version in report["versions"]]

    def line(title: str, cells: Sequence[str], width: int = 20) -> None:
        print(f"{title:30}" + "".join(f"{cell:>{width}}" for cell in cells))

    line("code", [version["code"] for version in report["versions"]])
    line("cases", [str(own["cases"]) for own in numbers])
    for title, share, among in SHARES:
        line(title, [f"{round((own[share] or 0) * own[among])} of {own[among]}" for own in numbers])
    for title, name in (("steps, median", "steps_median"), ("CPU-seconds, median", "cpu_seconds_median")):
        line(title, ["-" if own[name] is None else f"{own[name]:.4g}" for own in numbers])
    if report["paired"] is not None:
        print()
        line("right, by case", ["both", "only before", "only after", "neither", "p"], 13)
        for name, test in report["paired"]["tests"].items():
            line(name, [f"{value:.3g}" for value in test.values()], 13)
        print("", f"changed answers: {len(report['paired']['changed'])}", *report["paired"]["changed"], sep="\n")


def gate(config: Config) -> dict[str, Any]:
    """Solve the cases that are not cached, and compare; returns the report that --json writes."""
    for name, least in (("cases", 1), ("workers", 1), ("seed", 0)):
        if getattr(config, name) < least:
            raise InputError(f"--{name}: got {getattr(config, name)}, expected at least {least}")
    if config.duration is not None and not config.duration > 0:
        raise InputError(f"--duration: got {config.duration}, expected more than 0 s")
    if config.cluster is not None:
        check_cluster(config.cluster)
    other = None if config.against is None else earlier(config)
    prefix = f"{config.robot}-{config.seed}" + ("-pairs" if config.effects > 1 else "-each" if config.each else "")
    prefix += f"-{config.duration:g}s" if config.duration else ""
    folder = config.out.absolute()  # workers of a cluster may run in another folder
    cases = [Files(folder, index, prefix, CODE) for index in range(config.cases)]
    missing = [files for files in cases if cached(files) is None]
    if missing:
        failed, steps = config.out / "failed" / CODE, (partial(make, config), work)
        if config.cluster is None:
            solved = case_runs.scheduled(missing, *steps, config.workers, failed)
        else:
            solved = case_runs.on_cluster(missing, *steps, config.cluster, failed)
        with progress(total=len(missing), description=f"code {CODE}", unit="cases", show=True) as bar:
            for _ in solved:
                bar.update(1)
    found = [(files, answer) for files in cases if (answer := cached(files))]
    model, paired = case_robot(config.robot).model, None
    after = [judged(files, answer, model) for files, answer in found]
    rows = [(CODE, after)]
    if other is not None and found:
        code, saved = other
        past = [cached(Files(config.out, files.index, prefix, code), saved) for files, _ in found]
        before = [judged(files, old, model) for (files, _), old in zip(found, past, strict=True) if old]
        if not before:
            raise InputError(f"--against {config.against}: has no answers to these {config.cases} cases")
        after = [row for row, old in zip(after, past, strict=True) if old]
        rows, paired = [(code, before), (CODE, after)], compared(before, after)
    return {
        "config": config,
        "environment": describe_environment(),
        "code": CODE,
        "versions": [{"code": version, "numbers": summary(own), "rows": own} for version, own in rows],
        "paired": paired,
        "failed": sorted({files.name for files in cases} - {files.name for files, _ in found}),
        "answers": {files.name: answer for files, answer in found},
    }


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        report = gate(config)
        if config.json is not None:
            write_json(config.json, report)
    show(report)
    if report["failed"]:
        print(f"no answer: {', '.join(report['failed'])}")
        raise SystemExit(1)


if __name__ == "__main__":
    main()
