"""Checks of time: sampling, clocks, commands between samples, the time step of the model."""
