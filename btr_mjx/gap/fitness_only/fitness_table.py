"""Fitness-only data: controllers that were tried, and one measured fitness per trial.

A folder with dataset.toml ([model] as always) and a table of trials:

    [fitness]
    file = "trials.csv"         # or .parquet
    body = "b0"                 # body whose displacement is measured
    function = "distance"       # or "forward_speed", see btr_mjx.evaluation.fitness_function
    duration = 1.7              # of a trial [s]
    omega = 60.0                # angular frequency of the controllers [rad/s]

Columns of the table, one row a trial: `fitness` [m/s]; the controller r_i = offset_i + a_i sin(omega t + phi_i) as
`amplitude/<actuator>`, `phase/<actuator>` and, optionally, `offset/<actuator>`, or as `a_<i>` and `phi_<i>` for the
i-th actuator, from 1; optionally `split`, "fit" or "test". Without it the last quarter of the trials is held out.
Trials without a finite fitness are left out. Every trial starts in the model's initial state.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.errors import InputError
from btr_mjx.evaluation import fitness_function
from btr_mjx.gap.data import DATASET_FILE, Dataset, read_header
from btr_mjx.gap.preflight import Finding
from btr_mjx.models import nearest_names, part_names
from btr_mjx.runs import (
    atomic_write,
    check_keys,
    file_inside,
    is_number,
    naming_lines,
    read_table,
    toml_section,
    write_table,
)

POSITION_FUNCTIONS = ("distance", "forward_speed")
"""Fitness functions that need the body's position only."""
_LEAST = 4
"""Smallest number of trials on either side of the split."""


@dataclass(frozen=True, eq=False)
class FitnessTable:
    """Trials of which only the fitness is known.

    Attributes:
      head: the dataset's model and parameters, without recordings.
      amplitude, phase, offset: (M, nu) parameters of the controllers [rad].
      omega: angular frequency of the controllers [rad/s].
      duration: duration of a trial [s].
      body: body whose displacement is measured.
      function: name of the fitness function.
      fitness: (M,) measured fitness [m/s].
      test: (M,) bool, True for held-out trials.
    """

    head: Dataset
    amplitude: np.ndarray
    phase: np.ndarray
    offset: np.ndarray
    omega: float
    duration: float
    body: str
    function: str
    fitness: np.ndarray
    test: np.ndarray

    def commands(self, times: np.ndarray) -> np.ndarray:
        """Commands (M, K, nu) [rad] at times (K,) [s]."""
        wave = np.sin(self.omega * times[:, None] + self.phase[:, None])
        return self.offset[:, None] + self.amplitude[:, None] * wave


