"""Forward dynamics of many worlds at given states, without a step in time: accelerations, and forces of actuators."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from btr_mjx.gap.simulate.batch import Counter, PreparedBatch, batch_blocks, prepared_batch
from btr_mjx.gap.simulate.commands import Command
from btr_mjx.gap.simulate.segments import Controls, Job, Piece

_INSTANT = 1e-6
"""Time over which commands are averaged where they are taken at the very start of a segment [s]."""


def accelerations(jobs: Sequence[Job], length: float, counter: Counter | None = None) -> list[np.ndarray]:
    """Accelerations of worlds.

    Activations of actuators are those in the middle of the time over which commands are averaged.

    Args:
      jobs: (world, segments) pairs, with the states at which accelerations are taken and activations at the start of
        that time; sample times have no part in it.
      length: time from the starts of segments on over which commands are averaged, or in whose middle they are taken
        where they are not held [s].
      counter: adds up the evaluations as steps.

    Returns:
      For each job (W, nv) accelerations [rad/s^2 or m/s^2]; not finite where MuJoCo fails.
    """
    out = [np.empty((len(segments), world.model.nv)) for world, segments in jobs]
    for block, own, found in forward_batches(jobs, length, ("qacc", "act", "act_dot"), 0.5, counter=counter):
        if own.base.na:
            found["act"][:] += 0.5 * length * found["act_dot"]
            own.batch.forward()
        for (i, a, b), rows in zip(block, own.rows, strict=True):
            out[i][a:b] = found["qacc"][rows]
    return out


def actuator_forces(jobs: Sequence[Job], counter: Counter | None = None) -> list[np.ndarray]:
    """Forces of actuators at the starts of segments, with the command of that time.

    Args:
      jobs: (world, segments) pairs; sample times have no part in it.
      counter: adds up the evaluations as steps.

    Returns:
      For each job (W, actuators) forces before the gear [N m or N], as the world's drives report them.
    """
    out = [np.empty((len(segments), len(world.report))) for world, segments in jobs]
    for block, own, found in forward_batches(jobs, _INSTANT, ("actuator_force",), counter=counter):
        for (i, a, b), rows in zip(block, own.rows, strict=True):
            out[i][a:b] = jobs[i][0].report * found["actuator_force"][rows]
    return out


def forward_batches(
    jobs: Sequence[Job],
    length: float,
    fields: Sequence[str],
    phase: float | None = None,
    disabled: int = 0,
    counter: Counter | None = None,
) -> Iterator[tuple[list[Piece], PreparedBatch, Mapping[str, np.ndarray]]]:
    """Evaluate forward dynamics once, with laws and constant wrenches.

    Args:
      jobs: (world, segments) pairs.
      length: time from the starts of segments on over which commands are averaged [s].
      fields: of MuJoCo's data that are read.
      phase: where in this time commands that are not held are taken, see `Controls`.
      disabled: bits of what MuJoCo leaves out.
      counter: adds up the evaluations as steps.

    Yields:
      The pieces of jobs of a batch, the batch, and the fields of all its rows.
    """
    edited: dict[tuple, Command] = {}
    for block in batch_blocks(jobs, None):
        own = prepared_batch(block, jobs, None, 1, disabled)
        found = {name: own.batch.bind(name) for name in fields}
        Controls(own.pieces, own.rows, length, own.base.nu, phase, edited).write(0, own.batch.bind("ctrl"))
        own.forces.start()
        own.forces.apply()
        own.batch.forward()
        if counter is not None:
            counter.add(own.rows[-1].stop)
        yield block, own, found
