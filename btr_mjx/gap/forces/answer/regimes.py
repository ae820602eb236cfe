"""Where force is missing: a map over joints and regimes of the motion, and words for what nothing explains."""

import mujoco
import numpy as np

from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.answer.joint_forces import random_force
from btr_mjx.gap.forces.law_scan import law_words
from btr_mjx.gap.forces.missing_force import commanded_share
from btr_mjx.gap.forces.points import Fitted
from btr_mjx.gap.results import DisagreementMap, force_places, format_number, mean_map, place_in_words
from btr_mjx.models import part_names

_SLIGHT = 1e-2
"""Part of the usual force of a joint that nobody would miss."""

_CAP = 1e4
"""Largest squared force in a map, in units of its variance."""


def map_of_forces(model: mujoco.MjModel, found: SearchOutcome, shown: Fitted) -> DisagreementMap:
    """The missing force by place and regime.

    Args:
      model: the believed model.
      found: by the search.
      shown: the fit of the mended model; the first of the chain where there is none.
    """
    missing, first = found.missing, found.chain[0]
    force = random_force(first)
    left = force if shown is first else random_force(shown)
    usual = (missing.actuator**2).mean((0, 1)) + (missing.force**2).mean((0, 1))
    floor = np.maximum(found.chain[-1].variances.force, _SLIGHT**2 * usual + 1e-300)
    square = np.minimum(force**2 / floor, _CAP)
    speed, load = np.abs(missing.velocity), np.abs(missing.actuator)
    middle = np.array([r.time.mean() for r in found.side.stretches.data.recordings])
    late = found.side.stretches.time[:, :-1] > middle[found.side.stretches.recording][:, None]
    late = np.broadcast_to(late[..., None], square.shape)
    masks = {
        "all": np.ones(square.shape, bool),
        "slow": speed <= np.median(speed, (0, 1)),
        "fast": speed > np.median(speed, (0, 1)),
        "low load": load <= np.median(load, (0, 1)),
        "high load": load > np.median(load, (0, 1)),
        "contact": np.zeros(square.shape, bool),
        "air": np.ones(square.shape, bool),
        "early": ~late,
        "late": late,
    }
    return mean_map(model, masks, force, None if shown is first else left, square)


def unexplained_words(model: mujoco.MjModel, found: SearchOutcome, left: DisagreementMap) -> tuple[str, ...]:
    """What is unexplained, in words.

    Args:
      model: the believed model.
      found: by the search.
      left: the missing force by place.
    """
    law = (law_words(model, found.law),) if found.law is not None else ()
    random = np.sqrt(found.chain[-1].variances.force)
    usual = np.sqrt((found.missing.actuator**2).mean((0, 1)))
    commanded = commanded_share(found.missing, float(np.median(np.diff(found.side.stretches.time, axis=1))))
    every = force_places(model)
    worst = np.argsort(-random / np.maximum(usual, 1e-300))
    said: dict[tuple[str, str], str] = {}
    for j in worst:
        if found.large[j] and every[j] not in said:
            label, unit = every[j]
            size, beside = format_number(left.size_at(label)), format_number(float(usual[j]))
            said[label, unit] = (
                f"{place_in_words(label)}: a force of {size} {unit} (root mean square) beside {beside} {unit} of its "
                f"actuators, whose commands predict {100 * commanded[j]:.0f} % of the force that its motion needs"
            )
    return (*law, *said.values())[:3]


def dof_labels(model: mujoco.MjModel) -> list[str]:
    """(nv,) the place of every degree of freedom.

    Args:
      model: the believed model.
    """
    joints, bodies = part_names(model, "joint"), part_names(model, "body")
    free = mujoco.mjtJoint.mjJNT_FREE
    return [
        f"body:{bodies[model.jnt_bodyid[j]]}" if model.jnt_type[j] == free else f"joint:{joints[j]}"
        for j in model.dof_jntid
    ]
