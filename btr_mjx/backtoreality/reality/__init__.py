"""Realities, in which the fitness of controllers is measured: the interface, and a simulated reality."""

from btr_mjx.backtoreality.reality.simulated import Reality, SimulatedReality

__all__ = ["Reality", "SimulatedReality"]
