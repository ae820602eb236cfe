"""Delayed controls: MuJoCo's history buffers of actuators (mj_readCtrl), for a fixed time step.

The buffer holds the controls of the last n steps. A sample's age is a whole number of steps: 1 for the last step, n for
the oldest. Before the first step all are zero. A delay of x steps reads the buffer at age x, clipped to [1, n].
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from btr_mjx.engines.scalars import Scalar, mul, total

HOLD, LINEAR, CUBIC = 0, 1, 2
"""MuJoCo's interpolation orders: zero-order hold, linear, Catmull-Rom spline."""

_SLACK = 1e-9
"""Tolerance against the rounding of times, so that a delay of whole steps selects the exact sample [steps]."""


def delayed(samples: Sequence[Scalar], age: Scalar, order: int) -> Scalar:
    """The control at an age [steps], interpolated between samples of ages 1, 2, ..., n with HOLD, LINEAR or CUBIC."""
    weights = _weights(age, len(samples), order)
    return total(mul(weight, sample) for weight, sample in zip(weights, samples, strict=True))


def _weights(age: Scalar, count: int, order: int) -> list[Scalar]:
    """Interpolation weight of every sample; constants of the program if the age is one."""
    known = isinstance(age, float | np.ndarray)
    xp = np if known else jnp
    x = xp.clip(age, 1.0, float(count))
    weights = [0.0 * x for _ in range(count)]
    if order == HOLD or count == 1:
        old = xp.clip(xp.ceil(x - _SLACK), 1.0, float(count))
        weights = [xp.where(old == j, 1.0, 0.0 * x) for j in range(1, count + 1)]
    elif order == LINEAR:
        weights = [xp.maximum(0.0, 1.0 - xp.abs(x - j)) for j in range(1, count + 1)]
    else:
        for younger in range(1, count):  # interval between this sample and the next older one
            inside = (x >= younger) & (x < younger + 1) if younger < count - 1 else x >= younger
            for age_of, weight in _catmull_rom(younger + 1 - x, younger, count).items():
                weights[age_of - 1] = weights[age_of - 1] + xp.where(inside, weight, 0.0)
    return [float(w) if known and np.ndim(w) == 0 else w for w in weights]


def _catmull_rom(alpha: Scalar, younger: int, count: int) -> dict[int, Scalar]:
    """Age -> weight at fraction `alpha` from age younger + 1 to age younger; slope zero at both ends of the buffer."""
    square, cube = alpha * alpha, alpha * alpha * alpha
    older = younger + 1
    weights = {older: 2 * cube - 3 * square + 1, younger: -2 * cube + 3 * square}
    for slope, first, last in ((cube - 2 * square + alpha, younger, older + 1), (cube - square, younger - 1, older)):
        if first >= 1 and last <= count:
            weights[first] = weights.get(first, 0.0) + 0.5 * slope
            weights[last] = weights.get(last, 0.0) - 0.5 * slope
    return weights
