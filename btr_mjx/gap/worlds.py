"""Ways the robot could be, and their simulation by the thousand in native MuJoCo.

A `World` is a model with its command edits, laws and encoder offsets: what an effect edits. A `Stretch` is a set of
windows of the data. `simulate` runs every job, a world over a stretch, in as few batches as possible; the control is
sampled in the middle of each step, because a control held from the step's start looks like a delay of half a step.
"""

import copy
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError

from btr_mjx.errors import InputError
from btr_mjx.gap.commands import Command
from btr_mjx.gap.laws import Law, Rows
from btr_mjx.gap.tangent import between, integrate
from btr_mjx.model_fields import read_field

CommandEdit = Callable[[Command], Command]

_ROWS = 8192
"""Rows of one batch: bounds the memory that many jobs take."""

_BLOCK = 64
"""Steps for which controls are laid out at once."""

_HUGE = 1e10
"""A state beyond this is a numerical accident, as in MuJoCo's own check."""


@dataclass
class World:
    """One way the robot could be. Effects edit it in place, one after another.

    Attributes:
      model: a private copy. Constants that MuJoCo derives from it follow by themselves when it is simulated.
      command_edits: applied to the command of every recording, in order.
      laws: the state-dependent part, called in order before every step.
      offset: (nv,) what the encoders add to the true configuration, in the tangent space.
      wrench: (nbody, 6) constant force [N] and torque [N m] on bodies, at their centre of mass in the world frame.
    """

    model: mujoco.MjModel
    command_edits: list[CommandEdit]
    laws: list[Law]
    offset: np.ndarray
    wrench: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "World":
        """The world that a model describes; native delays of actuators become an edit of the command."""
        model = copy.copy(model)
        edits: list[CommandEdit] = []
        if model.actuator_delay.any():
            delay = np.zeros(model.nu)
            for actuator, first in enumerate(model.actuator_ctrladr):
                delay[first : first + model.actuator_ctrlnum[actuator]] = model.actuator_delay[actuator]
            model.actuator_delay[:] = 0
            edits.append(lambda command: command.shifted(delay))
        return cls(model, edits, [], np.zeros(model.nv), np.zeros((model.nbody, 6)))

    def command(self, command: Command) -> Command:
        """What arrives at the actuators when `command` is sent."""
        for edit in self.command_edits:
            command = edit(command)
        return command


@dataclass(frozen=True)
class Stretch:
    """Windows of recordings that are simulated together.

    Attributes:
      start: (W,) time at which each window starts [s].
      qpos: (W, nq) measured configuration at the start.
      qvel: (W, nv) velocity at the start.
      samples: (K,) or (W, K) ascending times since the start at which states are wanted [s].
      commands: the commands of the recordings.
      recording: (W,) which of `commands` each window belongs to.
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
        """(W, K) times since the start [s]."""
        return np.broadcast_to(self.samples, (len(self), np.shape(self.samples)[-1]))

    def take(self, rows: np.ndarray | slice) -> "Stretch":
        """Some of the windows."""
        return Stretch(
            self.start[rows],
            self.qpos[rows],
            self.qvel[rows],
            self.times[rows],
            self.commands,
            np.asarray(self.recording)[rows],
            None if self.act is None else self.act[rows],
        )


Job = tuple[World, Stretch]


@dataclass
class Counter:
    """Simulated steps, summed over all rows."""

    steps: int = 0


def fields_of(world: World, base: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The fields of a world's model that differ from a base model, derived constants included.

    Args:
      world: whose model is compared; its derived constants are recomputed.
      base: a model of the same structure.
    """
    changed = _differing(world.model, base)
    if changed:
        mujoco.mj_setConst(world.model, mujoco.MjData(world.model))
        changed = _differing(world.model, base)
    return changed


