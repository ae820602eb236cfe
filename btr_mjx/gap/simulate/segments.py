"""Segments of recordings that are simulated together, their controls, and sampling of their states."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.simulate.commands import Command, command_phase
from btr_mjx.gap.simulate.world import World
from btr_mjx.models import between

BLOCK = 64
"""Number of steps for which controls are evaluated at once."""

_MAX_STATE = 1e10
"""A state beyond this is invalid, as mjMAXVAL in MuJoCo."""


@dataclass(frozen=True)
class Segments:
    """Segments (windows) of recordings that are simulated together.

    Attributes:
      start: (W,) start time of each segment [s].
      qpos: (W, nq) configuration at the start, as the encoders report it.
      qvel: (W, nv) velocity at the start.
      samples: (K,) or (W, K) ascending sample times since the start [s].
      commands: commands of the recordings.
      recording: (W,) index in `commands` of each segment.
      act: (W, na) activation of actuators with a state at the start; None for zeros.
    """

    start: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    samples: np.ndarray
    commands: tuple[Command, ...]
    recording: np.ndarray
    act: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.start)

    @property
    def times(self) -> np.ndarray:
        """(W, K) sample times since the start [s]."""
        return np.broadcast_to(self.samples, (len(self), np.shape(self.samples)[-1]))

    def take(self, rows: np.ndarray | slice) -> "Segments":
        """A subset of the segments."""
        return Segments(
            self.start[rows],
            self.qpos[rows],
            self.qvel[rows],
            self.times[rows],
            self.commands,
            np.asarray(self.recording)[rows],
            None if self.act is None else self.act[rows],
        )


Job = tuple[World, Segments]
"""A world and the segments over which it is simulated."""

Piece = tuple[int, int, int]
"""Index of a job, and first and last + 1 of a range of its segments."""


class Sampler:
    """Records the states at the sample times while a batch is simulated."""

    def __init__(self, model: mujoco.MjModel, pieces: Sequence[Job], dt: float) -> None:
        self._model, self._dt = model, dt
        times = [segments.times for _, segments in pieces]
        self._row = np.concatenate(
            [
                np.repeat(first + np.arange(len(t)), t.shape[1])
                for t, first in zip(times, np.cumsum([0, *map(len, times[:-1])]), strict=True)
            ]
        )
        at = np.concatenate([t.reshape(-1) for t in times]) / dt
        whole = np.floor(at + 1e-6)
        part = np.where(at - whole < 1e-6, 0.0, at - whole)
        self._part = part
        # A sample inside a step needs the state after the step.
        stage = (whole + (part > 0)).astype(int)
        self.steps = np.zeros(sum(map(len, times)), int)
        np.maximum.at(self.steps, self._row, stage)
        self._stage, self._order = stage, np.argsort(stage, kind="stable")
        self._bounds = np.searchsorted(stage[self._order], np.arange(int(stage.max(initial=0)) + 2))
        self._states = np.full((len(at), model.nq + model.nv), np.nan)
        self._earlier = np.full_like(self._states, np.nan)

    def _due(self, stage: int) -> np.ndarray:
        return self._order[self._bounds[stage] : self._bounds[stage + 1]]

    def before(self, stage: int, qpos: np.ndarray, qvel: np.ndarray, alive: np.ndarray) -> None:
        """Record the states before step `stage`, for samples inside this step and rows that take it."""
        self._keep(self._earlier, self._due(stage), qpos, qvel, alive)

    def record(self, stage: int, qpos: np.ndarray, qvel: np.ndarray, alive: np.ndarray) -> None:
        """Record the states after step `stage`, for samples inside or at the end of this step and rows that took it."""
        self._keep(self._states, self._due(stage), qpos, qvel, alive)

    def take(self, done: int, own: np.ndarray, before: np.ndarray, states: np.ndarray) -> None:
        """Record samples from the states of a block of steps.

        Args:
          done: number of steps before the block.
          own: (N,) rows that were simulated.
          before: (N, nq + nv) states before the block.
          states: (N, T, nq + nv) states after each step.
        """
        due = self._order[self._bounds[done + 1] : self._bounds[done + 1 + states.shape[1]]]
        due = due[np.isin(self._row[due], own)]
        if not len(due):
            return
        row, at = np.searchsorted(own, self._row[due]), self._stage[due] - done - 1
        self._states[due] = states[row, at]
        inside = self._part[due] > 0
        due, row, at = due[inside], row[inside], at[inside]
        self._earlier[due] = np.where((at > 0)[:, None], states[row, at - 1], before[row])

    def _keep(self, states: np.ndarray, due: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, alive: np.ndarray) -> None:
        due = due[alive[self._row[due]]]
        if len(due):
            own, nq = self._row[due], self._model.nq
            states[due, :nq] = qpos[own]
            states[due, nq:] = qvel[own]

    def write(self, block: list[Piece], out: list[np.ndarray]) -> None:
        """Write the states to the arrays of their jobs; rows are NaN from the first invalid sample."""
        self._interpolate()
        first = 0
        for index, a, b in block:
            shape = out[index][a:b].shape
            states = self._states[first : first + shape[0] * shape[1]].reshape(shape)
            bad = ~(np.abs(states) < _MAX_STATE).all(-1)
            states[np.logical_or.accumulate(bad, axis=1)] = np.nan
            out[index][a:b] = states
            first += shape[0] * shape[1]

    def _interpolate(self) -> None:
        """Interpolate all samples that lie inside a step."""
        inside = np.flatnonzero(self._part > 0)
        if not len(inside):
            return
        nq = self._model.nq
        earlier, later = self._earlier[inside], self._states[inside]
        states = (earlier[:, :nq], earlier[:, nq:]), (later[:, :nq], later[:, nq:])
        found = between(self._model, *states, self._part[inside], self._dt)
        self._states[inside] = np.concatenate(found, axis=1)


class Controls:
    """Controls of all rows, evaluated once per distinct (segments, command edits), for a block of steps at a time."""

    def __init__(
        self,
        pieces: Sequence[Job],
        rows: Sequence[slice],
        dt: float,
        nu: int,
        phase: float | None = None,
        edited: dict[tuple, Command] | None = None,
    ) -> None:
        """Prepare; values that are not held are taken at a phase of the step, see `command_phase` for None.

        Given `edited`, edited commands are kept there, for other batches of the same worlds.
        """
        self._pieces, self._rows, self._dt, self._nu, self._phase = pieces, rows, dt, nu, phase
        self._keys = [
            (
                id(segments.commands),
                segments.start.tobytes(),
                np.asarray(segments.recording).tobytes(),
                *map(id, world.command_edits),
            )
            for world, segments in pieces
        ]
        self._edited: dict[tuple, Command] = {} if edited is None else edited
        self._filled: dict[tuple, np.ndarray] = {}
        self._from = -BLOCK
        self._steps: np.ndarray | None = None

    def write(self, step: int, ctrl: np.ndarray) -> None:
        """Write the controls of one step to ctrl (rows, nu), see `Command.over_step`."""
        if not self._nu:
            return
        if not 0 <= step - self._from < BLOCK:
            self._fill(step)
        if self._steps is None:
            self._steps = np.concatenate([self._filled[key] for key in self._keys], 1)
        ctrl[:] = self._steps[step - self._from]

    def block(self, first: int, count: int) -> np.ndarray | None:
        """Controls (rows, count, nu) of `count` <= `BLOCK` steps; None for a model without controls."""
        if not self._nu:
            return None
        self._fill(first)
        out = np.empty((self._rows[-1].stop, count, self._nu))
        for key, own in zip(self._keys, self._rows, strict=True):
            out[own] = np.swapaxes(self._filled[key][:count], 0, 1)
        return out

    def _fill(self, first: int) -> None:
        self._filled, self._from, self._steps = {}, first, None
        longest = max(float(segments.times.max(initial=0)) for _, segments in self._pieces)
        count = min(BLOCK, int(longest / self._dt) + 2 - first)
        since = (first + np.arange(count)) * self._dt
        for key, (world, segments) in zip(self._keys, self._pieces, strict=True):
            if key in self._filled:
                continue
            values = np.empty((count, len(segments), self._nu))
            phase = command_phase(world.model) if self._phase is None else self._phase
            for recording in np.unique(segments.recording):
                own = np.flatnonzero(np.asarray(segments.recording) == recording)
                name = (id(segments.commands), int(recording), *key[3:])
                if name not in self._edited:
                    self._edited[name] = world.command(segments.commands[recording])
                values[:, own] = self._edited[name].over_step(since[:, None] + segments.start[own], self._dt, phase)
            self._filled[key] = values
