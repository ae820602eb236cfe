"""Whether the models of all worlds have the structure of the base model, for which the program is made."""

from collections.abc import Hashable, Mapping

import mujoco
import numpy as np

from btr_mjx.engines.extremes import extremes
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.tree_builder import is_free_body, massive_members, moving_tendons

_PID, _FAST = mujoco.mjtGain.mjGAIN_PID, mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def require_same_structure(model: mujoco.MjModel, leaves: Mapping[str, np.ndarray]) -> None:
    """Check the fields in which worlds differ, (..., *field shape); fields that are not computed are passed over.

    A number that is zero in one world and not in another may bring a feature that is refused, or that the plan of the
    base model leaves out.

    Raises:
      UnsupportedModel: the message names the feature, or the fields.
    """
    for extreme in extremes(model, leaves):
        for feature in support.refusals(extreme, size=False):
            raise support.refuse(f"{feature} in some of the worlds")
        more = set(moving_tendons(extreme)) - set(moving_tendons(model))
        if more or _structure(extreme) != _structure(model):
            raise support.refuse(f"masses, tendons or windups that take part in some worlds only ({', '.join(leaves)})")


def _structure(model: mujoco.MjModel) -> Hashable:
    """What a plan and a traced program take from the values of fields that may vary, tendons aside."""
    bodies = range(1, model.nbody)
    return (
        tuple(tuple(massive_members(model, b)) for b in bodies),
        tuple(is_free_body(model, b) for b in bodies if model.opt.integrator == _FAST),
        tuple(((model.actuator_gaintype == _PID) & (model.actuator_dynprm[:, 0] > 0)).tolist()),
    )
