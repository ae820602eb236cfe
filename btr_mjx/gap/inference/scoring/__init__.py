"""Evaluation of hypotheses on windows: screening, linear scans, refinement by simulation, remaining forces."""
