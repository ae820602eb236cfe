"""Where measured fitness comes from."""

from btr_mjx.backtoreality.reality.simulated import Reality, SimulatedReality

__all__ = ["Reality", "SimulatedReality"]
