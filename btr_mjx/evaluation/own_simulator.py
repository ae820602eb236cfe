"""Records of a robot's own simulator, in the form of an engine's."""

import numpy as np

from btr_mjx.engines import Record
from btr_mjx.models import Models, start_of
from btr_mjx.robots import Pairs, Robot


def run_simulator(
    robot: Robot,
    address: tuple[int, int] | None,
    samples: np.ndarray,
    timestep: float | None,
    models: Models,
    simulations: np.ndarray,
    index: np.ndarray,
    controllers: np.ndarray,
) -> Record:
    """The record, batch first, of pairs that the robot's own simulator simulates.

    Arguments are as of `native.rollout_native`. The work of the motors and their activations are not known: NaN. The
    speed of the base is that at the samples.
    """
    assert robot.simulator is not None
    dt, start = timestep or float(models.base.opt.timestep), start_of(robot)
    rows = [models.row(i) for i in range(len(models))]
    qpos, qvel = robot.simulator(robot, Pairs(rows, simulations, index, controllers, samples * dt, dt))
    shape = qpos.shape[:2]
    if address is None:
        origin, peak = np.zeros((len(index), 3)), np.zeros(len(index))
        position = np.where(np.isfinite(qpos).all(-1)[..., None], np.zeros((*shape, 3)), np.nan)
    else:
        at, speed = (slice(first, first + 3) for first in address)
        origin = np.stack([(rows[i].qpos0 if start is None else start[0])[at] for i in index])
        position, peak = qpos[..., at], np.linalg.norm(qvel[..., speed], axis=-1).max(axis=1)
    unknown = np.full((*shape, 1 + models.base.na), np.nan)
    capped, tripped = np.zeros(len(index), int), np.zeros(len(index), bool)
    return Record(origin, position, unknown[..., 0], peak, capped, tripped, qpos, qvel, unknown[..., 1:])
