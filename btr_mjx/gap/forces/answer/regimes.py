"""Where force is missing: a map over joints and regimes of the motion, and words for what nothing explains."""

import mujoco
import numpy as np

from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.kalman_filter import smoothed
from btr_mjx.gap.forces.law_scan import law_words
from btr_mjx.gap.forces.missing_force import commanded_share
from btr_mjx.gap.results import (
    DisagreementMap,
)
from btr_mjx.models import dof_places, part_names

_SLIGHT = 1e-2
"""Part of the usual force of a joint that nobody would miss."""

_CAP = 1e4
"""Largest squared force in a map, in units of its variance."""


def map_of_forces(model: mujoco.MjModel, found: SearchOutcome) -> DisagreementMap:
    """Mean square of the missing force by joint and regime, in units of the random force that is left.

    Args:
      model: the believed model.
      found: by the search.
    """
    missing, first = found.missing, found.chain[0]
    force = smoothed(first.linear, np.zeros_like(first.linear.defect), first.variances).force
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
    every = dof_labels(model)
    places = tuple(dict.fromkeys(every))
    value, count = np.full((len(places), len(masks)), np.nan), np.zeros((len(places), len(masks)), int)
    for i, place in enumerate(places):
        own = np.array([name == place for name in every])
        for j, mask in enumerate(masks.values()):
            chosen = mask[..., own]
            count[i, j] = int(chosen.sum())
            if count[i, j]:
                value[i, j] = float(square[..., own][chosen].mean())
    return DisagreementMap(places, tuple(masks), value, count)


def unexplained_words(model: mujoco.MjModel, found: SearchOutcome) -> tuple[str, ...]:
    """What is unexplained, in words.

    Args:
      model: the believed model.
      found: by the search.
    """
    law = (law_words(model, found.law),) if found.law is not None else ()
    left = np.sqrt(found.chain[-1].variances.force)
    usual = np.sqrt((found.missing.actuator**2).mean((0, 1)))
    commanded = commanded_share(found.missing, float(np.median(np.diff(found.side.stretches.time, axis=1))))
    places = dof_places(model)
    worst = np.argsort(-left / np.maximum(usual, 1e-300))
    return (
        *law,
        *(
            f"{places[j][0]}: a force of {left[j]:.3g} {places[j][1]} (root mean square) beside {usual[j]:.3g} of its "
            f"actuators, whose commands predict {100 * commanded[j]:.0f} % of the force that its motion needs"
            for j in worst
            if found.large[j]
        ),
    )[:3]


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
