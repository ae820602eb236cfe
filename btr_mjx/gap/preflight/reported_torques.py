"""Checks of forces that drives report, against those that the believed model has with the same commands."""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording, quoted
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.lerobot_tables import toml_lines
from btr_mjx.models import part_names

_FOLLOWS = 0.5
"""Correlation from which on a report follows the force of the model, in either direction."""

_OFF = 3.0
"""Factor between the two that no weak motor and no torque constant has."""

_SAMPLES = 500
"""Samples of a recording that are looked at."""


def reported_torques(dataset: Dataset) -> list[Finding]:
    """Errors of reports with the wrong sign or in another unit, such as currents; nothing where there are none."""
    drives = dataset.reporting
    if not drives:
        return []
    names = part_names(dataset.model, "actuator")
    every = [_both(recording, drives) for recording in dataset.recordings]
    believed, reported = (np.concatenate(own) for own in zip(*every, strict=True))
    findings = []
    for column, drive in enumerate(drives):
        force, report = believed[:, column], reported[:, column]
        if min(np.ptp(force), np.ptp(report)) <= 1e-9:
            continue
        name, r = names[drive], float(np.corrcoef(force, report)[0, 1])
        factor = float(report.std() / force.std())
        evidence = {"correlation": r, "factor": factor}
        column_of_log = dataset.sources.get(f"force/{name}", f"force/{name}")
        lines = toml_lines(dataset, ["[columns]", f"{quoted(column_of_log)} = {quoted(f'sensor/{name}')}  # unused"])
        if r < -_FOLLOWS:
            message = (
                f"{column_of_log}: this force has the opposite sign of what drives the joint of {name} (correlation "
                f"{r:.2f}); negate it, or leave it out"
            )
            findings.append(Finding("error", "convention", message, evidence=evidence, lines=lines))
        elif r > _FOLLOWS and not 1 / _OFF < factor < _OFF:
            message = (
                f"{column_of_log}: this force is {factor:.3g} times that of {name} in the model: another unit, or a "
                f"current whose torque constant would be {1 / factor:.3g}; state its unit in [units], convert it, or "
                "leave it out"
            )
            findings.append(Finding("error", "units", message, evidence=evidence, lines=lines))
    return findings


def _both(recording: Recording, drives: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """(K, m) forces of the model at measured states, and reported ones."""
    model, index = recording.model, np.unique(np.linspace(0, len(recording.time) - 1, _SAMPLES).astype(int))
    data, out = mujoco.MjData(model), np.empty((len(index), len(drives)))
    for row, k in enumerate(index):
        data.qpos[:], data.qvel[:], data.ctrl[:] = recording.qpos[k], recording.qvel[k], recording.ctrl[k]
        mujoco.mj_forward(model, data)
        out[row] = data.actuator_force[drives]
    return out, recording.reported(drives)[index]
