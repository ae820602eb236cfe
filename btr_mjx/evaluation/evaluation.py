"""Evaluation of pairs (s, c): simulate the behaviour and compute its fitness.

    evaluation = evaluate(robot, simulations, controllers)      # fitness (L, M)

Pairs are divided into blocks of one fixed shape, so that a single compiled program serves any number of pairs and
memory does not grow. For a fixed chunk size, the result of a pair is bit-identical at any position and beside any other
pairs.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.engines import Record, UnsupportedModel, native
from btr_mjx.errors import InputError
from btr_mjx.evaluation.fitness import DISTANCE, FitnessFunction, FitnessLike, Outcome, fitness_function
from btr_mjx.evaluation.own_simulator import run_simulator
from btr_mjx.evaluation.tracked_point import track_point
from btr_mjx.models import Models, base_address, base_model, compile_models, start_of, varying_fields
from btr_mjx.robots import Robot

if TYPE_CHECKING:
    from btr_mjx.engines import Program, Stepper

Engine = Literal["lanes", "mjx", "native"]
"""Name of a physics engine, see `btr_mjx.engines`."""

_LOG = logging.getLogger(__name__)

_MAX_TRIPPED = 0.25
"""Part of the first block that guards may hand to native MuJoCo before it evaluates everything."""

_CAPACITY = 16
"""Chunks per device and block."""

_TRACE_BYTES = 2**26
"""Upper limit of the recorded states of one block [bytes]; blocks are made smaller to respect it."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Fitness of a batch of pairs, of shape (L, M), or (B,) where evaluated pairwise.

    Attributes:
      fitness: f_E of each pair; NaN where it diverged.
      diverged: pairs whose state became invalid, or whose base passed the robot's speed limit.
      solver_capped: number of steps in which the constraint solver reached its iteration limit.
      peak_speed: highest speed of the base [m/s].
      outcome: data from which the fitness was computed.
      engine: the engine that ran.
      tripped: pairs of which `engine` does not compute a contact that may have taken part, as its guards found; native
        MuJoCo has evaluated them instead.
    """

    fitness: np.ndarray
    diverged: np.ndarray
    solver_capped: np.ndarray
    peak_speed: np.ndarray
    outcome: Outcome
    engine: Engine
    tripped: np.ndarray


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


def evaluate(
    robot: Robot,
    simulations: ArrayLike,
    controllers: ArrayLike,
    *,
    pairwise: bool = False,
    engine: Engine | None = None,
    fitness: FitnessLike = DISTANCE,
    times: ArrayLike | None = None,
    states: bool = False,
    settings: EngineSettings = EngineSettings(),
    progress: Callable[[int], object] | None = None,
) -> Evaluation:
    """Evaluate controllers in simulations.

    Args:
      robot: the robot.
      simulations: (L, n_s) parameters inside the robot's simulation box.
      controllers: (M, n_c) parameters inside the robot's controller box.
      pairwise: evaluate row i with row i (L = M = B) rather than every simulation with every controller.
      engine: "lanes", "mjx" or "native"; None for the fastest one that supports this robot. Pairs in which a contact
        may take part that "lanes" does not compute are evaluated by native MuJoCo, see `Evaluation.tripped`; where
        None is given and more than a quarter of the first block are such pairs, native MuJoCo evaluates all.
      fitness: a fitness function, or its name as in a robot.toml, see `fitness_function`.
      times: (K,) sample times in (0, T_e] [s] for the outcome, rounded to steps; None for the end alone. The last one
        ends the trial.
      states: whether the outcome holds qpos, qvel and act at the sample times.
      settings: how the engine runs.
      progress: called with the number of pairs done since the last call.

    Returns:
      The evaluation.

    Raises:
      InputError: parameters out of bounds, of a wrong shape or not finite, unequal rows where pairwise, bad times, an
        unknown fitness.
      UnsupportedModel: the given engine does not support this robot.
    """
    fitness = fitness_function(fitness, robot.target)
    s, c = checked_pairs(robot, simulations, controllers)
    if pairwise and len(s) != len(c):
        raise InputError(f"pairwise: got {len(s)} simulations and {len(c)} controllers, expected as many of each")
    shape = (len(s),) if pairwise else (len(s), len(c))
    chosen = engine or fastest_engine(robot)
    recorded = states or fitness.needs_states or bool(robot.point)
    dt = settings.timestep if chosen == "native" and settings.timestep else float(base_model(robot).opt.timestep)
    samples = _sample_steps(robot, times, dt)
    runner = _runner(robot, chosen, samples, recorded, settings)
    records: list[Record] = []
    for rows, columns in _blocks(shape, runner.block):
        used, index = np.unique(rows, return_inverse=True)
        models, own = compile_models(robot, s[used]), c[columns]
        record = runner(models, s[used], index, own)
        tripped = np.flatnonzero(record.tripped)
        if len(tripped) and engine is None and not records and len(tripped) > _MAX_TRIPPED * len(rows):
            _LOG.warning(
                "%s: lanes does not compute contacts of %d of the first %d pairs; native MuJoCo evaluates all",
                *(robot.name, len(tripped), len(rows)),
            )
            return evaluate(
                robot,
                s,
                c,
                pairwise=pairwise,
                engine="native",
                fitness=fitness,
                times=times,
                states=states,
                progress=progress,
            )
        if len(tripped):
            native_runner = _runner(robot, "native", samples, recorded, EngineSettings())
            record = _replace_rows(record, tripped, native_runner(models, s[used], index[tripped], own[tripped]))
        records.append(record)
        if progress is not None:
            progress(len(rows))
    record = Record(*(np.concatenate(column) for column in zip(*records, strict=True)))
    return _evaluation(robot, chosen, record, samples * dt, shape, fitness, recorded)


def checked_pairs(robot: Robot, simulations: ArrayLike, controllers: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Simulations (L, n_s) and controllers (M, n_c) as arrays.

    Raises:
      InputError: parameters out of bounds, of a wrong shape or not finite, or none.
    """
    s = np.atleast_2d(robot.simulation_box.validate(simulations, "simulations"))
    c = np.atleast_2d(robot.controller_box.validate(controllers, "controllers"))
    if s.ndim != 2 or c.ndim != 2 or not len(s) or not len(c):
        raise InputError(
            f"got simulations {s.shape} and controllers {c.shape}, expected non-empty (L, n_s) and (M, n_c)"
        )
    return s, c


