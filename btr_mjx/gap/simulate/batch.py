"""Batched simulation of many worlds over segments of recordings, with `mujoco.batch.Batch`.

A `World` is a model with command edits, laws and encoder offsets. `Segments` are windows of the data with their
starting states and commands. `simulate` runs all jobs (world, segments) in as few batches as possible. When in a step
its command is taken is said by `commands.command_phase`.
"""

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from btr_mjx.errors import InputError
from btr_mjx.gap.simulate.laws import Rows
from btr_mjx.gap.simulate.rollout import rollout_without_laws
from btr_mjx.gap.simulate.segments import Controls, Job, Piece, Sampler
from btr_mjx.gap.simulate.world import World, differing_fields, fingerprint
from btr_mjx.models import integrate, read_field
from btr_mjx.runs import available_cores

_ROWS_PER_THREAD = 4
"""Smallest number of rows per thread."""

_MAX_ROWS = 8192
"""Largest number of rows of a batch; bounds the memory."""

_MAX_GEOMS_BRUTE_FORCE = 8
"""Geoms of a body up to which testing all pairs is faster than MuJoCo's collision midphase."""

_MIN_ITERATIONS = 20
"""Solver iterations from which on Newton's method converges from any starting point."""


@dataclass
class Counter:
    """Thread-safe counter of simulated steps, summed over all rows.

    `journal.Journal` also stores the simulated states.

    Attributes:
      steps: number of steps so far.
      lock: protects `steps`.
      earlier: duration of the interrupted sessions of this search [s].
    """

    steps: int = 0
    earlier: float = 0.0
    lock: Lock = field(default_factory=Lock, repr=False)

    def lookup(self, jobs: Sequence[Job], timestep: float | None) -> tuple[list[np.ndarray] | None, Path | None]:
        """Stored states of these jobs, None if there are none; and the file that is theirs."""
        return None, None

    def remembered(
        self, parts: tuple[Any, ...], compute: Callable[[], Mapping[str, np.ndarray]]
    ) -> Mapping[str, np.ndarray]:
        """Arrays that are computed from `parts`, or were before, see `journal.Journal`."""
        return compute()

    def add(self, steps: int) -> None:
        """Add to the number of steps."""
        with self.lock:
            self.steps += steps

    def expect(self, steps: float) -> None:
        """Tell how many steps the phase of a search that has begun takes, about; for those who follow it."""

    def store(self, path: Path | None, states: Sequence[np.ndarray], steps: int) -> None:
        """Store the states (W, K, nq + nv) of jobs, which took these steps, in their file."""


def simulate(
    jobs: Sequence[Job],
    *,
    timestep: float | None = None,
    threads: int | None = None,
    counter: Counter | None = None,
) -> list[np.ndarray]:
    """Simulate worlds over segments.

    Args:
      jobs: (world, segments) pairs. Models of equal sizes share batches.
      timestep: time step [s]; None for that of the models.
      threads: number of threads; None for all cores. Results do not depend on it.
      counter: adds up the simulated steps, and may store results.

    Returns:
      For each job states (W, K, nq + nv) at the sample times, as encoders report them: qpos includes the offset of the
      world. Between two steps states are interpolated in the tangent space. A row is NaN from the first invalid sample.

    Raises:
      InputError: the shapes of segments do not fit the model.
    """
    known, path = (None, None) if counter is None else counter.lookup(jobs, timestep)
    if known is not None:
        return known
    out = [np.empty((*segments.times.shape, world.model.nq + world.model.nv)) for world, segments in jobs]
    steps = 0
    for block in batch_blocks(jobs, timestep):
        taken = _simulate_batch(prepared_batch(block, jobs, timestep, threads), block, out)
        steps += taken
        if counter is not None:
            counter.add(taken)
    for (world, _), states in zip(jobs, out, strict=True):
        if world.offset.any():
            nq = world.model.nq
            states[..., :nq] = integrate(world.model, states[..., :nq], world.offset)
    if counter is not None:
        counter.store(path, out, steps)
    return out


def batch_blocks(jobs: Sequence[Job], timestep: float | None) -> Iterator[list[Piece]]:
    """Pieces of jobs that are simulated as one batch each."""
    for members in _compatible(jobs, timestep):
        yield from _blocks(members, jobs)


