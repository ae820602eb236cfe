"""Back-to-Reality: co-evolve a robot's controller and its simulation.

`Problem` defines the robot, reality and settings, `State` is the resumable state between two pieces of work,
`algorithm` has one function per step. `SimulatedReality` is a simulated robot; any object with a `measure` method can
replace it.
"""

from btr_mjx.backtoreality.algorithm import begin
from btr_mjx.backtoreality.config import PRESETS, CoevolveConfig, build_problem, setting_of_robot
from btr_mjx.backtoreality.controller_search import evolve_controllers, select_transferable
from btr_mjx.backtoreality.given_settings import typed_settings
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import growth_sentence
from btr_mjx.backtoreality.kept_inputs import keep_inputs, with_kept_files
from btr_mjx.backtoreality.line_scan import (
    ScanConfig,
    along,
    build_scan,
    curve_statistics,
    delta,
    delta_fitness,
    run_scan,
)
from btr_mjx.backtoreality.reality import FolderReality, Reality, SimulatedReality, Waiting
from btr_mjx.backtoreality.resumable import inputs_of, run_in_folder, whole_trials
from btr_mjx.backtoreality.run_exports import export_coevolution, export_simulation
from btr_mjx.backtoreality.run_state import Problem, Progress, State
from btr_mjx.backtoreality.settings import BTRSettings, SearchSettings
from btr_mjx.backtoreality.settled_engine import with_engine_of_folder, with_measured_engine
from btr_mjx.backtoreality.summary import bound_words, prediction_errors, summarise, summary_table, value_note
from btr_mjx.backtoreality.told_words import identified_words

__all__ = [
    "PRESETS",
    "BTRSettings",
    "CoevolveConfig",
    "FolderReality",
    "Problem",
    "Progress",
    "Reality",
    "ScanConfig",
    "SearchSettings",
    "SimulatedReality",
    "State",
    "Waiting",
    "along",
    "begin",
    "bound_words",
    "build_problem",
    "build_scan",
    "curve_statistics",
    "delta",
    "delta_fitness",
    "evolve_controllers",
    "export_coevolution",
    "export_simulation",
    "grown",
    "growth_sentence",
    "identified_words",
    "inputs_of",
    "keep_inputs",
    "prediction_errors",
    "run_in_folder",
    "run_scan",
    "select_transferable",
    "setting_of_robot",
    "summarise",
    "summary_table",
    "typed_settings",
    "value_note",
    "whole_trials",
    "with_engine_of_folder",
    "with_kept_files",
    "with_measured_engine",
]
