"""What numbers of effects do beside a hypothesis, as forces that move the state, without a simulation.

    dx_(k+1) / d theta = -G_k dF_k / d theta

F is the force that the motion needs beyond the hypothesis, in the middle of an interval. It is linear in masses, rotors
and friction where the simulated motion is not: a model that lacks a mass accelerates too much wherever it starts, and
what the mass would do to such a motion says little of it.
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.forces.missing_force import missing_forces
from btr_mjx.gap.forces.motion import FreeNumber, Linearised, compared_hypotheses
from btr_mjx.gap.forces.reported import reported_forces
from btr_mjx.gap.simulate import Counter


def force_columns(linear: Linearised, base: Hypothesis, numbers: Sequence[FreeNumber], counter: Counter) -> np.ndarray:
    """Derivatives of the ends of intervals with respect to numbers of effects beside a hypothesis.

    Args:
      linear: the motion, linearised around the hypothesis.
      base: the hypothesis without the effects of `numbers`.
      numbers: the numbers.
      counter: adds up the evaluations.

    Returns:
      (S, K, nx, C).
    """
    makes, pairs = compared_hypotheses(base, numbers)
    stretches = linear.stretches
    needed = [own.force for own in missing_forces(stretches, makes, counter)] if makes else []
    reported = reported_forces(stretches, makes, counter)
    out = np.empty((*linear.defect.shape, len(numbers)))
    moving = linear.defect.shape[-1] - len(stretches.actuators)
    for c, ((a, b), number) in enumerate(zip(pairs, numbers, strict=True)):
        change = np.nan_to_num(needed[b] - needed[a])
        out[..., c] = -(linear.force @ change[..., None])[..., 0]
        out[..., moving:, c] += reported[b] - reported[a]
        out[..., c] /= number.step
    return out