def _compatible(jobs: Sequence[Job], timestep: float | None) -> list[list[int]]:
    """Groups of job indices whose models may share a batch."""
    groups: dict[tuple, list[int]] = {}
    for index, (world, segments) in enumerate(jobs):
        model = world.model
        if segments.qpos.shape != (len(segments), model.nq) or segments.qvel.shape != (len(segments), model.nv):
            raise InputError(
                f"segments: got qpos {segments.qpos.shape} and qvel {segments.qvel.shape}, expected "
                f"({len(segments)}, {model.nq}) and ({len(segments)}, {model.nv}) for this model"
            )
        sizes = tuple(getattr(model, name) for name in _SIZES)
        lifted = bool(model.body_gravcomp.any())  # a batch looks at gravity compensation only where its base has it
        key = (*sizes, timestep or model.opt.timestep, model.opt.integrator, bool(world.laws), lifted)
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _blocks(members: Sequence[int], jobs: Sequence[Job]) -> Iterator[list[Piece]]:
    """Batches of at most `_MAX_ROWS` rows, as lists of pieces of jobs."""
    block: list[Piece] = []
    room = _MAX_ROWS
    for index in members:
        first, count = 0, len(jobs[index][1])
        while first < count:
            last = min(count, first + room)
            block.append((index, first, last))
            room -= last - first
            first = last
            if room == 0:
                yield block
                block, room = [], _MAX_ROWS
    if block:
        yield block


@dataclass(frozen=True, eq=False)
class PreparedBatch:
    """A batch at the starts of segments.

    Attributes:
      base: model of the batch, with its time step.
      batch: with the models and states of all rows.
      pieces: worlds and their segments.
      rows: of each piece.
      forces: constant wrenches and laws of the worlds.
    """

    base: mujoco.MjModel
    batch: Batch
    pieces: list[Job]
    rows: list[slice]
    forces: "_Forces"


