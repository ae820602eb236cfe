"""Forces of actuators at measured states, as a drive reports them."""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.simulate.batch import Counter, batch_blocks, prepared_batch
from btr_mjx.gap.simulate.segments import Controls, Job

_INSTANT = 1e-6
"""Time step by which commands are taken at the very start of a segment [s]."""


def actuator_forces(jobs: Sequence[Job], counter: Counter | None = None) -> list[np.ndarray]:
    """Forces of actuators at the starts of segments, with the command of that time.

    Args:
      jobs: (world, segments) pairs; sample times have no part in it.
      counter: adds up the evaluations as steps.

    Returns:
      For each job (W, actuators) forces before the gear [N m or N], as the world's drives report them.
    """
    out = [np.empty((len(segments), len(world.report))) for world, segments in jobs]
    for block in batch_blocks(jobs, _INSTANT):
        own = prepared_batch(block, jobs, _INSTANT, 1)
        Controls(own.pieces, own.rows, _INSTANT, own.base.nu).write(0, own.batch.bind("ctrl"))
        force = own.batch.bind("actuator_force")
        own.forces.start()
        own.forces.apply()
        own.batch.forward()
        if counter is not None:
            counter.add(own.rows[-1].stop)
        for (i, a, b), rows in zip(block, own.rows, strict=True):
            out[i][a:b] = jobs[i][0].report * force[rows]
    return out
