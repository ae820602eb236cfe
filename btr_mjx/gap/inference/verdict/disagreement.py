"""Where simulation and data disagree, before any fit: a map of the force that is missing, by joint and regime.

The unknown generalised forces that would make the believed model follow the data are fitted in short windows; a
residual force is where its cause is, while a residual motion spreads through the robot.
"""

import mujoco
import numpy as np

from btr_mjx.gap.inference.scoring.forces import Circumstances, ForceFit, Forces, beyond_noise
from btr_mjx.gap.results import DisagreementMap, mean_map
from btr_mjx.models import part_names

REGIMES = ("all", "slow", "fast", "low load", "high load", "contact", "air", "early", "late")

_CAP = 100.0
"""A squared force counts up to so much where places are compared, in units of its variance."""


def place_names(model: mujoco.MjModel) -> list[str]:
    """The place of every degree of freedom (nv,): its joint, or the body of a free joint."""
    joints, bodies = part_names(model, "joint"), part_names(model, "body")
    out = []
    for joint in model.dof_jntid:
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            out.append(f"body:{bodies[model.jnt_bodyid[joint]]}")
        else:
            out.append(f"joint:{joints[joint]}")
    return out


def disagreement(model: mujoco.MjModel, fit: ForceFit, forces: Forces, around: Circumstances) -> DisagreementMap:
    """The map.

    Args:
      model: the believed model.
      fit: of unknown forces to windows.
      forces: of the believed model's residual.
      around: circumstances of the same windows.
    """
    z2 = np.minimum((forces.value / np.maximum(forces.sigma, 1e-300)) ** 2, _CAP)  # (W, bins, nv)
    seen = (forces.sigma > 0) & np.isfinite(z2)
    speed, load = np.abs(fit.average(around.velocity)), np.abs(fit.average(around.load))
    contact = fit.average(around.contact.astype(float)) > 0.5
    time = np.broadcast_to(fit.average(around.time)[..., None], z2.shape)
    middle = 0.5 * (time.min() + time.max())
    masks = {
        "all": np.ones_like(seen),
        "slow": speed <= np.median(speed, (0, 1)),
        "fast": speed > np.median(speed, (0, 1)),
        "low load": load <= np.median(load, (0, 1)),
        "high load": load > np.median(load, (0, 1)),
        "contact": contact,
        "air": ~contact,
        "early": time <= middle,
        "late": time > middle,
    }
    masks = {regime: masks[regime] & seen for regime in REGIMES}
    value, noise = beyond_noise(forces)
    return mean_map(model, masks, value, None, z2, noise)
