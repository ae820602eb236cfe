"""Data of the figures, read from the files of a run folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from btr_mjx.errors import InputError
from btr_mjx.models import chosen_robot, kept_files
from btr_mjx.robots import Box, Robot
from btr_mjx.runs import read_arrays, read_config_json, read_json, read_table


@dataclass(frozen=True, eq=False)
class Search:
    """All members of one evolutionary search.

    Attributes:
      iteration: 1, 2, ...
      parameters: (g, population, n) of every generation.
      scores: (g, population) their fitness or Delta_fitness; NaN for members that diverged.
      part: 2 for the search of simulations after the simulator grew in this iteration.
    """

    iteration: int
    parameters: np.ndarray
    scores: np.ndarray
    part: int = 1


@dataclass(frozen=True, eq=False)
class RunData:
    """A finished run of Back-to-Reality.

    Attributes:
      fitness: name of the fitness function.
      unit: its unit, "" where it is not known.
      maximise: whether larger is better.
      box: the unknown parameters with their bounds and units.
      start: (n,) their values in s_0.
      identified: (n,) in the last simulation.
      truth: (n,) in reality; None where they are not known.
      iterations: one row per iteration, see `algorithm`.
      trials: controllers, f_r, f_s and iteration of every evaluation in reality; iteration 0 is the first controller.
      controllers: step 1 of every iteration.
      simulations: step 3 of every iteration.
      result: result.json.
      distance: what step 3 minimised, "fitness" (Delta_fitness) or "multiscale".
    """

    fitness: str
    unit: str
    maximise: bool
    box: Box
    start: np.ndarray
    identified: np.ndarray
    truth: np.ndarray | None
    iterations: pl.DataFrame
    trials: dict[str, np.ndarray]
    controllers: list[Search]
    simulations: list[Search]
    result: dict[str, Any]
    distance: str = "fitness"

    @property
    def distance_symbol(self) -> str:
        """Symbol of the distance that step 3 minimised."""
        return r"$\Delta_{fitness}$" if self.distance == "fitness" else "multiscale distance"

    @property
    def distance_label(self) -> str:
        """Axis label of that distance, with its unit (the multiscale distance has none)."""
        return with_unit(self.distance_symbol, self.unit if self.distance == "fitness" else "")

    @property
    def fitness_label(self) -> str:
        """Axis label of the fitness, with its unit."""
        words = {"distance": "distance / duration"}.get(self.fitness, self.fitness.replace("_", " "))
        return with_unit(f"fitness ({words})", self.unit)


@dataclass(frozen=True, eq=False)
class ScanData:
    """A scan of one parameter.

    Attributes:
      parameter: its name.
      parameter_unit: its unit.
      unit: of the fitness.
      grid: (G,) its values.
      truth: its value in reality, NaN where it is not known.
      delta: (G, m) delta_k.
      delta_fitness: (G,) their mean.
      result: result.json.
    """

    parameter: str
    parameter_unit: str
    unit: str
    grid: np.ndarray
    truth: float
    delta: np.ndarray
    delta_fitness: np.ndarray
    result: dict[str, Any]


def with_unit(text: str, unit: str) -> str:
    """`text [unit]`, or the text without a unit."""
    return f"{text} [{unit}]" if unit else text


def read_run(folder: Path) -> RunData:
    """Read a run folder of `python -m btr_mjx.coevolve`.

    Raises:
      InputError: not a run folder, a run that has not ended, or a damaged file.
    """
    config = read_config_json(folder)
    result = _result(folder)
    names = list(result["simulation"])
    if "space" not in result:
        raise InputError(f"{folder}: result.json has no 'space': another version wrote this run; draw it with that one")
    space = result["space"]
    values = lambda key: np.array([float(result[key][name]) for name in names])  # noqa: E731
    count = int(result["iterations"])
    table = read_table(folder / "iterations.csv")
    # An iteration in which the simulator grew has a second search of simulations, and a second row.
    numbers = table["iteration"].to_list()
    searches = [(number, 1 + numbers[:k].count(number)) for k, number in enumerate(numbers)]
    return RunData(
        fitness=result["fitness"],
        unit=result["fitness_unit"],
        maximise=bool(result["maximise"]),
        # The robot's files need not be available to draw curves.
        box=Box(
            names,
            [space[name]["low"] for name in names],
            [space[name]["high"] for name in names],
            bits=int(config.get("simulation_bits", 8)),
            units=[space[name]["unit"] for name in names],
        ),
        start=values("start"),
        identified=values("simulation"),
        truth=None if result["truth"] is None else np.array([result["truth"].get(name, np.nan) for name in names]),
        iterations=table,
        trials=read_arrays(folder / "trials.npz"),
        controllers=[_search(folder, "controllers", "fitness", i) for i in range(1, count + 1)],
        simulations=[_search(folder, "simulations", "delta_fitness", *search, names) for search in searches],
        result=result,
        distance=result.get("distance", "fitness"),
    )


def read_robot(folder: Path) -> Robot:
    """The robot of a run folder, from the run's own copy where there is one.

    Raises:
      InputError: not a run folder, or the template of its config cannot be read.
    """
    config = read_config_json(folder)
    kept = kept_files(folder)
    names = ("robot", "template")
    files = [None if config.get(key) is None else kept.get(key, Path(config[key])) for key in names]
    return chosen_robot(files[0], files[1], config.get("duration"))


def read_scan(folder: Path) -> ScanData:
    """Read a run folder of `python -m btr_mjx.scan`, or scan.npz and result.json in the same format.

    Raises:
      InputError: no scan, a scan that has not ended, or a damaged file.
    """
    result = _result(folder)
    arrays = read_arrays(folder / "scan.npz")
    return ScanData(
        parameter=str(arrays["parameter"]),
        parameter_unit=result.get("parameter_unit", ""),
        unit=result.get("fitness_unit", ""),
        grid=arrays["grid"],
        truth=float(arrays["truth"]),
        delta=arrays["delta"],
        delta_fitness=arrays["delta_fitness"],
        result=result,
    )


def kind_of_run(folder: str | Path) -> str:
    """What a folder is the run of: "coevolve", "scan" or "diagnose".

    Raises:
      InputError: none of these, or a run that has not ended.
    """
    folder = Path(folder)
    if not (folder / "result.json").is_file():
        raise InputError(
            f"{folder} holds no result.json: expected a run folder of btr_mjx.coevolve, scan or diagnose that has "
            "ended; continue one that has not with --resume"
        )
    if (folder / "scan.npz").is_file():
        return "scan"
    result = read_json(folder / "result.json")
    for key, kind in (("verdict", "diagnose"), ("best_controller", "coevolve"), ("iterations", "coevolve")):
        if isinstance(result, dict) and key in result:
            return kind
    raise InputError(f"{folder}: result.json is not that of btr_mjx.coevolve, scan or diagnose")


def _result(folder: Path) -> dict[str, Any]:
    if not (folder / "result.json").is_file():
        raise InputError(f"{folder} holds no result.json: its run has not ended; continue it with --resume")
    return read_json(folder / "result.json")


def _search(
    folder: Path, kind: str, score: str, iteration: int, part: int = 1, names: list[str] | None = None
) -> Search:
    arrays = read_arrays(folder / f"{kind}-{iteration:03d}{'' if part == 1 else f'-{part}'}.npz")
    parameters = arrays["parameters"]
    if names is not None:  # a simulator that grew later has no values of the numbers that came with it
        own = [str(name) for name in arrays["names"]]
        absent = np.full(parameters.shape[:-1], np.nan)
        parameters = np.stack([parameters[..., own.index(n)] if n in own else absent for n in names], axis=-1)
    return Search(iteration, parameters, arrays[score], part)
