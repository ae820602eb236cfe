"""Does finding what a simulator lacks give better controllers in reality than what labs do today?

    uv run python benchmarks/league.py --json league.json                     # everything
    uv run python benchmarks/league.py --quick --realities thrower-1 finger-0 --contestants believed growth

Up to 20 realities of six robots stand behind exchange folders, each in a process of its own (`league/sealed.py`) with
physics of its own: what is unknown of the robot has other values, everything is calibrated a little wrong, and one to
three effects are hidden, two of them outside the library, or none. A contestant (`league/contestants.py`) gets a robot,
a budget of simulations and a number of trials, and hands in a controller.

An oracle evolves controllers in the reality itself. The score of a controller is its real fitness between that of a
random controller (0, the median of a few) and that of the oracle (1). Rows are kept under the digest of the code, so
that the same command continues a killed run.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent / "league"))

import numpy as np
import tyro
from contest import REALITIES, Budget
from contestants import CONTESTANTS
from rows import contest, league_digest, yardstick

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, note, progress, read_json, write_json

QUICK = Budget(controllers=24, generations=6, rounds=2, draws=4, simulations=12, simulation_generations=6, jacobians=3)
"""Budget of --quick, for a look."""
SORTS = {"library": "effects", "outside": "outside", "nothing": "nothing"}
"""What is hidden in a reality, and the title of its column."""
GOOD = 0.9
"""Score from which a controller counts as good as the oracle's."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    realities: tuple[str, ...] = ()
    """Names of realities, such as thrower-0; all if none is given."""
    contestants: tuple[str, ...] = ()
    """Names of contestants; all if none is given."""
    trials: int = 30
    """Trials of a contestant in reality, repeats included."""
    seeds: int = 1
    """Seeds of every contestant in every reality."""
    quick: bool = False
    """A small budget of simulations."""
    out: Path = Path("runs/league")
    """Folder of the exchange folders and of what is kept."""
    json: Path | None = None
    """Write all rows here."""


def share(fitness: np.ndarray | float, yard: Mapping[str, Any]) -> Any:
    """Real fitness between that of a random controller (0) and that of the oracle (1)."""
    worst = float(np.nanmedian(yard["fresh"]))
    return (np.asarray(fitness, float) - worst) / (yard["fitness"] - worst)


def judged(row: Mapping[str, Any], yard: Mapping[str, Any], trials: int) -> dict[str, Any]:
    """A row with score, regret and Delta_fitness.

    Args:
      row: of `contest`.
      yard: of the same reality.
      trials: trials that were allowed.

    Returns:
      The row. `regret` is the mean over trials of what the best controller so far lacks to the oracle;
      `delta` is Delta_fitness on fresh controllers, on the scale of scores, None without a simulator. A trial or a
      contestant that failed counts as a random controller.
    """
    out = {**row, "sort": yard["sort"], "hidden": yard["hidden"], "score": 0.0, "regret": 1.0, "delta": None}
    if "failed" in row:
        return out
    shares = np.nan_to_num(share(row["measured"], yard), nan=0.0)
    best = np.maximum.accumulate(np.maximum(shares, 0.0))
    best = np.concatenate([best, np.full(max(0, trials - len(best)), best[-1])])
    out |= {"score": float(np.nan_to_num(share(row["fitness"], yard))), "regret": float(np.mean(1 - best))}
    if "predicted" in row:
        apart = np.abs(share(row["predicted"], yard) - share(yard["fresh"], yard))
        out["delta"] = float(np.nanmean(apart))
    return out


def league(config: Config) -> dict[str, Any]:
    """Run what is not kept; returns what --json writes.

    Raises:
      InputError: unknown names, or too few trials.
    """
    for flag, own, known in (
        ("realities", config.realities, REALITIES),
        ("contestants", config.contestants, tuple(CONTESTANTS)),
    ):
        unknown = [name for name in own if name not in known]
        if unknown:
            raise InputError(f"--{flag}: there is no {unknown[0]!r}; known are {', '.join(known)}")
    if config.trials < 8 or config.seeds < 1:
        raise InputError(f"--trials {config.trials} --seeds {config.seeds}: expected at least 8 and 1")
    realities = config.realities or REALITIES
    wanted = [
        (reality, contestant, seed)
        for seed in range(config.seeds)
        for reality in realities
        for contestant in config.contestants or CONTESTANTS
    ]
    budget = QUICK if config.quick else Budget()
    code = league_digest(budget)
    kept, rows, yards = config.out / code, list[dict[str, Any]](), dict[str, dict[str, Any]]()
    with progress(total=len(wanted) + len(realities), description="league", unit="rows", show=True) as bar:
        for reality, contestant, seed in wanted:
            name = f"{reality}-{contestant}-{seed}-{config.trials}"
            file = kept / f"{name}.json"
            if not file.is_file():
                write_json(file, contest(reality, contestant, seed, config.trials, budget, kept / "exchange" / name))
            rows.append(read_json(file))
            bar.update(1)
        for reality in realities:
            file = kept / f"{reality}.json"
            if not file.is_file():
                write_json(file, yardstick(reality, budget, kept / "oracle" / reality))
            yards[reality] = read_json(file)
            bar.update(1)
    rows = [judged(row, yards[row["reality"]], config.trials) for row in rows]
    return {"config": config, "code": code, "environment": describe_environment(), "yardsticks": yards, "rows": rows}


def tables(rows: Sequence[Mapping[str, Any]]) -> list[list[list[str]]]:
    """Cells of two tables, a row for each contestant: all realities; mean scores by robot and by what is hidden."""
    robots = list(dict.fromkeys(row["reality"].partition("-")[0] for row in rows))
    sorts = [sort for sort in SORTS if any(row["sort"] == sort for row in rows)]
    totals = [["contestant", "median score", f"score >= {GOOD:g}", "regret", "Delta_fitness", "CPU-s"]]
    parts = [["contestant", *robots, *(SORTS[sort] for sort in sorts), "mean"]]

    def mean(own: Sequence[Mapping[str, Any]], key: str, digits: int = 2) -> str:
        values = [row[key] for row in own if row.get(key) is not None]
        return f"{np.mean(values):.{digits}f}" if values else "-"

    for contestant in dict.fromkeys(row["contestant"] for row in rows):
        own = [row for row in rows if row["contestant"] == contestant]
        scores = np.array([row["score"] for row in own])
        good = f"{np.sum(scores >= GOOD)} of {len(own)}"
        rest = (mean(own, "regret"), mean(own, "delta"), mean(own, "cpu_seconds", 0))
        totals.append([contestant, f"{np.median(scores):.2f}", good, *rest])
        groups = [[row for row in own if row["reality"].startswith(f"{robot}-")] for robot in robots]
        groups += [[row for row in own if row["sort"] == sort] for sort in sorts]
        parts.append([contestant, *(mean(group, "score") for group in [*groups, own])])
    return [totals, parts]


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        report = league(config)
        if config.json is not None:
            write_json(config.json, report)
    for cells in tables(report["rows"]):
        lines = [cells[0], ["---"] * len(cells[0]), *cells[1:]]
        print("\n".join(f"| {' | '.join(line)} |" for line in lines), end="\n\n")
    for row in report["rows"]:
        if "failed" in row:
            note(f"{row['reality']}, {row['contestant']}, seed {row['seed']}: {row['failed']}")
    if any("failed" in row for row in report["rows"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
