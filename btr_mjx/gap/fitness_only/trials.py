"""Simulation of the trials of a fitness table: the fitness of each controller in a world."""

from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.evaluation import Outcome, fitness_function
from btr_mjx.gap.effects import Scales
from btr_mjx.gap.fitness_only.fitness_table import FitnessTable
from btr_mjx.gap.simulate import Command, Counter, Segments, World, simulate

_AT_ONCE = 1024
"""Trials of one batch; progress is reported and saved between batches."""


class TrialSimulator:
    """Simulates the trials of a table in worlds.

    Attributes:
      table: the table of trials.
      counter: counts the simulated steps.
    """

    def __init__(self, table: FitnessTable, counter: Counter | None = None) -> None:
        self.table, self.counter = table, counter or Counter()
        times = np.arange(0.0, table.duration + 0.002, min(0.05 / table.omega, 0.01))
        self._commands = tuple(Command(times, values, "cubic") for values in table.commands(times))
        self._function = fitness_function(table.function)

    def fitness(self, worlds: Sequence[World], rows: np.ndarray, timestep: float | None = None) -> np.ndarray:
        """Fitness (C, M) [m/s] of trials, given by index (M,), in worlds (C,); NaN where a simulation diverged.

        The time step [s] is the model's own by default.
        """
        model, count, times = self.table.head.model, len(rows), np.array([self.table.duration])
        segments = Segments(
            np.zeros(count),
            np.tile(model.qpos0, (count, 1)),
            np.zeros((count, model.nv)),
            times,
            tuple(self._commands[i] for i in rows),
            np.arange(count),
        )
        start = self._positions(model.qpos0[None])[0]
        out, together = [], max(1, _AT_ONCE // count)
        for first in range(0, len(worlds), together):
            jobs = [(world, segments) for world in worlds[first : first + together]]
            for found in simulate(jobs, timestep=timestep, counter=self.counter):
                position = self._positions(found[:, 0, : model.nq])
                out.append(self._function(Outcome(times, start, position[:, None], np.zeros((count, 1)))))
        return np.array(out)

    def _positions(self, qpos: np.ndarray) -> np.ndarray:
        """Positions (N, 3) of the body in configurations (N, nq)."""
        model, out = self.table.head.model, np.full((len(qpos), 3), np.nan)
        data, body = mujoco.MjData(model), model.body(self.table.body).id
        for k in np.flatnonzero(np.isfinite(qpos).all(axis=1)):
            data.qpos[:] = qpos[k]
            mujoco.mj_kinematics(model, data)
            out[k] = data.xpos[body]
        return out

    def scales(self, rows: np.ndarray) -> Scales:
        """Scales of torques, speeds and travel in some trials (M,) of the believed model."""
        model, states = self.table.head.model, []
        steps = round(self.table.duration / model.opt.timestep)
        for row in rows:
            data = mujoco.MjData(model)
            controls = self._commands[row].at((np.arange(steps) + 0.5) * model.opt.timestep)
            for k in range(steps):
                data.ctrl[:] = controls[k]
                if k % max(1, steps // 100) == 0:
                    states.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.act.copy()))
                mujoco.mj_step(model, data)
        qpos, qvel, ctrl, act = (np.array(column) for column in zip(*states, strict=True))
        return Scales.measured(model, qpos, qvel, ctrl, act if model.na else None)
