"""Realities, in which the fitness of controllers is measured: the interface, a simulated reality, a folder."""

from btr_mjx.backtoreality.reality.folder import FolderReality, Waiting
from btr_mjx.backtoreality.reality.instructions import Rounds
from btr_mjx.backtoreality.reality.model_file import numbers_of_file, robot_of_file, variables
from btr_mjx.backtoreality.reality.simulated import Reality, SimulatedReality

__all__ = [
    "FolderReality",
    "Reality",
    "Rounds",
    "SimulatedReality",
    "Waiting",
    "numbers_of_file",
    "robot_of_file",
    "variables",
]
