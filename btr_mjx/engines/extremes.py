"""The models between which those of all worlds lie."""

import copy
from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from btr_mjx.engines.computed import VARYING, base_field
from btr_mjx.models import write_field


def extremes(model: mujoco.MjModel, leaves: Mapping[str, np.ndarray]) -> Iterator[mujoco.MjModel]:
    """Two models of worlds that differ in fields (..., *field shape); none where no field that is computed differs.

    In the first every number has its largest size of all worlds, in the second it is zero wherever a world has a zero:
    a feature that some world has, or lacks, is in one of them. Fields whose values are not known yet, because a program
    is being traced, are passed over.
    """
    own = {name: values for name, values in leaves.items() if name in VARYING and isinstance(values, np.ndarray)}
    if not own:
        return
    most, least = copy.copy(model), copy.copy(model)
    for name, values in own.items():
        base = base_field(model, name)
        flat = np.reshape(values, (-1, *base.shape))
        low, high = flat.min(axis=0), flat.max(axis=0)
        write_field(most, name, np.where(high >= -low, high, low))
        write_field(least, name, np.where((flat == 0).any(axis=0), 0.0, base))
    yield from (most, least)
