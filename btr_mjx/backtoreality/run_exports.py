"""Identified parameters and the identified simulation of a finished run for other programs."""

from pathlib import Path

from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.run_state import Problem, State
from btr_mjx.exports import ExportedParameter, write_exports
from btr_mjx.gap.results import simulation_mjcf
from btr_mjx.runs import atomic_write, read_json, write_json


def export_simulation(folder: Path, problem: Problem, state: State) -> None:
    """Write the last simulation as simulation.xml; what MJCF cannot express is in simulation.json.

    Raises:
      OSError: a file cannot be written.
    """
    model = simulation_mjcf(grown(problem, state.grown).robot, state.simulation)
    with atomic_write(folder / "simulation.xml") as file:
        file.write(model.xml.encode("utf-8"))
    if model.terms or model.notes:
        write_json(folder / "simulation.json", model.as_json())


def export_coevolution(folder: Path) -> None:
    """Write the exports of a run folder that holds result.json, see `btr_mjx.exports`.

    A co-evolution gives values without intervals: the extent of the simulations that its trials cannot tell from the
    best one is an extent of what was tried, and need not hold the truth.

    Raises:
      DamagedFile: result.json was altered.
      OSError: a file cannot be read or written.
    """
    result = read_json(folder / "result.json")
    parameters = [
        ExportedParameter(
            name, result["space"][name]["unit"], float(value), None, None, "best of the last simulation search"
        )
        for name, value in result["simulation"].items()
    ]
    write_exports(folder, parameters)
