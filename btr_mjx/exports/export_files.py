"""Identified parameters as tables for other programs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from btr_mjx.runs import write_json, write_table


@dataclass(frozen=True)
class ExportedParameter:
    """One identified number.

    Attributes:
      name: of the parameter.
      unit: of its value, "" where it is not known.
      value: the best estimate.
      low, high: its interval; None where there is none.
      origin: how value and interval were found, in words.
      paths: numbers of the compiled model that it moves, with their values at both ends of the interval; empty where
        MJCF cannot express it.
    """

    name: str
    unit: str
    value: float
    low: float | None
    high: float | None
    origin: str
    paths: Mapping[str, tuple[float, float]] = field(default_factory=dict)


_USE = (
    "Draw one share in [0, 1] for each parameter and set all of its numbers together: low + share * (high - low). "
    "The first value of a number belongs to the low end of the parameter, the second to its high end, whichever is "
    "larger. Intervals are statistical only: widen them for wear, temperature and other robots of the series."
)
"""How randomisation.json is read, as its reader needs it."""


def write_exports(folder: Path, parameters: Sequence[ExportedParameter]) -> None:
    """Write parameters.csv, parameters.json and, where parameters have paths and an interval, randomisation.json.

    Nothing is written where there are no parameters.

    Raises:
      OSError: the folder cannot be written to.
    """
    if not parameters:
        return
    # Not low and high: these would be read as bounds of the parameter.
    keys = {"name": "name", "unit": "unit", "value": "value", "interval_low": "low", "interval_high": "high"}
    keys |= {"origin": "origin"}
    rows = [{column: getattr(one, key) for column, key in keys.items()} for one in parameters]
    write_table(folder / "parameters.csv", rows)
    write_json(folder / "parameters.json", rows)
    ranges = {one.name: one.paths for one in parameters if one.paths and one.low is not None}
    if ranges:
        write_json(folder / "randomisation.json", {"use": _USE, "parameters": ranges})