def fastest_engine(robot: Robot) -> Engine:
    """The fastest engine that supports a robot: lanes; otherwise MJX on an accelerator or native on a CPU.

    A simulator of the robot's own counts as native.
    """
    if robot.simulator is not None:
        return "native"
    import jax  # takes seconds, which bad input should not

    from btr_mjx.engines import uses_doubles

    try:
        _stepper(_program_inputs(robot), "lanes", uses_doubles(), guards=True)
        return "lanes"
    except UnsupportedModel:
        return "native" if jax.default_backend() == "cpu" else "mjx"


def _evaluation(
    robot: Robot,
    engine: Engine,
    record: Record,
    times: np.ndarray,
    shape: tuple[int, ...],
    fitness: FitnessFunction,
    states: bool,
) -> Evaluation:
    whole = {name: np.asarray(value, np.float64) for name, value in record._asdict().items()}
    whole = {name: value.reshape(*shape, *value.shape[1:]) for name, value in whole.items()}
    outcome = Outcome(
        times,
        whole["start"],
        whole["position"],
        whole["energy"],
        *(whole[name] if states else None for name in ("qpos", "qvel", "act")),
    )
    finite = np.isfinite(outcome.position).all((-2, -1))
    if robot.simulator is None:
        finite &= np.isfinite(outcome.energy).all(-1)
    # NaN fails the comparison: an invalid speed counts as too fast.
    diverged = ~(finite & (whole["peak_speed"] <= robot.speed_limit))
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.where(diverged, np.nan, fitness(outcome))
    counts, tripped = whole["capped"].astype(int), whole["tripped"].astype(bool)
    return Evaluation(values, diverged, counts, whole["peak_speed"], outcome, engine, tripped)


