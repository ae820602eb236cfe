"""Balances of forces that a specialist looks at first: does what pushes carry the weight, and move what it drives?"""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, Recording, listed
from btr_mjx.gap.effects import joint_of
from btr_mjx.gap.preflight.comparison import compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Change, ColumnMap, Predictor
from btr_mjx.models import part_names

_SAMPLES = 400
"""Samples of a recording at which forces are computed."""

_CARRIES = 1.25
"""Largest factor, or its inverse, between mean force and weight: scales and thrust curves are better than that."""

_LIFTED = 0.05
"""Share of the weight below which a force is none that carries it."""

_STRETCHES, _FEWEST = 32, 5
"""Stretches that are predicted, and fewest that can decide."""

_POOR = 0.02
"""A joint whose error variance is below this share of its motion is moved by its commands."""

_RATIO = 4.0
"""Without its force, a joint must be predicted with half the error (rms)."""


def carried_weight(dataset: Dataset) -> list[Finding]:
    """A warning where forces do not carry a flying robot.

    Over a recording, the mean of all forces on a free body is its weight and what accelerates it. In flight those of
    the actuators, and of the medium, have to carry it; recordings in which something is touched say nothing.
    """
    model, findings = dataset.model, []
    for joint, name in enumerate(part_names(model, "joint")):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE or not np.any(model.opt.gravity):
            continue
        measured = [r for r in dataset.recordings if r.estimate is None]
        found = [both for r in measured if (both := _lifted(r, joint)) is not None]
        if not found:
            continue
        lift, weight, needed = np.sum(found, axis=0)
        # What nothing lifts is thrown, or stands on ground that the model has elsewhere.
        if min(needed, lift) < _LIFTED * weight:
            continue
        ratio = float(lift / needed)
        if not 1 / _CARRIES < ratio < _CARRIES:
            message = (
                f"the commands' forces on {name} are on average {ratio:.3g} times what carries its weight of "
                f"{weight / len(found):.3g} N in this flight: mass, gravity, or the unit of the commands is another one"
            )
            evidence = {"force_to_weight": ratio, "weight": float(weight / len(found))}
            findings.append(Finding("warning", "balance", message, evidence=evidence))
    return findings


def _lifted(recording: Recording, joint: int) -> tuple[float, float, float] | None:
    """Mean force against gravity, weight, and force that the motion needs [N]; None where something is touched."""
    model = recording.model
    v, data = int(model.jnt_dofadr[joint]), mujoco.MjData(model)
    size = float(np.linalg.norm(model.opt.gravity))
    up = -model.opt.gravity / size
    mass = float(model.body_subtreemass[model.jnt_bodyid[joint]])
    rows = np.unique(np.linspace(0, len(recording.time) - 1, _SAMPLES).astype(int))
    lift = np.empty(len(rows))
    for i, k in enumerate(rows):
        data.qpos[:], data.qvel[:], data.ctrl[:] = recording.qpos[k], recording.qvel[k], recording.ctrl[k]
        if model.na:
            data.act[:] = 0.0
            _settle(model, data)
        mujoco.mj_forward(model, data)
        if data.ncon or data.ne:
            return None
        lift[i] = (data.qfrc_actuator + data.qfrc_passive)[v : v + 3] @ up
    time = recording.time[rows]
    mean = float(np.trapezoid(lift, time) / (time[-1] - time[0]))
    speed = recording.qvel[:, v : v + 3] @ up
    edge = max(1, len(speed) // 50)  # sensors of velocity are noisy
    accelerated = (speed[-edge:].mean() - speed[:edge].mean()) / (recording.time[-1] - recording.time[0])
    return mean, mass * size, mass * (size + float(accelerated))


def _settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Set the last activation of each actuator to its command, which a filter follows."""
    for a in range(len(model.actuator_trntype)):
        if model.actuator_actadr[a] >= 0:
            data.act[model.actuator_actadr[a] + model.actuator_actnum[a] - 1] = data.ctrl[a]


def idle_drives(dataset: Dataset, noise: Noise) -> list[Finding]:
    """A warning of joints whose motion is predicted better without the force of their actuators."""
    model = dataset.model
    predictor = Predictor(dataset, noise, _STRETCHES)
    if len(predictor) < _FEWEST:
        return []
    none = Change.none(model)
    now = predictor.errors([none])[0]
    drives: dict[int, list[int]] = {}
    for a in range(len(model.actuator_trntype)):
        if (joint := joint_of(model, a)) is not None:
            drives.setdefault(joint, []).append(a)
    poor = [g for g, group in enumerate(predictor.groups) if np.median(now[:, g]) > _POOR and group.joint in drives]
    off = [
        Change(ColumnMap.affine(model.nq), ColumnMap.affine(model.nu), None, tuple(drives[predictor.groups[g].joint]))
        for g in poor
    ]
    names, actuators, findings = part_names(model, "joint"), part_names(model, "actuator"), list[Finding]()
    for g, without in zip(poor, predictor.errors(off) if off else (), strict=True):
        found = compare(now[:, g], without[:, g])
        if found.decisive(_RATIO):
            joint = predictor.groups[g].joint
            commands = listed(f"ctrl/{actuators[a]}" for a in drives[joint])
            message = (
                f"{commands} does not move {names[joint]}: without its force, the believed model predicts "
                f"{predictor.seconds:.2g} s ahead with {found.words()}; was the drive on, and is this its command?"
            )
            findings.append(Finding("warning", "balance", message, evidence=found.evidence()))
    return findings
