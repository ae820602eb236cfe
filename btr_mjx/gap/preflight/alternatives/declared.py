"""Lines of dataset.toml that declare what a change of columns does: their order, their units and their signs.

Velocities go with positions, measured forces with commands.
"""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, control_columns, quoted, state_columns, unit_text
from btr_mjx.gap.preflight.lerobot_tables import joint_lines, toml_lines
from btr_mjx.gap.preflight.predictions import Change
from btr_mjx.gap.preflight.stretches import motion_seconds

_SPEEDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): (1.0, np.pi / 180, 2 * np.pi, 2 * np.pi / 60),
    int(mujoco.mjtJoint.mjJNT_SLIDE): (1.0, 1e-2, 1e-3),
}
"""Factors to SI units that velocities may have, whatever the positions beside them have."""


def declared_lines(dataset: Dataset, change: Change) -> tuple[str, ...]:
    """What to write into dataset.toml, and to run then.

    There are no lines for columns without names in the logs, and for what dataset.toml cannot say: another zero, the
    sign of a quaternion, gravity.
    """
    if change.gravity is not None or change.qpos.offset.any() or change.ctrl.offset.any():
        return ()
    return joint_lines(dataset, change) if dataset.scales else _column_lines(dataset, change)


def _column_lines(dataset: Dataset, change: Change) -> tuple[str, ...]:
    """Lines of the tables [columns] and [units]."""
    model, sources = dataset.model, dataset.sources
    positions, velocities = state_columns(model)
    controls = control_columns(model)
    pairs, factors = list[tuple[str, str]](), dict[str, tuple[str, float]]()
    for columns, own in ((positions, change.qpos), (controls, change.ctrl)):
        moved = (own.source != np.arange(len(own.source))).any()
        pairs += [(columns[k], columns[i]) for i, k in enumerate(own.source)] if moved else []
        factors |= {columns[k]: (columns[i], own.scale[i]) for i, k in enumerate(own.source) if own.scale[i] != 1}
    measured = np.any([r.qvel_measured for r in dataset.recordings], axis=0)
    known = set(sources) if sources else {velocities[v] for v in np.flatnonzero(measured)}
    owner = dict(zip(model.jnt_qposadr.tolist(), range(model.njnt), strict=True))
    for i, k in enumerate(change.qpos.source):
        if i not in owner or k not in owner or int(model.jnt_type[owner[i]]) not in _SPEEDS:
            continue
        old, new = velocities[model.jnt_dofadr[owner[k]]], velocities[model.jnt_dofadr[owner[i]]]
        if old not in known:
            continue
        pairs += [(old, new)] if any(target == positions[i] for _, target in pairs) else []
        if change.qpos.scale[i] != 1 and measured[model.jnt_dofadr[owner[k]]]:
            factors[old] = new, _speed_factor(dataset, change, owner[i], owner[k])
    pairs += [(f"force/{old[5:]}", f"force/{new[5:]}") for old, new in pairs if f"force/{old[5:]}" in sources]
    named = [(sources.get(old, "" if sources else old), new) for old, new in pairs]
    units = [
        (sources.get(old, "" if sources else old), unit_text(new, factor * dataset.factors.get(old, 1.0), model))
        for old, (new, factor) in factors.items()
        if factor != 1
    ]
    if not all(name and text for name, text in [*named, *units]):
        return ()
    renamed = [f"{quoted(old)} = {quoted(new)}" for old, new in named if old != new]
    stated = [f"{quoted(name)} = {quoted(text)}" for name, text in units]
    tables = [*(["[columns]", *renamed] if renamed else []), *(["[units]", *stated] if stated else [])]
    return toml_lines(dataset, tables) if tables else ()


def _speed_factor(dataset: Dataset, change: Change, joint: int, source: int) -> float:
    """The factor of the measured velocities of `source` that fits the slope of a joint's changed positions best."""
    model, seconds = dataset.model, motion_seconds(dataset)
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[source])
    both = squared = 0.0
    for recording in dataset.recordings:
        time, velocity = recording.time, recording.qvel[:, v]
        lag = max(1, round(seconds / float(np.median(np.diff(time)))))
        path = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (velocity[1:] + velocity[:-1]))])
        chord, integral = (x[lag:] - x[:-lag] for x in (change.qpos(recording.qpos)[:, q], path))
        both, squared = both + float(chord @ integral), squared + float(integral @ integral)
    ratio = both / squared if squared else 1.0
    sizes = {*_SPEEDS[int(model.jnt_type[joint])], abs(float(change.qpos.scale[q]))}
    size = min(sizes, key=lambda factor: abs(np.log(max(abs(ratio), 1e-300) / factor)))
    return size if ratio > 0 else -size
