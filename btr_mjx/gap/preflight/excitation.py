"""Excitation of each joint in the recordings, and effects that are therefore not identifiable."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.effects import actuator_count, ground_geoms, joint_of
from btr_mjx.models import difference, part_names

NO_GROUND = "nothing can touch the ground"
"""Reason of effects that the model itself rules out, whatever is recorded."""

_LEAST_MOTION = 1e-4
"""Range of a coordinate beyond which it moves [rad or m]."""

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, eq=False)
class JointTrack:
    """Samples of a hinge or slide, concatenated over all recordings.

    Attributes:
      name: of the joint.
      hinge: whether it is a hinge.
      actuator: id of the actuator that drives it; None without one.
      servo: whether the actuator is a position servo.
      limits: (2,) range in the model [rad or m]; None if unlimited.
      qpos: (N,) measured position.
      slope: (N,) central differences of the positions.
      ctrl: (N,) commands, (0,) without an actuator.
    """

    name: str
    hinge: bool
    actuator: int | None
    servo: bool
    limits: np.ndarray | None
    qpos: np.ndarray
    slope: np.ndarray
    ctrl: np.ndarray


def joint_tracks(dataset: Dataset) -> list[JointTrack]:
    """The samples of every hinge and slide of a dataset."""
    model = dataset.model
    driven = {joint_of(model, a): a for a in range(actuator_count(model))}
    slopes = [_slopes(r) for r in dataset.recordings]
    out = []
    for j, name in enumerate(part_names(model, "joint")):
        kind = int(model.jnt_type[j])
        if kind not in (_HINGE, _SLIDE) or not all(r.seen[model.jnt_dofadr[j]] for r in dataset.recordings):
            continue
        q, v = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        a = driven.get(j)
        servo = a is not None and float(model.actuator_biasprm[a, 1]) < 0
        out.append(
            JointTrack(
                name,
                kind == _HINGE,
                a,
                servo,
                model.jnt_range[j] if model.jnt_limited[j] else None,
                np.concatenate([r.qpos[:, q] for r in dataset.recordings]),
                np.concatenate([s[:, v] for s in slopes]),
                np.concatenate([r.ctrl[:, a] for r in dataset.recordings]) if a is not None else np.zeros(0),
            )
        )
    return out


def _slopes(recording: Recording) -> np.ndarray:
    """(K, nv) velocities from central differences of the positions."""
    span = (recording.time[2:] - recording.time[:-2])[:, None]
    inner = difference(recording.model, recording.qpos[:-2], recording.qpos[2:]) / span
    return np.concatenate([inner[:1], inner, inner[-1:]])


def unexcited_effects(dataset: Dataset, joints: Sequence[JointTrack]) -> dict[str, str]:
    """Reason why these data do not excite an effect, by the name of each effect that is checked; "" where they do."""
    model = dataset.model
    moving = [j for j in joints if np.ptp(j.qpos) > _LEAST_MOTION]
    driven = [j for j in moving if j.actuator is not None]
    reversals = [int(np.count_nonzero(np.diff(np.sign(j.slope)))) for j in moving]
    anything = bool(moving) or moves(dataset)
    feet, _ = ground_geoms(model)
    nothing = "" if anything else "nothing moves"
    jointless = "" if joints else "the model has no hinge or slide"
    still = jointless or ("" if moving else "no joint moves")
    unpowered = "" if actuator_count(model) else "the model has no actuators"
    # Thrusters act at sites, cables at tendons: they drive what they are attached to, not one joint.
    elsewhere = any(joint_of(model, a) is None for a in range(actuator_count(model)))
    undriven = unpowered or ("" if driven or (elsewhere and anything) else "no driven joint moves")
    undriven_joints = unpowered or ("" if driven else "no joint that an actuator drives directly moves")
    turns = "" if max(reversals, default=0) >= 4 else "no joint reverses its motion more than a few times"
    ground = "" if feet else NO_GROUND
    commanded = any(np.ptp(r.ctrl, axis=0).any() for r in dataset.recordings)
    constant = unpowered or ("" if commanded else "every command is constant")
    weight = np.linalg.norm(model.opt.gravity) > 0
    return {
        "viscous_damping": still,
        "dry_friction": still or turns,
        "load_friction": undriven_joints or turns,
        "stribeck_friction": still or turns,
        "armature": still,
        "joint_stiffness": still,
        "joint_offset": jointless or ("" if feet or weight else "no weight, no contact"),
        "backlash": undriven_joints or turns,
        "actuator_delay": constant or undriven,
        "actuator_lag": constant or undriven or _one_tone(dataset),
        "command_rate_limit": constant or undriven,
        "actuator_gain": undriven,
        "torque_limit": undriven,
        "ground_friction": ground,
        "ground_slope": "" if weight else "there is no gravity",
        "contact_softness": ground,
        "air_drag": nothing,
    }


def moves(dataset: Dataset) -> bool:
    """Whether a free or ball joint moves in a recording."""
    model = dataset.model
    others = ~np.isin(model.jnt_type[model.dof_jntid], (_HINGE, _SLIDE))
    if not others.any():
        return False
    away = (np.ptp(difference(model, r.qpos[:1], r.qpos)[:, others], axis=0) for r in dataset.recordings)
    return any((far > _LEAST_MOTION).any() for far in away)


def _one_tone(dataset: Dataset) -> str:
    """Reason why lag and delay cannot be distinguished (every command is one sine); "" if they can."""
    peaks = []
    for recording in dataset.recordings:
        even = np.linspace(recording.time[0], recording.time[-1], len(recording.time))
        for column in recording.ctrl.T:
            wave = np.interp(even, recording.time, column)
            wave = (wave - wave.mean()) * np.hanning(len(wave))
            power = np.abs(np.fft.rfft(wave)) ** 2
            if power.sum() == 0:
                continue
            top = int(np.argmax(power))
            if power[max(0, top - 2) : top + 3].sum() < 0.95 * power.sum():
                return ""
            peaks.append(top / (even[-1] - even[0]))
    if peaks and np.ptp(peaks) <= 0.1 * np.median(peaks):
        return (
            f"every command is one sine of {np.median(peaks):.3g} Hz, where a lag is the same as a delay with less "
            "amplitude; record a second frequency"
        )
    return ""