def prepared_batch(
    block: Sequence[Piece], jobs: Sequence[Job], timestep: float | None, threads: int | None, disabled: int = 0
) -> PreparedBatch:
    """The batch of a block: models, states and times at the starts of its segments; bits of `disabled` are left out."""
    base = copy.copy(jobs[block[0][0]][0].update_constants())
    if timestep is not None:
        base.opt.timestep = timestep
    base.opt.disableflags |= _unneeded_features(base) | disabled
    pieces = [(jobs[i][0], jobs[i][1].take(slice(a, b))) for i, a, b in block]
    ends = np.cumsum([len(segments) for _, segments in pieces])
    rows = [slice(end - len(segments), end) for end, (_, segments) in zip(ends, pieces, strict=True)]
    count = int(ends[-1])
    # For few rows the synchronisation of threads at every step costs more than it saves.
    most = threads or available_cores()
    batch = Batch(base, nsim=count, nthread=max(1, min(most, count // _ROWS_PER_THREAD)))
    _write_models(batch, base, pieces, rows)
    qpos, qvel, time = batch.bind("qpos"), batch.bind("qvel"), batch.bind("time")
    for (world, segments), own in zip(pieces, rows, strict=True):
        time[own] = segments.start
        qpos[own] = integrate(world.model, segments.qpos, -world.offset) if world.offset.any() else segments.qpos
        qvel[own] = segments.qvel
        if segments.act is not None:
            batch.bind("act")[own] = segments.act
    return PreparedBatch(base, batch, pieces, rows, _Forces(batch, pieces, rows))


def _simulate_batch(own: PreparedBatch, block: list[Piece], out: list[np.ndarray]) -> int:
    """Simulate one batch, write the states of its pieces to `out`, and return the number of steps."""
    base, batch, pieces, forces, dt = own.base, own.batch, own.pieces, own.forces, float(own.base.opt.timestep)
    qpos, qvel, count = batch.bind("qpos"), batch.bind("qvel"), own.rows[-1].stop
    sampler = Sampler(base, pieces, dt)
    controls = Controls(pieces, own.rows, dt, base.nu)
    steps, all_rows = sampler.steps, np.ones(count, bool)
    sampler.record(0, qpos, qvel, all_rows)
    free = not any(world.laws for world, _ in pieces)
    done = rollout_without_laws(batch, sampler, controls) if free else np.zeros(count, int)
    dead, before = np.zeros(count, bool), ~all_rows
    ctrl, total = batch.bind("ctrl"), int(done.sum())
    ids: np.ndarray | None = None
    for k in range(int(done.min(initial=0)), int(steps.max(initial=0))):
        alive = (steps > k) & (done <= k) & ~dead
        if not np.array_equal(alive, before):
            before, ids = alive, None if alive.all() else np.flatnonzero(alive).astype(np.int32)
        if not alive.any():
            continue
        controls.write(k, ctrl)
        if k == 0:
            forces.start()
        forces.apply()
        sampler.before(k + 1, qpos, qvel, alive)
        try:
            batch.step(ids)
        except SimulationError as error:
            dead[error.ids] = True
        total += int(alive.sum())
        sampler.record(k + 1, qpos, qvel, alive & ~dead)
    sampler.write(block, out)
    return total


def _unneeded_features(model: mujoco.MjModel) -> int:
    """Disable flags of features that short simulations do not need."""
    bits = mujoco.mjtDisableBit
    # An invalid state must stay visible: no automatic reset.
    flags = int(bits.mjDSBL_AUTORESET)
    if model.ntree == 1:
        # A single kinematic tree is a single island.
        flags |= int(bits.mjDSBL_ISLAND)
    if model.body_geomnum.max(initial=0) <= _MAX_GEOMS_BRUTE_FORCE:
        flags |= int(bits.mjDSBL_MIDPHASE)
    if model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON and model.opt.iterations >= _MIN_ITERATIONS:
        # The unconstrained acceleration is the better starting point for short windows, whose first step has no
        # predecessor. With few iterations the result depends on the starting point, so the warm start is kept.
        flags |= int(bits.mjDSBL_WARMSTART)
    return flags


def _write_models(batch: Batch, base: mujoco.MjModel, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
    """Write the model of each world into its rows; only fields that differ from the base are expanded."""
    known: dict[int, dict[str, np.ndarray]] = {}
    first = pieces[0][0]
    if all(world is first for world, _ in pieces):
        return  # the base is a copy of this model
    prints, data = fingerprint(base), mujoco.MjData(base)
    for (world, _), own in zip(pieces, rows, strict=True):
        if id(world) not in known:
            known[id(world)] = differing_fields(world, base, prints, data)
        for name, values in known[id(world)].items():
            batch.expand(name)[own] = values


class _Forces:
    """Applies the constant wrenches and the laws of the worlds in a batch."""

    def __init__(self, batch: Batch, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
        self._batch = batch
        self._laws: list[tuple[World, Rows, list[tuple[np.ndarray, np.ndarray]]]] = []
        wrenches = batch.bind("xfrc_applied")
        for (world, _), own in zip(pieces, rows, strict=True):
            wrenches[own] = world.wrench
        # One call for all recordings of a world: calls of laws are a large part of a step.
        with_laws: list[tuple[World, slice]] = []
        for (world, _), own in zip(pieces, rows, strict=True):
            if with_laws and with_laws[-1][0] is world and with_laws[-1][1].stop == own.start:
                with_laws[-1] = world, slice(with_laws[-1][1].start, own.stop)
            elif world.laws:
                with_laws.append((world, own))
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
            unchanged = [(values, np.array(read_field(world.model, name))) for name, values in fields.items()]
            self._laws.append((world, Rows(world.model, **views, **forces, fields=fields), unchanged))
        self._rows = np.concatenate([np.arange(own.start, own.stop) for _, own in with_laws])

    def start(self) -> None:
        """Compute the actuator forces at the start states, which laws may read before the first step."""
        if self._laws:
            self._batch.forward(self._rows)

    def apply(self) -> None:
        """Reset everything that laws may write, then call the laws."""
        for world, rows, unchanged in self._laws:
            rows.qfrc_applied[...] = 0.0
            rows.xfrc_applied[...] = world.wrench
            for values, value in unchanged:
                values[...] = value
            for law in world.laws:
                law(rows)


_SIZES = ("nq", "nv", "nu", "na", "nbody", "njnt", "ngeom", "nsite", "ntendon", "neq", "nM", "nhistory", "nmocap")
"""Model sizes that must be equal within a batch."""
