"""Answers judged by forces: laws that no library has, and numbers of drives that all are missing at once."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from hidden_cases.field_cases import FRESH
from hidden_cases.field_laws import hidden_force
from hidden_cases.torque_arms import JOINTS

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.results import FoundEffect, resolve_effect
from btr_mjx.gap.simulate import Rows, World
from gates.rows import Row, name_of, row_of

CLOSE = 0.25
"""Largest error of a force that is right, as a part of that of the law (root mean square)."""
CLOSE_NUMBER = 0.1
"""Relative error of a number of a drive that is right."""
DRIVES = {"friction": "dry_friction", "damping": "viscous_damping", "rotor": "armature"}


def positions(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """(N, nv) positions of hinges and slides from configurations (N, nq)."""
    out = np.zeros((len(qpos), model.nv))
    for j in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        out[:, model.jnt_dofadr[j]] = qpos[:, model.jnt_qposadr[j]]
    return out


def true_force(
    law: Mapping[str, Any], model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """(N, nv) force of a law where joints slide."""
    force, is_friction = hidden_force(law, model)
    rows = zip(positions(model, qpos), qvel, time, strict=True)
    return np.array([force(q, v, t) * (-np.sign(v) if is_friction else 1.0) for q, v, t in rows])


def found_force(
    effects: Sequence[Mapping[str, Any]],
    model: mujoco.MjModel,
    qpos: np.ndarray,
    qvel: np.ndarray,
    torque: np.ndarray,
    time: np.ndarray,
) -> np.ndarray:
    """(N, nv) generalised force that named effects add where joints slide, at rest of accelerations.

    Args:
      effects: entries of result.json.
      model: the believed robot.
      qpos: (N, nq).
      qvel: (N, nv).
      torque: (N, nv) forces of the actuators.
      time: (N,) [s].
    """
    worlds = [World.of(model), World.of(model)]
    for entry in effects:
        effect, place, values = resolve_effect(model, FoundEffect.from_result(entry), KNOWN_EFFECTS)
        effect.apply(worlds[1], place, values)
    before, after = (_force(world, qpos, qvel, torque, time) for world in worlds)
    return after - before


def _force(world: World, qpos: np.ndarray, qvel: np.ndarray, torque: np.ndarray, time: np.ndarray) -> np.ndarray:
    model = world.update_constants()
    n, data = len(qpos), mujoco.MjData(model)
    loss = np.tile(model.dof_frictionloss, (n, 1))
    fields = {"dof_frictionloss": loss}
    fields |= {
        name: np.tile(getattr(model, name), (n, *[1] * getattr(model, name).ndim))
        for law in world.laws
        for name in law.fields
        if name not in fields
    }
    applied = np.zeros((n, model.nv))
    rows = Rows(
        model,
        time,
        qpos,
        qvel,
        np.zeros((n, model.na)),
        np.zeros((n, model.nu)),
        applied,
        np.zeros((n, model.nbody, 6)),
        np.zeros((n, model.nactuator)),
        torque,
        fields,
    )
    for law in world.laws:
        law(rows)
    model.dof_frictionloss[:] = 0
    out = applied - loss * np.sign(qvel)
    for i in range(n):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[i], qvel[i], 0.0
        mujoco.mj_inverse(model, data)
        out[i] -= data.qfrc_inverse
    return out


def judge_law(data: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """Whether the force of what is named is that of the hidden law on states of another motion.

    A dead band is right by its name, as it is the library's backlash. Laws are not sought where a robot touches the
    world: there "unexplained" is right without a name.
    """
    (hidden,) = truth["effects"]
    named = [name_of(effect) for effect in answer["effects"]]
    if hidden["effect"] == "backlash":
        right = named == [name_of(hidden)]
        return row_of(answer, name_of(hidden), right, [] if right else named)
    model = mujoco.MjModel.from_xml_path(str(data / "model.xml"))
    fresh = np.load(data.with_name(FRESH))
    true = true_force(hidden, model, fresh["qpos"], fresh["qvel"], fresh["time"])
    found = found_force(answer["effects"], model, *(fresh[name] for name in ("qpos", "qvel", "torque", "time")))
    close = float(np.sqrt(((found - true) ** 2).sum() / (true**2).sum())) <= CLOSE
    right = answer["verdict"] == "effect" and close
    if truth["robot"] == "legged":
        right = right or (answer["verdict"] == "unexplained" and not named)
    return row_of(answer, f"{hidden['kind']}@{hidden['location']}", right, [] if close else named)


def judge_drives(_: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """Whether friction and rotors of all drives are within 10 %; numbers, dampings too, count as inside by that."""
    close = {}
    for name, effect in DRIVES.items():
        total = np.zeros(JOINTS)
        for one in (*answer["effects"], *answer.get("calibration", ())):
            for number, own in one["parameters"].items() if one["effect"] == effect else ():
                at = [f"[j{i}]" in number or one["location"] in (f"joint:j{i}", "all") for i in range(JOINTS)]
                total += own["value"] * np.array(at)
        close[name] = np.abs(total / np.array(truth[name]) - 1) < CLOSE_NUMBER
    right = bool(close["friction"].all() and close["rotor"].all())
    false = [name_of(effect) for effect in answer["effects"] if effect["effect"] not in DRIVES.values()]
    inside = [bool(ok) for own in close.values() for ok in own]
    return row_of(answer, "friction, damping and rotors of all joints", right, false, inside=inside)
