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

import hashlib
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent / "league"))

import numpy as np
import tyro
from contest import (
    BENCHMARKS,
    EXAMPLES,
    REALITIES,
    Budget,
    Room,
    Task,
    league_robot,
    predicted,
    run_sealed,
    unknown_of,
)
from contestants import CONTESTANTS

import btr_mjx
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, note, progress, read_json, write_json

QUICK = Budget(controllers=24, generations=6, rounds=2, draws=4, simulations=12, simulation_generations=6, jacobians=3)
"""Budget of --quick, for a look."""
FRESH = 12
"""Random controllers on which predictions are compared with reality."""


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


def league_digest() -> str:
    """Digest of the package, the robots, the contestants and the realities; 12 hexadecimal digits."""
    total = hashlib.sha256(Path(__file__).read_bytes())
    for folder in (Path(str(btr_mjx.__file__)).parent, EXAMPLES, *(BENCHMARKS / own for own in _FOLDERS)):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".xml", ".j2", ".toml")):
            total.update(f"\n{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return total.hexdigest()[:12]


_FOLDERS = ("league", "league_robots", "hidden_cases")


def contest(config: Config, reality: str, contestant: str, seed: int, exchange: Path) -> dict[str, Any]:
    """One contestant in one reality: what it tried, how good its controller is there, and what it predicts.

    Args:
      config: has trials and budget.
      reality: name of the reality.
      contestant: name of the contestant.
      seed: of the contestant.
      exchange: folder in which trials are exchanged; what is there is removed.
    """
    shutil.rmtree(exchange, ignore_errors=True)
    robot, room = league_robot(reality), Room(reality, exchange / "trials", config.trials)
    row: dict[str, Any] = {"reality": reality, "contestant": contestant, "seed": seed}
    begun = time.process_time()
    try:
        answer = CONTESTANTS[contestant](Task(robot, unknown_of(robot), room, config.trials, seed, budget_of(config)))
    except InputError as error:
        return row | {"failed": str(error)}
    row |= {"cpu_seconds": time.process_time() - begun, "found": list(answer.found)}
    row |= {"measured": room.tried()[1].tolist(), "controller": answer.controller.tolist()}
    row["fitness"] = float(Room(reality, exchange / "exam", 1, exact=True).measure(answer.controller, 0)[0, -1])
    if answer.robot is not None and answer.simulations is not None:
        row["predicted"] = predicted(answer.robot, answer.simulations, fresh_controllers(reality)).tolist()
    return row


def yardstick(config: Config, reality: str, folder: Path) -> dict[str, Any]:
    """What is compared with: real fitness of the oracle and of random controllers, and what was hidden.

    Args:
      config: has the budget.
      reality: name of the reality.
      folder: for files; what is there is removed.
    """
    shutil.rmtree(folder, ignore_errors=True)
    write_json(folder / "budget.json", budget_of(config))
    run_sealed("oracle", reality, str(folder / "oracle.json"), "0", str(folder / "budget.json"))
    found = read_json(folder / "oracle.json")
    rows = np.concatenate([[found["controller"]], fresh_controllers(reality)])
    fitness = Room(reality, folder / "exam", len(rows), exact=True).measure(rows, 0)[:, -1]
    return dict(found) | {"reality": reality, "fitness": float(fitness[0]), "fresh": fitness[1:].tolist()}


def fresh_controllers(reality: str) -> np.ndarray:
    """Random controllers (`FRESH`, n_c) that no contestant has seen."""
    return league_robot(reality).controller_box.sample(np.random.default_rng(8128), FRESH)


def budget_of(config: Config) -> Budget:
    """The budget of every contestant and of the oracle."""
    return QUICK if config.quick else Budget()


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
      The row. `regret` is the mean over trials of what the best controller so far lacks to the oracle, in shares of it;
      `delta` is Delta_fitness on fresh controllers, over the oracle's gain on a random one, None without a simulator.
    """
    out = {**row, "sort": yard["sort"], "hidden": yard["hidden"], "score": None, "regret": None, "delta": None}
    if "failed" in row:
        return out
    shares = np.nan_to_num(share(row["measured"], yard), nan=0.0)
    best = np.maximum.accumulate(np.maximum(shares, 0.0))
    best = np.concatenate([best, np.full(max(0, trials - len(best)), best[-1])])
    out |= {"score": float(share(row["fitness"], yard)), "regret": float(np.mean(1 - best))}
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
    code, how = league_digest(), "quick" if config.quick else "full"
    kept, rows, yards = config.out / code / how, list[dict[str, Any]](), dict[str, dict[str, Any]]()
    with progress(total=len(wanted) + len(realities), description="league", unit="rows", show=True) as bar:
        for reality, contestant, seed in wanted:
            name = f"{reality}-{contestant}-{seed}-{config.trials}"
            file = kept / f"{name}.json"
            if not file.is_file():
                write_json(file, contest(config, reality, contestant, seed, kept / "exchange" / name))
            rows.append(read_json(file))
            bar.update(1)
        for reality in realities:
            file = kept / f"{reality}.json"
            if not file.is_file():
                write_json(file, yardstick(config, reality, kept / "oracle" / reality))
            yards[reality] = read_json(file)
            bar.update(1)
    rows = [judged(row, yards[row["reality"]], config.trials) for row in rows]
    return {"config": config, "code": code, "environment": describe_environment(), "yardsticks": yards, "rows": rows}


def table(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Cells of the table: a line for each contestant, with its mean score by robot, and the means of all numbers."""
    robots = list(dict.fromkeys(row["reality"].partition("-")[0] for row in rows))
    out = [["contestant", *robots, "score", "regret", "Delta_fitness", "CPU-s"]]

    def mean(own: Sequence[Mapping[str, Any]], key: str, digits: int = 2) -> str:
        values = [row[key] for row in own if row.get(key) is not None]
        return f"{np.mean(values):.{digits}f}" if values else "-"

    for contestant in dict.fromkeys(row["contestant"] for row in rows):
        own = [row for row in rows if row["contestant"] == contestant]
        by_robot = [mean([row for row in own if row["reality"].startswith(f"{robot}-")], "score") for robot in robots]
        out.append([contestant, *by_robot, *(mean(own, key) for key in ("score", "regret", "delta"))])
        out[-1].append(mean(own, "cpu_seconds", 0))
    return out


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        report = league(config)
        if config.json is not None:
            write_json(config.json, report)
    cells = table(report["rows"])
    print("\n".join(f"| {' | '.join(line)} |" for line in [cells[0], ["---"] * len(cells[0]), *cells[1:]]))
    for row in report["rows"]:
        if "failed" in row:
            note(f"{row['reality']}, {row['contestant']}, seed {row['seed']}: {row['failed']}")
    if any("failed" in row for row in report["rows"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