def load_fitness(folder: str | Path) -> FitnessTable:
    """The trials with a finite fitness of a folder with dataset.toml and the table of trials.

    Raises:
      InputError: anything wrong with it, in one line.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    folder = Path(folder)
    with naming_lines(folder if folder.name == DATASET_FILE else folder / DATASET_FILE):
        return _load_fitness(folder)


def _load_fitness(folder: Path) -> FitnessTable:
    head, tables = read_header(folder, more=("fitness",))
    path = head.folder / DATASET_FILE
    about, where = toml_section(tables, "fitness", path), f"{path}: [fitness]"
    check_keys(about, ("file", "body", "function", "duration", "omega"), where, [])
    function = str(about.get("function", "distance"))
    fitness_function(function)
    if function not in POSITION_FUNCTIONS:
        raise InputError(f"{where}: function {function!r}: expected one of {', '.join(POSITION_FUNCTIONS)}")
    for key in ("duration", "omega"):
        if not is_number(about.get(key)) or about[key] <= 0:
            raise InputError(f"{where}: {key} = {about.get(key)!r}: expected a positive number")
    bodies = part_names(head.model, "body")
    body = str(about.get("body"))
    if body not in bodies:
        raise InputError(f"{where}: the model has no body {body!r}; nearest: {nearest_names(body, bodies)}")
    file = file_inside(about, "file", head.folder, where)
    if not file.is_file():
        raise InputError(f"{where}: there is no file {file}")
    table = read_table(file)
    fitness = _column(table, "fitness", file)
    controller = _controllers(table, part_names(head.model, "actuator"), file)
    kept = np.isfinite(fitness) & np.isfinite(np.concatenate(list(controller.values()), axis=1)).all(axis=1)
    test = _split(table, kept, file)
    return FitnessTable(
        head=head,
        **{name: values[kept] for name, values in controller.items()},
        omega=float(about["omega"]),
        duration=float(about["duration"]),
        body=body,
        function=function,
        fitness=fitness[kept],
        test=test,
    )


def _column(table: pl.DataFrame, name: str, file: Path) -> np.ndarray:
    if name not in table.columns:
        raise InputError(f"{file}: there is no column {name!r}; nearest: {nearest_names(name, table.columns)}")
    series = table[name]
    if not (series.dtype.is_numeric() or series.dtype == pl.Null):
        raise InputError(f"{file}: column {name!r} holds {series.dtype}, expected numbers")
    return series.cast(pl.Float64).fill_null(np.nan).to_numpy()


def _controllers(table: pl.DataFrame, actuators: Sequence[str], file: Path) -> dict[str, np.ndarray]:
    """Amplitudes, phases and offsets (rows, nu)."""
    numbered = "a_1" in table.columns
    out = {}
    for name, short in (("amplitude", "a"), ("phase", "phi")):
        columns = [f"{short}_{i + 1}" if numbered else f"{name}/{a}" for i, a in enumerate(actuators)]
        out[name] = np.stack([_column(table, column, file) for column in columns], axis=1)
    offsets = [f"offset/{a}" for a in actuators]
    out["offset"] = np.stack(
        [_column(table, c, file) if c in table.columns else np.zeros(len(table)) for c in offsets], axis=1
    )
    return out


def _split(table: pl.DataFrame, kept: np.ndarray, file: Path) -> np.ndarray:
    """Held-out trials among those that are kept, (M,) bool."""
    if "split" in table.columns:
        words = [word for word, keep in zip(table["split"].to_list(), kept, strict=True) if keep]
        for word in words:
            if word not in ("fit", "test"):
                raise InputError(f"{file}: split {word!r}: expected 'fit' or 'test'")
        test = np.array([word == "test" for word in words], bool)
    else:
        test = np.zeros(int(kept.sum()), bool)
        test[len(test) - len(test) // 4 :] = True
    if min(test.sum(), (~test).sum()) < _LEAST:
        raise InputError(
            f"{file}: {int((~test).sum())} trials to fit and {int(test.sum())} held out; expected at least {_LEAST} of "
            "each"
        )
    return test


def save_fitness(folder: str | Path, xml: str, about: Mapping[str, Any], columns: Mapping[str, Any]) -> None:
    """Write a folder that `load_fitness` reads: the believed model as MJCF, the table's columns.

    Entries of [fitness] are body, function, duration and omega.

    Raises:
      OSError: the folder cannot be written to.
    """
    folder = Path(folder)
    lines = ["[model]", 'file = "model.xml"', "", "[fitness]", 'file = "trials.csv"']
    lines += [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {float(v)!r}" for k, v in about.items()]
    for name, text in (("model.xml", xml), (DATASET_FILE, "\n".join(lines) + "\n")):
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
    write_table(folder / "trials.csv", columns)


def preflight_fitness(table: FitnessTable) -> list[Finding]:
    """Findings, errors first: numbers of trials, and whether controllers and fitness vary."""
    fit, test = int((~table.test).sum()), int(table.test.sum())
    low, high = float(table.fitness.min()), float(table.fitness.max())
    summary = f"{fit} trials to fit and {test} held out of {table.duration:g} s, fitness {low:.3g} to {high:.3g}"
    findings = [Finding("note", "data", summary)]
    controllers = np.concatenate([table.amplitude, table.phase, table.offset], axis=1)
    if np.ptp(controllers, axis=0).max() == 0:
        findings.append(Finding("error", "excitation", "every trial has the same controller; try different ones"))
    elif high - low < 1e-6 * max(abs(high), 1.0):
        findings.append(
            Finding("error", "excitation", f"every trial has the same fitness ({low:.6g}); nothing can be told")
        )
    if fit < 20:
        findings.append(Finding("warning", "data", f"{fit} trials to fit are few; the ranking will be a guess"))
    return sorted(findings, key=lambda finding: finding.level != "error")
