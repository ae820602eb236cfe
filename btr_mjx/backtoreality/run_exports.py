"""Identified parameters and the identified simulation of a finished run for other programs."""

from pathlib import Path

from btr_mjx.backtoreality.grown import grown, number_name
from btr_mjx.backtoreality.run_state import Problem, State
from btr_mjx.backtoreality.summary import NOT_TOLD
from btr_mjx.exports import ExportedParameter, write_exports
from btr_mjx.gap.results import simulation_mjcf
from btr_mjx.runs import read_json, write_json, write_text


def export_simulation(folder: Path, problem: Problem, state: State) -> None:
    """Write the last simulation as simulation.xml; what MJCF cannot express is in simulation.json.

    Raises:
      OSError: a file cannot be written.
    """
    model = simulation_mjcf(grown(problem, state.grown).robot, state.simulation)
    write_text(folder / "simulation.xml", model.xml)
    if model.terms or model.notes:
        write_json(folder / "simulation.json", model.as_json())


def export_coevolution(folder: Path) -> None:
    """Write the exports of a run folder that holds result.json, see `btr_mjx.exports`.

    Raises:
      DamagedFile: result.json was altered.
      OSError: a file cannot be read or written.
    """
    result, left = read_json(folder / "result.json"), folder / "simulation.json"
    terms = read_json(left)["terms"] if left.is_file() else []
    beside = {number_name(term["effect"], term["location"], name) for term in terms for name in term["parameters"]}
    parameters = []
    for name, value in result["simulation"].items():
        also = f"; needs {left.name} in a simulation" if name in beside else ""
        origin, unit = f"best of the last simulation search; 90 % interval{also}", result["space"][name]["unit"]
        low, high = result["told"]["intervals"][name]
        if name not in result["told"]["told"]:
            origin += f"; {NOT_TOLD}"
        parameters.append(ExportedParameter(name, unit, float(value), low, high, origin))
    write_exports(folder, parameters)
