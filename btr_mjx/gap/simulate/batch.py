"""Simulation of worlds by the thousand in native MuJoCo.

A `World` is a model with its command edits, laws and encoder offsets: what an effect edits. A `Stretch` is a set of
windows of the data. `simulate` runs every job, a world over a stretch, in as few batches as possible; the control is
sampled in the middle of each step, because a control held from the step's start looks like a delay of half a step.
"""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from threading import Lock

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from btr_mjx.errors import InputError
from btr_mjx.gap.simulate.lawless import freewheel
from btr_mjx.gap.simulate.laws import Rows
from btr_mjx.gap.simulate.stretches import Controls, Job, Piece, Sampler, Stretch
from btr_mjx.gap.simulate.world import CommandEdit, World, fields_of, fingerprint
from btr_mjx.models import integrate, read_field
from btr_mjx.runs import available_cores

__all__ = ["CommandEdit", "Counter", "Job", "Stretch", "World", "fields_of", "simulate"]

_ROWS_PER_THREAD = 4
"""Rows that are worth a thread."""

_ROWS = 8192
"""Rows of one batch: bounds the memory that many jobs take."""

_FEW_GEOMS = 8
"""Geoms of a body up to which MuJoCo's middle phase of collision detection costs more than it brings."""

_ENOUGH = 20
"""Iterations in which Newton's method converges wherever it begins."""


