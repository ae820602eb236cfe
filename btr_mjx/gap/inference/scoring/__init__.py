"""Hypotheses against windows: screening, linear scans, refinement, and what a hypothesis leaves."""
