"""Rows that repeat, commands like stairs, and angles that jump by a turn."""

import numpy as np

from btr_mjx.gap.data import Dataset, find_wraps, held, listed, stairs
from btr_mjx.gap.preflight.findings import Finding, Level
from btr_mjx.models import part_names

_MIN_STEPS = 20
"""Changes of a command from which on stairs are certain."""


def held_positions(dataset: Dataset) -> list[Finding]:
    """Errors for joints that are refreshed more slowly than they are logged, each at rows of its own.

    Where all joints are refreshed together, the loader has taken the fresh rows already.
    """
    model, stale = dataset.model, list[str]()
    every = 0.0
    for j, name in enumerate(part_names(model, "joint")):
        q = int(model.jnt_qposadr[j])
        found = [held(r.qpos[:, q : q + 1]) for r in dataset.recordings]
        if all(one is not None and not one.coarse for one in found):
            stale.append(name)
            every = max(every, *(one.every for one in found if one is not None))
    if not stale:
        return []
    remedy = "log each row with new values of all joints, or interpolate each column between its changes"
    message = (
        f"positions of {listed(stale)} change every {every:.3g}th row only and repeat in between, other joints at "
        f"other rows: they are older than their time stamps; {remedy}"
    )
    return [Finding("error", "repeats", message, remedy, {"rows_between_changes": every})]


def held_commands(dataset: Dataset) -> list[Finding]:
    """An error for commands that are stairs where dataset.toml demands ramps between its rows."""
    ramps = [r for r in dataset.recordings if r.interpolation != "hold"]
    found = stairs([r.commands[1] for r in ramps])
    if found is None:
        return []
    interval = float(np.median(np.diff(ramps[0].commands[0])))
    remedy = 'interpolation = "hold" in [control] fits them'
    message = (
        f"commands are stairs: they change every {found.every:.3g}th row ({1 / interval / found.every:.4g} Hz) and "
        f'repeat in between, while dataset.toml says interpolation = "{ramps[0].interpolation}", which makes ramps of '
        f"one interval of them and a delay of {500 * interval:.3g} ms; {remedy}"
    )
    level: Level = "error" if len(found.rows) > _MIN_STEPS and not found.coarse else "warning"
    return [Finding(level, "repeats", message, remedy, {"rows_between_changes": found.every, "interval": interval})]


def angle_jumps(dataset: Dataset) -> list[Finding]:
    """Errors for hinges that jump by a turn and were not unwrapped: those with limits, and those in degrees."""
    findings: dict[str, Finding] = {}
    for recording in dataset.recordings:
        for wrap in find_wraps(recording.model, recording.qpos):
            name = part_names(recording.model, "joint")[wrap.joint]
            turn = "360" if wrap.turn > 100 else "2 pi"
            remedy = "unwrap it, and divide it by 57.3" if turn == "360" else "unwrap it, or remove the joint's limits"
            message = (
                f"qpos/{name} jumps by {turn} {len(wrap.rows)} times in {recording.name!r}, first at "
                f"{recording.time[wrap.rows[0]]:.6g} s; {remedy}"
            )
            findings.setdefault(name, Finding("error", "wrap", message, remedy, {"jumps": float(len(wrap.rows))}))
    return list(findings.values())