@dataclass
class Counter:
    """Simulated steps, summed over all rows; a `journal.Journal` also keeps what came out of them.

    Searches simulate in several threads, which share one counter.
    """

    steps: int = 0
    lock: Lock = field(default_factory=Lock, repr=False)

    def recall(self, jobs: Sequence[Job], timestep: float | None) -> list[np.ndarray] | None:
        """States of these jobs where they are known already."""
        return None

    def add(self, steps: int) -> None:
        """Count steps."""
        with self.lock:
            self.steps += steps

    def keep(self, jobs: Sequence[Job], timestep: float | None, states: Sequence[np.ndarray], steps: int) -> None:
        """Take note of the states of these jobs, and of the steps that they took."""
        self.add(steps)


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
    known = None if counter is None else counter.recall(jobs, timestep)
    if known is not None:
        return known
    out = [np.empty((*stretch.times.shape, world.model.nq + world.model.nv)) for world, stretch in jobs]
    steps = 0
    for members in _alike(jobs, timestep):
        for block in _blocks(members, jobs):
            steps += _run(block, jobs, out, timestep, threads)
    for (world, _), states in zip(jobs, out, strict=True):
        if world.offset.any():
            nq = world.model.nq
            states[..., :nq] = integrate(world.model, states[..., :nq], world.offset)
    if counter is not None:
        counter.keep(jobs, timestep, out, steps)
    return out


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
        key = (*sizes, timestep or model.opt.timestep, model.opt.integrator, bool(world.laws))
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _blocks(members: Sequence[int], jobs: Sequence[Job]) -> Iterator[list[Piece]]:
    """Pieces of jobs that fill a batch of at most `_ROWS` rows."""
    block: list[Piece] = []
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
    block: list[Piece],
    jobs: Sequence[Job],
    out: list[np.ndarray],
    timestep: float | None,
    threads: int | None,
) -> int:
    """Simulate one batch and write the states of its pieces; returns the number of steps."""
    base = copy.copy(jobs[block[0][0]][0].settle())
    if timestep is not None:
        base.opt.timestep = timestep
    base.opt.disableflags |= _needless(base)
    dt = float(base.opt.timestep)
    pieces = [(jobs[i][0], jobs[i][1].take(slice(a, b))) for i, a, b in block]
    ends = np.cumsum([len(stretch) for _, stretch in pieces])
    rows = [slice(end - len(stretch), end) for end, (_, stretch) in zip(ends, pieces, strict=True)]
    count = int(ends[-1])
    # Threads that wait for each other at every step cost more than they bring to a few rows.
    most = threads or available_cores()
    batch = Batch(base, nsim=count, nthread=max(1, min(most, count // _ROWS_PER_THREAD)))
    _write_models(batch, base, pieces, rows)
    qpos, qvel, time = batch.bind("qpos"), batch.bind("qvel"), batch.bind("time")
    for (world, stretch), own in zip(pieces, rows, strict=True):
        time[own] = stretch.start
        qpos[own] = integrate(world.model, stretch.qpos, -world.offset) if world.offset.any() else stretch.qpos
        qvel[own] = stretch.qvel
        if stretch.act is not None:
            batch.bind("act")[own] = stretch.act
    sampler = Sampler(base, pieces, dt)
    controls = Controls(pieces, rows, dt, base.nu)
    forces = _Forces(batch, pieces, rows)
    steps, everyone = sampler.steps, np.ones(count, bool)
    sampler.record(0, qpos, qvel, everyone)
    free = not any(world.laws for world, _ in pieces)
    done = freewheel(batch, sampler, controls) if free else np.zeros(count, int)
    dead, before = np.zeros(count, bool), ~everyone
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


def _needless(model: mujoco.MjModel) -> int:
    """Disable flags of what windows of a model do without."""
    bits = mujoco.mjtDisableBit
    # An invalid state must stay visible; MuJoCo's automatic reset would turn it into a new start.
    flags = int(bits.mjDSBL_AUTORESET)
    if model.ntree == 1:
        # One tree is one island: to look for others takes a twentieth of a step.
        flags |= int(bits.mjDSBL_ISLAND)
    if model.body_geomnum.max(initial=0) <= _FEW_GEOMS:
        # The pairs that a tree of bounding volumes would leave out are dismissed sooner than it is walked through.
        flags |= int(bits.mjDSBL_MIDPHASE)
    if model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON and model.opt.iterations >= _ENOUGH:
        # Windows are short, and the first of their steps has no step before it: Newton's method is there sooner from
        # the acceleration without constraints. Where iterations are few, what it ends with depends on where it began.
        flags |= int(bits.mjDSBL_WARMSTART)
    return flags


def _write_models(batch: Batch, base: mujoco.MjModel, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
    """Give every row its world's model: only the fields in which a world differs are expanded."""
    known: dict[int, dict[str, np.ndarray]] = {}
    first = pieces[0][0]
    if all(world is first for world, _ in pieces):
        return  # the batch was made of it
    prints, data = fingerprint(base), mujoco.MjData(base)
    for (world, _), own in zip(pieces, rows, strict=True):
        if id(world) not in known:
            known[id(world)] = fields_of(world, base, prints, data)
        for name, values in known[id(world)].items():
            batch.expand(name)[own] = values


class _Forces:
    """Constant wrenches and laws of the worlds in a batch."""

    def __init__(self, batch: Batch, pieces: Sequence[Job], rows: Sequence[slice]) -> None:
        self._batch = batch
        self._laws: list[tuple[World, Rows, list[tuple[np.ndarray, np.ndarray]]]] = []
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
            unchanged = [(values, np.array(read_field(world.model, name))) for name, values in fields.items()]
            self._laws.append((world, Rows(world.model, **views, **forces, fields=fields), unchanged))
        self._rows = np.concatenate([np.arange(own.start, own.stop) for _, own in with_laws])

    def start(self) -> None:
        """Compute the actuators' forces at the start states, which laws may read before the first step."""
        if self._laws:
            self._batch.forward(self._rows)

    def apply(self) -> None:
        """Put back what laws may have changed, then call them."""
        for world, rows, unchanged in self._laws:
            rows.qfrc_applied[...] = 0.0
            rows.xfrc_applied[...] = world.wrench
            for values, value in unchanged:
                values[...] = value
            for law in world.laws:
                law(rows)


_SIZES = ("nq", "nv", "nu", "na", "nbody", "njnt", "ngeom", "nsite", "ntendon", "neq", "nM", "nhistory", "nmocap")
"""What the models of one batch must agree in."""