def simulate(
    jobs: Sequence[Job],
    *,
    timestep: float | None = None,
    threads: int | None = None,
    counter: Counter | None = None,
) -> list[np.ndarray]:
    """Simulate worlds over stretches.

    Args:
      jobs: (world, stretch) pairs. Models of equal sizes share batches.
      timestep: another time step than the models' own [s].
      threads: number of threads; None for all cores. Results do not depend on it.
      counter: adds up the simulated steps.

    Returns:
      For each job states (W, K, nq + nv) at the sample times as the encoders would report them: qpos with the world's
      offset, qvel without. Between two steps they are interpolated in the tangent space. Rows are NaN from where a
      simulation became invalid.
    """
    out = [np.empty((*stretch.times.shape, world.model.nq + world.model.nv)) for world, stretch in jobs]
    for members in _alike(jobs, timestep):
        for block in _blocks(members, jobs):
            _run(block, jobs, out, timestep, threads, counter)
    for (world, _), states in zip(jobs, out, strict=True):
        if world.offset.any():
            nq = world.model.nq
            states[..., :nq] = integrate(world.model, states[..., :nq], world.offset)
    return out


_Piece = tuple[int, int, int]
"""A job's index and the range of its windows."""


def _alike(jobs: Sequence[Job], timestep: float | None) -> list[list[int]]:
    """Indices of jobs whose models may share a batch."""
    groups: dict[tuple, list[int]] = {}
    for index, (world, stretch) in enumerate(jobs):
        model = world.model
        if stretch.qpos.shape != (len(stretch), model.nq) or stretch.qvel.shape != (len(stretch), model.nv):
            raise InputError(
                f"stretch: got qpos {stretch.qpos.shape} and qvel {stretch.qvel.shape}, expected "
                f"({len(stretch)}, {model.nq}) and ({len(stretch)}, {model.nv}) for this model"
            )
        sizes = tuple(getattr(model, name) for name in _SIZES)
        key = (*sizes, timestep or model.opt.timestep, model.opt.integrator)
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _blocks(members: Sequence[int], jobs: Sequence[Job]) -> Iterator[list[_Piece]]:
    """Pieces of jobs that fill a batch of at most `_ROWS` rows."""
    block: list[_Piece] = []
    room = _ROWS
    for index in members:
        first, count = 0, len(jobs[index][1])
        while first < count:
            last = min(count, first + room)
            block.append((index, first, last))
            room -= last - first
            first = last
            if room == 0:
                yield block
                block, room = [], _ROWS
    if block:
        yield block


