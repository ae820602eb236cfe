"""Back-to-Reality: co-evolve a robot's controller and its simulation.

`Problem` says what is searched, `State` is what lies between two pieces of work, `algorithm` has one function a step.
`SimulatedReality` plays the robot; anything with a `measure` method may take its place.
"""

from btr_mjx.backtoreality.algorithm import begin, evolve_controllers, select_transferable
from btr_mjx.backtoreality.config import PRESETS, CoevolveConfig, build_problem
from btr_mjx.backtoreality.folder import run_in_folder, write_trials
from btr_mjx.backtoreality.line_scan import (
    ScanConfig,
    along,
    check_scan,
    curve_statistics,
    delta,
    delta_fitness,
    run_scan,
)
from btr_mjx.backtoreality.reality.simulated import Reality, SimulatedReality
from btr_mjx.backtoreality.state import (
    BTRSettings,
    Problem,
    Progress,
    SearchSettings,
    State,
)
from btr_mjx.backtoreality.summary import summarise, summary_table

__all__ = [
    "PRESETS",
    "BTRSettings",
    "CoevolveConfig",
    "Problem",
    "Progress",
    "Reality",
    "ScanConfig",
    "SearchSettings",
    "SimulatedReality",
    "State",
    "along",
    "begin",
    "build_problem",
    "check_scan",
    "curve_statistics",
    "delta",
    "delta_fitness",
    "evolve_controllers",
    "run_in_folder",
    "run_scan",
    "select_transferable",
    "summarise",
    "summary_table",
    "write_trials",
]
