"""Checks of a table of trials before any fit."""

import numpy as np

from btr_mjx.gap.fitness_only.table import FitnessTable
from btr_mjx.gap.preflight import Finding


def preflight_fitness(table: FitnessTable) -> list[Finding]:
    """Check numbers of trials, and that controllers and fitness vary.

    Args:
      table: the trials.

    Returns:
      Findings, errors first.
    """
    fit, test = int((~table.test).sum()), int(table.test.sum())
    low, high = float(table.fitness.min()), float(table.fitness.max())
    summary = f"{fit} trials to fit and {test} held out of {table.duration:g} s, fitness {low:.3g} to {high:.3g}"
    findings = [Finding("note", "data", summary)]
    controllers = np.concatenate([table.amplitude, table.phase, table.offset], axis=1)
    if np.ptp(controllers, axis=0).max() == 0:
        findings.append(Finding("error", "excitation", "every trial has the same controller; try different ones"))
    elif high - low < 1e-6 * max(abs(high), 1.0):
        findings.append(
            Finding("error", "excitation", f"every trial has the same fitness ({low:.6g}); nothing can be told")
        )
    if fit < 20:
        findings.append(Finding("warning", "data", f"{fit} trials to fit are few; the ranking will be a guess"))
    return sorted(findings, key=lambda finding: finding.level != "error")