def _run(
    block: list[_Piece],
    jobs: Sequence[Job],
    out: list[np.ndarray],
    timestep: float | None,
    threads: int | None,
    counter: Counter | None,
) -> None:
    """Simulate one batch and write the states of its pieces."""
    base = copy.copy(jobs[block[0][0]][0].model)
    # The first world may have been edited, and its constants with it.
    mujoco.mj_setConst(base, mujoco.MjData(base))
    if timestep is not None:
        base.opt.timestep = timestep
    # An invalid state must stay visible; MuJoCo's automatic reset would turn it into a new start.
    base.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    dt = float(base.opt.timestep)
    pieces = [(jobs[i][0], jobs[i][1].take(slice(a, b))) for i, a, b in block]
    ends = np.cumsum([len(stretch) for _, stretch in pieces])
    rows = [slice(end - len(stretch), end) for end, (_, stretch) in zip(ends, pieces, strict=True)]
    count = int(ends[-1])
    # Threads that wait for each other at every step cost more than they bring to a few rows.
    most = threads or os.cpu_count() or 1
    batch = Batch(base, nsim=count, nthread=max(1, min(most, count // 48)))
    _write_models(batch, base, pieces, rows)
    qpos, qvel, time = batch.bind("qpos"), batch.bind("qvel"), batch.bind("time")
    for (world, stretch), own in zip(pieces, rows, strict=True):
        time[own] = stretch.start
        qpos[own] = integrate(world.model, stretch.qpos, -world.offset) if world.offset.any() else stretch.qpos
        qvel[own] = stretch.qvel
        if stretch.act is not None:
            batch.bind("act")[own] = stretch.act
    sampler = _Sampler(base, pieces, dt)
    controls = _Controls(pieces, rows, dt, base.nu)
    forces = _Forces(batch, pieces, rows)
    dead = np.zeros(count, bool)
    sampler.record(0, qpos, qvel, dead)
    steps, ctrl = sampler.steps, batch.bind("ctrl")
    ids: np.ndarray | None = None
    running = -1
    for k in range(int(steps.max(initial=0))):
        alive = (steps > k) & ~dead
        if int(alive.sum()) != running:
            running = int(alive.sum())
            ids = None if running == count else np.flatnonzero(alive).astype(np.int32)
        if not running:
            break
        controls.write(k, ctrl)
        if k == 0:
            forces.start()
        forces.apply()
        before = sampler.before(k + 1, qpos, qvel)
        try:
            batch.step(ids)
        except SimulationError as error:
            dead[error.ids] = True
        if counter is not None:
            counter.steps += running
        sampler.record(k + 1, qpos, qvel, dead, before)
    sampler.write(block, out)


def _write_models(batch: Batch, base: mujoco.MjModel, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
    """Give every row its world's model: only the fields in which a world differs are expanded."""
    known: dict[int, dict[str, np.ndarray]] = {}
    for (world, _), own in zip(pieces, rows, strict=True):
        if id(world) not in known:
            known[id(world)] = fields_of(world, base)
        for name, values in known[id(world)].items():
            batch.expand(name)[own] = values


class _Sampler:
    """Picks the states at the sample times while a batch runs."""

    def __init__(self, model: mujoco.MjModel, pieces: Sequence[Job], dt: float) -> None:
        self._model, self._dt = model, dt
        times = [stretch.times for _, stretch in pieces]
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
        # A state between two steps is known once the later one is.
        stage = (whole + (part > 0)).astype(int)
        self.steps = np.zeros(sum(map(len, times)), int)
        np.maximum.at(self.steps, self._row, stage)
        self._order = np.argsort(stage, kind="stable")
        self._bounds = np.searchsorted(stage[self._order], np.arange(int(stage.max(initial=0)) + 2))
        self._states = np.full((len(at), model.nq + model.nv), np.nan)

    def _due(self, stage: int) -> np.ndarray:
        return self._order[self._bounds[stage] : self._bounds[stage + 1]]

    def before(self, stage: int, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """States before the step to `stage` of the samples that lie inside it."""
        due = self._due(stage)
        due = due[self._part[due] > 0]
        return (qpos[self._row[due]], qvel[self._row[due]]) if len(due) else None

    def record(
        self,
        stage: int,
        qpos: np.ndarray,
        qvel: np.ndarray,
        dead: np.ndarray,
        before: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        """Keep the states of the samples at `stage`."""
        due = self._due(stage)
        if not len(due):
            return
        own = self._row[due]
        q, v = qpos[own], qvel[own]
        inside = self._part[due] > 0
        if before is not None:
            fraction = self._part[due[inside]]
            q[inside], v[inside] = between(self._model, before, (q[inside], v[inside]), fraction, self._dt)
        states = np.concatenate([q, v], axis=1)
        states[dead[own]] = np.nan
        self._states[due] = states

    def write(self, block: list[_Piece], out: list[np.ndarray]) -> None:
        """Hand the states to their jobs; invalid rows are NaN from the first invalid sample on."""
        first = 0
        for index, a, b in block:
            shape = out[index][a:b].shape
            states = self._states[first : first + shape[0] * shape[1]].reshape(shape)
            bad = ~(np.abs(states) < _HUGE).all(-1)
            states[np.logical_or.accumulate(bad, axis=1)] = np.nan
            out[index][a:b] = states
            first += shape[0] * shape[1]


class _Controls:
    """Controls of all rows, evaluated once for each (stretch, edits) and laid out for a block of steps at a time."""

    def __init__(self, pieces: Sequence[Job], rows: Sequence[slice], dt: float, nu: int) -> None:
        self._pieces, self._rows, self._dt, self._nu = pieces, rows, dt, nu
        self._keys = [
            (
                id(stretch.commands),
                stretch.start.tobytes(),
                np.asarray(stretch.recording).tobytes(),
                *map(id, world.command_edits),
            )
            for world, stretch in pieces
        ]
        self._edited: dict[tuple, Command] = {}
        self._laid: dict[tuple, np.ndarray] = {}

    def write(self, step: int, ctrl: np.ndarray) -> None:
        """Controls of one step, sampled in its middle."""
        if not self._nu:
            return
        if step % _BLOCK == 0:
            self._lay(step)
        for key, own in zip(self._keys, self._rows, strict=True):
            ctrl[own] = self._laid[key][step % _BLOCK]

    def _lay(self, first: int) -> None:
        self._laid = {}
        longest = max(float(stretch.times.max(initial=0)) for _, stretch in self._pieces)
        count = min(_BLOCK, int(longest / self._dt) + 2 - first)
        since = (first + np.arange(count) + 0.5) * self._dt
        for key, (world, stretch) in zip(self._keys, self._pieces, strict=True):
            if key in self._laid:
                continue
            values = np.empty((count, len(stretch), self._nu))
            for recording in np.unique(stretch.recording):
                own = np.flatnonzero(np.asarray(stretch.recording) == recording)
                name = (id(stretch.commands), int(recording), *key[3:])
                if name not in self._edited:
                    self._edited[name] = world.command(stretch.commands[recording])
                values[:, own] = self._edited[name].at(since[:, None] + stretch.start[own])
            self._laid[key] = values


class _Forces:
    """Constant wrenches and laws of the worlds in a batch."""

    def __init__(self, batch: Batch, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
        self._batch = batch
        self._laws: list[tuple[World, Rows]] = []
        wrenches = batch.bind("xfrc_applied")
        for (world, _), own in zip(pieces, rows, strict=True):
            wrenches[own] = world.wrench
        with_laws = [(world, own) for (world, _), own in zip(pieces, rows, strict=True) if world.laws]
        if not with_laws:
            return
        state = {
            name: batch.bind(name) for name in ("time", "qpos", "qvel", "act", "ctrl", "qfrc_applied", "xfrc_applied")
        }
        force, torque = batch.bind("actuator_force"), batch.bind("qfrc_actuator")
        for world, own in with_laws:
            names = {name for law in world.laws for name in law.fields}
            fields = {name: batch.expand(name)[own] for name in sorted(names)}
            views = {name: values[own] for name, values in state.items()}
            forces = {"actuator_force": force[own], "qfrc_actuator": torque[own]}
            self._laws.append((world, Rows(world.model, **views, **forces, fields=fields)))
        self._rows = np.concatenate([np.arange(own.start, own.stop) for _, own in with_laws])

    def start(self) -> None:
        """Compute the actuators' forces at the start states, which laws may read before the first step."""
        if self._laws:
            self._batch.forward(self._rows)

    def apply(self) -> None:
        """Put back what laws may have changed, then call them."""
        for world, rows in self._laws:
            rows.qfrc_applied[...] = 0.0
            rows.xfrc_applied[...] = world.wrench
            for name, values in rows.fields.items():
                values[...] = read_field(world.model, name)
            for law in world.laws:
                law(rows)


_SIZES = ("nq", "nv", "nu", "na", "nbody", "njnt", "ngeom", "nsite", "ntendon", "neq", "nM", "nhistory", "nmocap")

_COMPARED = tuple(
    sorted(
        name
        for name in MODEL_FIELDS
        if name.startswith(("body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "tendon_", "ten_", "eq_", "opt."))
        or name in ("qpos0", "qpos_spring", "pair_friction", "pair_solref", "pair_solimp", "pair_margin", "pair_gap")
        if not name.endswith(("_user", "_rgba", "_group", "_matid", "adr", "num", "id"))
        if name not in ("opt.timestep", "opt.integrator", "opt.disableflags", "opt.enableflags")
    )
)
"""Fields in which two worlds of one structure may differ in a way that matters to motion."""


def _differing(model: mujoco.MjModel, base: mujoco.MjModel) -> dict[str, np.ndarray]:
    changed = {}
    for name in _COMPARED:
        if name.startswith("opt."):
            ours, theirs = getattr(model.opt, name[4:]), getattr(base.opt, name[4:])
            same = np.array_equal(ours, theirs) if isinstance(ours, np.ndarray) else ours == theirs
        else:
            ours, theirs = getattr(model, name), getattr(base, name)
            same = np.array_equal(ours, theirs)
        if not same:
            changed[name] = np.array(ours)
    return changed
