"""Engines for a robot: the runners, steppers and compiled programs, each made once; and rollouts of many pairs."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from btr_mjx.engines import Record, native
from btr_mjx.errors import InputError
from btr_mjx.evaluation.own_simulator import run_simulator
from btr_mjx.evaluation.tracked_point import track_point
from btr_mjx.models import Models, base_address, base_model, compile_models, start_of, varying_fields
from btr_mjx.robots import Robot

if TYPE_CHECKING:
    from btr_mjx.engines import Program, Stepper

Engine = Literal["lanes", "mjx", "native"]
"""Name of a physics engine, see `btr_mjx.engines`."""

_CAPACITY = 16
"""Chunks per device and block."""

_TRACE_BYTES = 2**26
"""Upper limit of the recorded states of one block [bytes]; blocks are made smaller to respect it."""


@dataclass(frozen=True)
class EngineSettings:
    """Settings of an engine.

    Attributes:
      chunk: pairs per chunk; None for the engine's default. Results are bit-identical for a fixed chunk size only.
      timestep: native only: another time step than the model's [s].
      integrator: native only: another integrator, see `native.INTEGRATORS`.
      threads: native only: number of threads; None for all cores.
    """

    chunk: int | None = None
    timestep: float | None = None
    integrator: str | None = None
    threads: int | None = None


@dataclass(frozen=True)
class Runner:
    """Runs blocks of pairs: models, their simulations, the index of each pair's model, controllers (B, n_c)."""

    robot: Robot
    block: int
    simulate: Callable[[Models, np.ndarray, np.ndarray, np.ndarray], Record]

    def __call__(self, models: Models, simulations: np.ndarray, index: np.ndarray, controllers: np.ndarray) -> Record:
        """The record, with the position of the robot's tracked point if it has one."""
        record = self.simulate(models, simulations, index, controllers)
        return track_point(self.robot, models, index, record) if self.robot.point else record


def runner_of(robot: Robot, engine: Engine, samples: np.ndarray, states: bool, settings: EngineSettings) -> Runner:
    """The runner of an engine that records samples (K,), with states where they are asked for."""
    if engine not in get_args(Engine):
        raise InputError(f"engine: got {engine!r}, expected one of: {', '.join(get_args(Engine))}")
    if engine != "native" and (settings.timestep or settings.integrator or settings.threads):
        raise InputError(f"engine {engine!r}: another timestep, integrator or thread count needs engine='native'")
    address = base_address(robot)
    if robot.simulator is not None:
        if engine != "native" or settings.integrator or settings.threads:
            raise InputError(
                f"engine {engine!r}: {robot.name} has a simulator of its own, which counts as 'native' and takes no "
                "other integrator or number of threads"
            )
        run_own = partial(run_simulator, robot, address, samples, settings.timestep)
        return Runner(robot, settings.chunk or 8192, run_own)
    if engine == "native":
        run_native = lambda models, _, index, controllers: native.rollout_native(  # noqa: E731
            models.base,
            {name: values[index] for name, values in models.leaves.items()},
            controllers,
            samples,
            signal=robot.signal,
            base_address=address,
            record_states=states,
            start=start_of(robot),
            timestep=settings.timestep,
            integrator=settings.integrator,
            threads=settings.threads,
        )
        return Runner(robot, settings.chunk or 256, run_native)
    program = program_of(robot, engine, len(samples), states, settings.chunk)
    run = lambda models, _, index, controllers: program(  # noqa: E731
        {name: values[index] for name, values in models.leaves.items()}, controllers, samples
    )
    return Runner(robot, program.layout.pairs, run)


