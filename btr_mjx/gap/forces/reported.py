"""Forces that drives report: what a hypothesis says of them, and how they depend on the state.

Currents and torques of drives tell a weak motor, which they show, from friction at its joint, which they do not.
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import Counter, actuator_forces
from btr_mjx.gap.windows import MakeWorld
from btr_mjx.models import integrate


def reported_forces(
    stretches: Stretches,
    makes: Sequence[MakeWorld],
    counter: Counter | None = None,
    moved: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Forces (S, K, m) of hypotheses at the ends of all intervals, as drives report them.

    Args:
      stretches: where.
      makes: the hypotheses.
      counter: adds up the evaluations.
      moved: (2 nv,) change of all states; None for none.
    """
    out = [np.zeros((len(stretches), stretches.intervals, len(stretches.actuators))) for _ in makes]
    if not len(stretches.actuators):
        return out
    qpos, qvel = stretches.qpos[:, 1:], stretches.qvel[:, 1:]
    if moved is not None:
        change = np.broadcast_to(moved, (*qpos.shape[:2], len(moved)))
        model, nv = stretches.data.recordings[0].model, qvel.shape[-1]
        qpos, qvel = integrate(model, qpos, change[..., :nv]), qvel + change[..., nv:]
    for own, model, segments in stretches.segments(slice(1, None), qpos, qvel, np.zeros(qpos.shape[:2])):
        found = actuator_forces([(make(model), segments) for make in makes], counter)
        for forces, target in zip(found, out, strict=True):
            target[own] = forces[:, stretches.actuators].reshape(len(own), stretches.intervals, -1)
    return out


def force_slopes(
    stretches: Stretches, make: MakeWorld, shifts: np.ndarray, counter: Counter | None = None
) -> np.ndarray:
    """Derivatives (S, K, m, 2 nv) of these forces with respect to the state.

    Args:
      stretches: where.
      make: the hypothesis.
      shifts: (2 nv,) steps of central differences.
      counter: adds up the evaluations.
    """
    out = np.zeros((len(stretches), stretches.intervals, len(stretches.actuators), len(shifts)))
    for i, step in enumerate(shifts if len(stretches.actuators) else []):
        change = np.where(np.arange(len(shifts)) == i, step, 0.0)
        ((up,), (down,)) = (reported_forces(stretches, [make], counter, sign * change) for sign in (1.0, -1.0))
        out[..., i] = (up - down) / (2 * step)
    return out
