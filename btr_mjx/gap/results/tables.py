"""Tables of a diagnosis: candidates, refitted parameters, disagreement, numbers over sets, the next command."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.data import control_columns
from btr_mjx.gap.results.drawn import DisagreementMap
from btr_mjx.runs import write_table


@dataclass(frozen=True)
class Quantity:
    """A number over several sets of recordings, the oldest first.

    Attributes:
      effect, location, parameter: what it is.
      unit: SI unit.
      value: of each set, beside the believed model.
      low, high: 90 % intervals.
      named: whether the number was named in that set: at first as missing, later as changed.
    """

    effect: str
    location: str
    parameter: str
    unit: str
    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    named: tuple[bool, ...]


@dataclass(frozen=True)
class NextExperiment:
    """A command that is proposed to be recorded next.

    Attributes:
      time: (K,) times [s].
      values: (K, nu) command, in the actuators' units.
      between: names of the two hypotheses that it is expected to separate.
      disagreement: expected difference of their scores in one recording.
      others: expected difference for every command that was compared.
      chosen: index of the proposed command in `others`.
      reason: the reason in words.
    """

    time: np.ndarray
    values: np.ndarray
    between: tuple[str, str]
    disagreement: float
    others: tuple[float, ...]
    chosen: int
    reason: str


def save_quantities(folder: Path, quantities: Sequence[Quantity], sets: Sequence[str]) -> None:
    """Write sets.csv: numbers over sets of recordings, a row for each number and set; nothing where there are none.

    Args:
      folder: the run folder.
      quantities: the numbers.
      sets: names of the sets, the oldest first.
    """
    rows = [
        {"set": k, "name": name}
        | {key: getattr(own, key) for key in ("effect", "location", "parameter", "unit")}
        | {key: getattr(own, key)[k] for key in ("value", "low", "high", "named")}
        for own in quantities
        for k, name in enumerate(sets)
    ]
    if rows:
        write_table(folder / "sets.csv", rows)


def write_tables(result: Mapping[str, Any], disagreement: DisagreementMap | None, folder: Path) -> None:
    """Write ranking.csv, believed.csv and disagreement.csv, of entries of result.json and the map of disagreement."""
    rows = [
        {key: row[key] for key in ("effect", "location", "score", "margin", "gain", "held_out", "equivalent")}
        | {"parameters": ", ".join(f"{name} = {value:.6g}" for name, value in row["parameters"].items())}
        | {"beside": ", ".join(row["beside"]), "together": ", ".join(row["together"])}
        for row in result["ranking"]
    ]
    if rows:
        write_table(folder / "ranking.csv", rows)
    if result["believed"]:
        write_table(folder / "believed.csv", result["believed"])
    if disagreement is not None and disagreement.places:
        table: dict[str, Any] = {"place": list(disagreement.places), "unit": list(disagreement.units)}
        for j, regime in enumerate(disagreement.regimes):
            table[regime] = np.asarray(disagreement.before, float)[:, j]
            table[f"{regime}: count"] = np.asarray(disagreement.count)[:, j]
        write_table(folder / "disagreement.csv", table)


def write_command(proposal: NextExperiment, model: mujoco.MjModel, folder: Path) -> dict[str, Any]:
    """Write the proposed command as a table with the columns of a recording; returns the entry of result.json."""
    columns = {name: proposal.values[:, k] for k, name in enumerate(control_columns(model))}
    write_table(folder / "next_command.csv", {"time": proposal.time} | columns)
    others = np.delete(np.asarray(proposal.others, float), proposal.chosen)
    return {
        "text": f"Send the command in next_command.csv: {proposal.reason}.",
        "file": "next_command.csv",
        "between": [name_entry(name) if "@" in name else {"name": name} for name in proposal.between],
        "disagreement": proposal.disagreement,
        "others": {"median": float(np.median(others)) if len(others) else None, "count": len(others)},
    }


def name_entry(name: str) -> dict[str, str]:
    """Entry of result.json for "effect@location"."""
    effect, _, location = name.partition("@")
    return {"effect": effect, "location": location}
