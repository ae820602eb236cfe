"""What the league keeps: a row for each contestant in each reality, and what these are compared with.

Rows hold what was measured; `league.py` makes scores of them. They are kept under `league_digest`.
"""

import hashlib
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
from contest import BENCHMARKS, EXAMPLES, Budget, Room, Task, league_robot, predicted, run_sealed, unknown_of
from contestants import CONTESTANTS

import btr_mjx
from btr_mjx.runs import read_json, write_json

FRESH = 12
"""Random controllers on which predictions are compared with reality."""

_FOLDERS = ("league", "league_robots", "hidden_cases")


def league_digest(budget: Budget) -> str:
    """Digest of the package, the robots, the contestants, the realities and a budget; 12 hexadecimal digits."""
    total = hashlib.sha256(repr(budget).encode())
    for folder in (Path(str(btr_mjx.__file__)).parent, EXAMPLES, *(BENCHMARKS / own for own in _FOLDERS)):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".xml", ".j2", ".toml")):
            total.update(f"\n{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return total.hexdigest()[:12]


def contest(reality: str, contestant: str, seed: int, trials: int, budget: Budget, exchange: Path) -> dict[str, Any]:
    """One contestant in one reality: what it tried, how good its controller is there, and what it predicts.

    Args:
      reality: name of the reality.
      contestant: name of the contestant.
      seed: of the contestant.
      trials: that it may measure.
      budget: of simulations.
      exchange: folder in which trials are exchanged; what is there is removed.
    """
    shutil.rmtree(exchange, ignore_errors=True)
    robot, room = league_robot(reality), Room(reality, exchange / "trials", trials)
    row: dict[str, Any] = {"reality": reality, "contestant": contestant, "seed": seed}
    begun = time.process_time()
    try:
        answer = CONTESTANTS[contestant](Task(robot, unknown_of(robot), room, trials, seed, budget))
    except Exception as error:
        return row | {"failed": " ".join(f"{type(error).__name__}: {error}".split())}
    row |= {"cpu_seconds": time.process_time() - begun, "found": list(answer.found)}
    row |= {"measured": room.tried()[1].tolist(), "controller": answer.controller.tolist()}
    row["fitness"] = float(Room(reality, exchange / "exam", 1, exact=True).measure(answer.controller, 0)[0, -1])
    if answer.robot is not None and answer.simulations is not None:
        row["predicted"] = predicted(answer.robot, answer.simulations, fresh_controllers(reality)).tolist()
    return row


def yardstick(reality: str, budget: Budget, folder: Path) -> dict[str, Any]:
    """What is compared with: real fitness of the oracle and of random controllers, and what was hidden.

    Args:
      reality: name of the reality.
      budget: of simulations.
      folder: for files; what is there is removed.
    """
    shutil.rmtree(folder, ignore_errors=True)
    write_json(folder / "budget.json", budget)
    run_sealed("oracle", reality, str(folder / "oracle.json"), "0", str(folder / "budget.json"))
    found = read_json(folder / "oracle.json")
    rows = np.concatenate([[found["controller"]], fresh_controllers(reality)])
    fitness = Room(reality, folder / "exam", len(rows), exact=True).measure(rows, 0)[:, -1]
    return dict(found) | {"reality": reality, "fitness": float(fitness[0]), "fresh": fitness[1:].tolist()}


def fresh_controllers(reality: str) -> np.ndarray:
    """Random controllers (`FRESH`, n_c) that no contestant has seen."""
    return league_robot(reality).controller_box.sample(np.random.default_rng(8128), FRESH)