def _sample_steps(robot: Robot, times: ArrayLike | None, timestep: float) -> np.ndarray:
    wanted = np.atleast_1d(np.asarray(robot.duration if times is None else times, np.float64))
    steps = np.round(wanted / timestep)
    if wanted.ndim != 1 or not wanted.size or not np.all(np.isfinite(steps)) or np.any(np.diff(steps, prepend=0) < 1):
        raise InputError(
            f"times: got {wanted.tolist()}, expected ascending times at least one step of {timestep} s apart"
        )
    if wanted[-1] > robot.duration * (1 + 1e-9):
        raise InputError(f"times: got {wanted[-1]} s, expected at most the trial's duration of {robot.duration} s")
    return steps.astype(int)


def _blocks(shape: tuple[int, ...], size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Row and column indices of the pairs, in C order, `size` at a time."""
    count = int(np.prod(shape))
    for first in range(0, count, size):
        flat = np.arange(first, min(first + size, count))
        yield (flat, flat) if len(shape) == 1 else (flat // shape[1], flat % shape[1])


@dataclass(frozen=True)
class _Runner:
    """Runs blocks of pairs: models, their simulations, the index of each pair's model, controllers (B, n_c)."""

    robot: Robot
    block: int
    simulate: Callable[[Models, np.ndarray, np.ndarray, np.ndarray], Record]

    def __call__(self, models: Models, simulations: np.ndarray, index: np.ndarray, controllers: np.ndarray) -> Record:
        """The record, with the position of the robot's tracked point if it has one."""
        record = self.simulate(models, simulations, index, controllers)
        return track_point(self.robot, models, index, record) if self.robot.point else record


def _replace_rows(record: Record, rows: np.ndarray, other: Record) -> Record:
    """The record with rows of another engine; they stay marked as tripped."""

    def merged(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        result = np.array(mine, np.result_type(mine, theirs))
        result[rows] = theirs
        return result

    return Record(*map(merged, record, other._replace(tripped=np.ones(len(rows), bool))))


def _runner(robot: Robot, engine: Engine, samples: np.ndarray, states: bool, settings: EngineSettings) -> _Runner:
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
        return _Runner(robot, settings.chunk or 8192, run_own)
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
        return _Runner(robot, settings.chunk or 256, run_native)
    from btr_mjx.engines import uses_doubles

    inputs = _program_inputs(robot)
    program = _program(inputs, engine, len(samples), states, settings.chunk, uses_doubles())
    run = lambda models, _, index, controllers: program(  # noqa: E731
        {name: values[index] for name, values in models.leaves.items()}, controllers, samples
    )
    return _Runner(robot, program.layout.pairs, run)


def _program_inputs(robot: Robot) -> Robot:
    """The robot reduced to what compiled programs depend on, as a key of caches."""
    return replace(robot, name="", duration=1.0, speed_limit=1.0)


@lru_cache(maxsize=16)
def _stepper(robot: Robot, engine: Engine, x64: bool, guards: bool = False) -> "Stepper":
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
    stepper = _stepper(robot, engine, x64, guards=True)
    width = chunk or default_chunk(devices[0])
    record_bytes = (
        samples * (stepper.nq + stepper.nv + stepper.nu if states else 4) * width * len(devices) * (8 if x64 else 4)
    )
    capacity = int(np.clip(_TRACE_BYTES // record_bytes, 1, _CAPACITY if devices[0].platform == "cpu" else 4))
    layout = Layout(len(devices), capacity, width)
    return Program(stepper, robot.signal, base_address(robot), layout, states, devices, start_of(robot))
