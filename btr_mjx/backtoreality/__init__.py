"""Back-to-Reality: co-evolve a robot's controller and its simulation.

`Problem` says what is searched, `State` is what lies between two pieces of work, `algorithm` has one function a step.
`SimulatedReality` plays the robot; anything with a `measure` method may take its place.
"""

from btr_mjx.backtoreality.algorithm import evolve_controllers, select_transferable
from btr_mjx.backtoreality.reality.simulated import Reality, SimulatedReality
from btr_mjx.backtoreality.state import (
    BTRSettings,
    Problem,
    Progress,
    SearchSettings,
    State,
    state_from_arrays,
    state_to_arrays,
)
from btr_mjx.backtoreality.summary import summarise, summary_table

__all__ = [
    "BTRSettings",
    "Problem",
    "Progress",
    "Reality",
    "SearchSettings",
    "SimulatedReality",
    "State",
    "evolve_controllers",
    "select_transferable",
    "state_from_arrays",
    "state_to_arrays",
    "summarise",
    "summary_table",
]