def run_pairs(
    robot: Robot,
    simulations: np.ndarray,
    controllers: np.ndarray,
    *,
    engine: Engine,
    samples: np.ndarray,
    states: bool,
    settings: EngineSettings,
    pairwise: bool,
    progress: Callable[[int], object] | None = None,
) -> Record:
    """The record of pairs in C order, block by block; arguments as of `evaluate` and `runner_of`.

    Pairs of which a guard trips are evaluated by native MuJoCo, and stay marked as tripped.
    """
    runner, records = runner_of(robot, engine, samples, states, settings), list[Record]()
    shape = (len(simulations),) if pairwise else (len(simulations), len(controllers))
    for rows, columns in _blocks(shape, runner.block):
        used, index = np.unique(rows, return_inverse=True)
        models, own = compile_models(robot, simulations[used]), controllers[columns]
        record = runner(models, simulations[used], index, own)
        tripped = np.flatnonzero(record.tripped)
        if len(tripped):
            exact = runner_of(robot, "native", samples, states, EngineSettings())
            record = _replace_rows(record, tripped, exact(models, simulations[used], index[tripped], own[tripped]))
        records.append(record)
        if progress is not None:
            progress(len(rows))
    return Record(*(np.concatenate(column) for column in zip(*records, strict=True)))


def _blocks(shape: tuple[int, ...], size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Row and column indices of the pairs, in C order, `size` at a time."""
    count = int(np.prod(shape))
    for first in range(0, count, size):
        flat = np.arange(first, min(first + size, count))
        yield (flat, flat) if len(shape) == 1 else (flat // shape[1], flat % shape[1])


def _replace_rows(record: Record, rows: np.ndarray, other: Record) -> Record:
    """The record with rows of another engine; they stay marked as tripped."""

    def merged(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        result = np.array(mine, np.result_type(mine, theirs))
        result[rows] = theirs
        return result

    return Record(*map(merged, record, other._replace(tripped=np.ones(len(rows), bool))))


def stepper_of(robot: Robot, engine: Engine, guards: bool = False) -> "Stepper":
    """The stepper of an engine inside JAX, of which there is one per robot and precision."""
    from btr_mjx.engines import uses_doubles

    return _stepper(_program_inputs(robot), engine, uses_doubles(), guards)


def program_of(robot: Robot, engine: Engine, samples: int, states: bool, chunk: int | None) -> "Program":
    """The compiled program of an engine inside JAX for a number of samples, likewise."""
    from btr_mjx.engines import uses_doubles

    return _program(_program_inputs(robot), engine, samples, states, chunk, uses_doubles())


def _program_inputs(robot: Robot) -> Robot:
    """The robot reduced to what compiled programs depend on, as a key of caches."""
    return replace(robot, name="", duration=1.0, speed_limit=1.0)


@lru_cache(maxsize=16)
def _stepper(robot: Robot, engine: Engine, x64: bool, guards: bool) -> "Stepper":
    model, varying = base_model(robot), frozenset(varying_fields(robot))
    # Imported here, since each import takes a second.
    if engine == "lanes":
        from btr_mjx.engines import LanesStepper

        return LanesStepper(model, varying, guards=guards)
    from btr_mjx.engines import MjxStepper

    return MjxStepper(model, varying)


@lru_cache(maxsize=16)
def _program(robot: Robot, engine: Engine, samples: int, states: bool, chunk: int | None, x64: bool) -> "Program":
    import jax

    from btr_mjx.engines import Layout, Program, default_chunk, use_all_cores, use_compilation_cache

    use_all_cores()
    use_compilation_cache()
    devices = jax.devices()
    stepper = _stepper(robot, engine, x64, True)
    width = chunk or default_chunk(devices[0])
    record_bytes = (
        samples * (stepper.nq + stepper.nv + stepper.nu if states else 4) * width * len(devices) * (8 if x64 else 4)
    )
    capacity = int(np.clip(_TRACE_BYTES // record_bytes, 1, _CAPACITY if devices[0].platform == "cpu" else 4))
    layout = Layout(len(devices), capacity, width)
    return Program(stepper, robot.signal, base_address(robot), layout, states, devices, start_of(robot))
