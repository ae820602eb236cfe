"""Evaluation of all pairs of (simulations, controllers) in blocks.

    table = evaluate_blocks(robot, simulations, controllers, blocks=BlockSettings(folder=Path("runs/pairs")))
    table.fitness                                                   # (L, M)
    for block in iterate_blocks(robot, simulations, controllers):   # where (L, M) is too large for the memory
        block.rows, block.columns, block.fitness

A block is a nearly square tile of the table (L, M), so that few simulations and controllers describe it. Its file is
named by the SHA-256 of everything that its numbers depend on: the same call continues where a killed one stopped, and
computes nothing that is there. Results do not depend on which process computes a block, nor on the size of blocks.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.cluster.connection import check_cluster, connect
from btr_mjx.cluster.mapping import map_tasks
from btr_mjx.errors import DamagedFile, InputError
from btr_mjx.evaluation import (
    Engine,
    EngineSettings,
    FitnessFunction,
    FitnessLike,
    checked_pairs,
    evaluate,
    fastest_engine,
    fitness_of,
)
from btr_mjx.models import robot_digest
from btr_mjx.robots import Robot
from btr_mjx.runs import content_digest, note, read_arrays, write_arrays

_FORMAT = 1
"""Version of the block files."""

_NAME = "__name__"
"""Array that holds a block's name, so that a file under another block's name is noticed."""


@dataclass(frozen=True)
class BlockSettings:
    """How pairs are divided, where results are kept and who computes them.

    Attributes:
      folder: folder of the block files; None keeps nothing.
      size: pairs per block.
      cluster: None for this process, a text as of `check_cluster`, or a `distributed.Client`.
    """

    folder: Path | None = None
    size: int = 4096
    cluster: Any = None

    def __post_init__(self) -> None:
        if self.size < 1:
            raise InputError(f"blocks: got size {self.size}, expected at least 1")
        if isinstance(self.cluster, str):
            check_cluster(self.cluster)


@dataclass(frozen=True, eq=False)
class PairBlock:
    """Results of a tile of the table.

    Attributes:
      name: SHA-256 of its content, the stem of its file.
      rows: its simulations.
      columns: its controllers.
      fitness: (rows, columns), NaN where a pair diverged.
      diverged: (rows, columns) bool, see `Evaluation`.
      solver_capped: (rows, columns) int32, see `Evaluation`.
    """

    name: str
    rows: slice
    columns: slice
    fitness: np.ndarray
    diverged: np.ndarray
    solver_capped: np.ndarray


@dataclass(frozen=True, eq=False)
class PairTable:
    """Results of all pairs.

    Attributes:
      fitness: (L, M), NaN where a pair diverged.
      diverged: (L, M) bool, see `Evaluation`.
      solver_capped: (L, M) int32, see `Evaluation`.
      engine: the engine that ran.
    """

    fitness: np.ndarray
    diverged: np.ndarray
    solver_capped: np.ndarray
    engine: Engine


def evaluate_blocks(
    robot: Robot,
    simulations: ArrayLike,
    controllers: ArrayLike,
    *,
    engine: Engine | None = None,
    fitness: FitnessLike | None = None,
    settings: EngineSettings | None = None,
    blocks: BlockSettings = BlockSettings(),
    progress: Callable[[int], object] | None = None,
) -> PairTable:
    """Evaluate all controllers in all simulations; arguments and errors as of `iterate_blocks`.

    Returns:
      The table, equal to that of `evaluate` to the bit; it takes 13 bytes per pair.
    """
    s, c = checked_pairs(robot, simulations, controllers)
    fitness = fitness_of(robot, fitness)
    chunk, shape = settings.chunk if settings else None, (len(s), len(c))
    engine = engine or fastest_engine(robot, states=fitness.needs_states, chunk=chunk)
    table = PairTable(np.empty(shape), np.empty(shape, bool), np.empty(shape, np.int32), engine)
    options: dict[str, Any] = {"engine": engine, "fitness": fitness, "settings": settings, "blocks": blocks}
    for block in iterate_blocks(robot, s, c, **options, progress=progress):
        place = (block.rows, block.columns)
        table.fitness[place], table.diverged[place] = block.fitness, block.diverged
        table.solver_capped[place] = block.solver_capped
    return table


def iterate_blocks(
    robot: Robot,
    simulations: ArrayLike,
    controllers: ArrayLike,
    *,
    engine: Engine | None = None,
    fitness: FitnessLike | None = None,
    settings: EngineSettings | None = None,
    blocks: BlockSettings = BlockSettings(),
    progress: Callable[[int], object] | None = None,
) -> Iterator[PairBlock]:
    """Evaluate all controllers in all simulations, block by block. Memory does not grow with the number of pairs.

    Args:
      robot: the robot. For a cluster, files that its MJCF names lie at the same path on all hosts.
      simulations: (L, n_s) parameters inside the robot's simulation box.
      controllers: (M, n_c) parameters inside the robot's controller box.
      engine: see `evaluate`.
      fitness: see `evaluate`.
      settings: see `EngineSettings`.
      blocks: how pairs are divided, where results are kept and who computes them.
      progress: called with the number of pairs done since the last call, those read from files included; on a cluster
        also with 0 while it waits.

    Yields:
      Every block once: first those whose files are there, then those that are computed, each after it was written.

    Raises:
      InputError: as of `evaluate`; or the cluster cannot be used, see `connect` and `map_tasks`.
      OSError: a file cannot be read or written.
    """
    from btr_mjx.engines import uses_doubles  # loads JAX

    s, c = checked_pairs(robot, simulations, controllers)
    how = settings or EngineSettings()
    fitness = fitness_of(robot, fitness)
    chosen = engine or fastest_engine(robot, states=fitness.needs_states, chunk=how.chunk)
    compute = partial(_compute, robot, chosen, fitness, how)
    # Threads do not change results, so that they may differ on resume.
    key = content_digest(
        _FORMAT, robot_digest(robot), fitness, chosen, how.chunk, how.timestep, how.integrator, uses_doubles()
    )
    step = progress or (lambda pairs: None)

    def block(name: str, rows: slice, columns: slice, arrays: dict[str, np.ndarray]) -> PairBlock:
        return PairBlock(name, rows, columns, arrays["fitness"], arrays["diverged"], arrays["solver_capped"])

    left = []
    for rows, columns in tiles(len(s), len(c), blocks.size):
        name = content_digest(key, s[rows], c[columns])
        arrays = read_block(blocks.folder, name)
        if arrays is None:
            left.append((name, rows, columns))
        else:
            step(arrays["fitness"].size)
            yield block(name, rows, columns, arrays)
    if blocks.cluster is None:
        for name, rows, columns in left:
            arrays = compute(s[rows], c[columns], progress=progress)
            write_block(blocks.folder, name, arrays)
            yield block(name, rows, columns, arrays)
    elif left:
        places: dict[str, list[tuple[slice, slice]]] = {}
        for name, rows, columns in left:  # tiles of equal content are computed once
            places.setdefault(name, []).append((rows, columns))
        tasks = ((name, (s[rows], c[columns])) for name, [(rows, columns), *_] in places.items())
        function = partial(_compute_there, robot_digest(robot), compute)
        with connect(blocks.cluster) as client:
            for name, arrays in map_tasks(
                client, function, tasks, jax_backend=chosen != "native", idle=lambda: step(0)
            ):
                write_block(blocks.folder, name, arrays)
                for rows, columns in places[name]:
                    step(arrays["fitness"].size)
                    yield block(name, rows, columns, arrays)


def tiles(rows: int, columns: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Tiles of a table (rows, columns) of at most `size` pairs each, as square as its shape allows, row by row."""
    side = math.isqrt(size)
    wide = min(columns, max(side, size // min(rows, side)))
    wide = math.ceil(columns / math.ceil(columns / wide))  # tiles of one width rather than a narrow last one
    tall = min(rows, size // wide)
    for top in range(0, rows, tall):
        for left in range(0, columns, wide):
            yield slice(top, min(top + tall, rows)), slice(left, min(left + wide, columns))


def read_block(folder: Path | None, name: str) -> dict[str, np.ndarray] | None:
    """The arrays of a finished block; None where they are missing or, which prints a line, damaged."""
    if folder is None or not (folder / f"{name}.npz").exists():
        return None
    path = folder / f"{name}.npz"
    try:
        arrays = read_arrays(path, require_digest=True)
        if str(arrays.pop(_NAME, "")) != name:
            raise DamagedFile(f"{path}: holds another block")
    except DamagedFile as error:
        note(f"warning: {error}; the block is computed again")
        return None
    return arrays


def write_block(folder: Path | None, name: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Write the arrays of a finished block, unless nothing is kept."""
    if folder is not None:
        write_arrays(folder / f"{name}.npz", {_NAME: np.array(name), **arrays})


def _compute(
    robot: Robot,
    engine: Engine,
    fitness: FitnessFunction,
    settings: EngineSettings,
    simulations: np.ndarray,
    controllers: np.ndarray,
    progress: Callable[[int], object] | None = None,
) -> dict[str, np.ndarray]:
    """The arrays of a block's file."""
    found = evaluate(
        robot, simulations, controllers, engine=engine, fitness=fitness, settings=settings, progress=progress
    )
    return {
        "fitness": found.fitness,
        "diverged": found.diverged,
        "solver_capped": found.solver_capped.astype(np.int32),
    }


def _compute_there(
    expected: str, compute: Any, simulations: np.ndarray, controllers: np.ndarray
) -> dict[str, np.ndarray]:
    """The same on a worker, where the robot's files may be missing or others."""
    robot = compute.args[0]
    if robot_digest(robot) != expected:
        raise InputError(
            f"{robot.template_path}: the files that it names differ on a worker; expected them in "
            f"{robot.folder or 'the working folder'} on every host, as on a shared file system"
        )
    return compute(simulations, controllers)
