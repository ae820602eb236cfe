"""Fitness and trajectory of one pair (s, c) as JAX functions, to be mapped, compiled and differentiated by the user.

    fitness = pair_fitness(robot)
    leaves = model_leaves(robot, simulations)                        # every array (L, ...)
    all_pairs = jax.vmap(jax.vmap(fitness, (None, 0)), (0, None))    # (leaves, (M, n_c)) -> (L, M)
    f = jax.jit(all_pairs)(leaves, controllers)
    slope = jax.jacfwd(fitness, argnums=1)(one_row_of_leaves, controller)    # (n_c,)

`jax.vmap` passes whole chunks of pairs to the engine, which keeps them in its SIMD lanes (see
`btr_mjx.evaluation.rowwise`). Results equal those of `evaluate`: the model fields are double precision in both, and the
engine's parameters are derived from them in double precision before they are rounded.

Derivatives are those of the computed motion, with the active set of the contact solver fixed within a step; over many
contacts they grow exponentially, since the motion is chaotic. Only forward mode is supported (`jax.jvp`, `jax.jacfwd`):
the solver is a loop of variable length, which JAX cannot differentiate in reverse mode.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import ArrayLike

from btr_mjx.engines import (
    Record,
    Stepper,
    UnsupportedModel,
    default_chunk,
    rollout_chunk,
    use_all_cores,
    use_compilation_cache,
)
from btr_mjx.errors import InputError
from btr_mjx.evaluation.engine_choice import Engine, stepper_of
from btr_mjx.evaluation.evaluation import sample_steps
from btr_mjx.evaluation.fitness import FitnessLike, Outcome, fitness_of
from btr_mjx.evaluation.rowwise import rowwise
from btr_mjx.evaluation.traced import TracedArray, in_double
from btr_mjx.models import base_address, base_model, compile_models, start_of
from btr_mjx.robots import Robot

ModelLeaves = dict[str, Any]
"""MjModel field -> array of the field's shape: the model fields of one simulation."""


class Trajectory(NamedTuple):
    """A behaviour at K sample times.

    Attributes:
      position: (K, 3) base position [m].
      energy: (K,) mechanical work of the motors so far [J].
      qpos: (K, nq) generalised positions.
      qvel: (K, nv) generalised velocities.
    """

    position: jax.Array
    energy: jax.Array
    qpos: jax.Array
    qvel: jax.Array


def model_leaves(robot: Robot, simulations: ArrayLike) -> ModelLeaves:
    """Compile simulations and stack the model fields in which they can differ.

    Args:
      robot: the robot.
      simulations: (L, n_s) parameters inside the robot's simulation box.

    Returns:
      MjModel field -> (L, *field shape), the fields that can influence the motion. Double precision in any mode of
      JAX, so that derived parameters are rounded only once. Arithmetic on them should run within `jax.enable_x64`;
      otherwise JAX converts them to single precision, which is also accepted.

    Raises:
      InputError: bad parameters, or a model that MuJoCo does not accept.
    """
    with jax.enable_x64(True):
        models = compile_models(robot, simulations)
        return {name: jnp.asarray(models.leaves[name]) for name in _influential(models.leaves)}


def pair_fitness(
    robot: Robot,
    engine: Engine | None = None,
    *,
    fitness: FitnessLike | None = None,
    steps: int | None = None,
    chunk: int | None = None,
    devices: Sequence[jax.Device] | None = None,
) -> Callable[[ModelLeaves, Any], jax.Array]:
    """A function that computes the fitness of one pair, to be mapped with `jax.vmap`.

    Args:
      robot: the robot.
      engine: "lanes" or "mjx"; None for lanes where it supports this robot, else mjx.
      fitness: as of `evaluate`; its NumPy or `jax.numpy` code is traced.
      steps: length of the trial in steps; None for the robot's duration.
      chunk: number of pairs that are stepped together; None for 64 on a CPU, more on an accelerator. Results are
        bit-identical for a fixed chunk size only.
      devices: devices over which chunks are distributed; None for all. If the arguments are committed to one device,
        give that device.

    Returns:
      fitness(leaves, controller) -> scalar in JAX's default precision, NaN where the pair diverged. `leaves` is one
      row of `model_leaves` (or of `Models.leaves`; other fields are ignored), `controller` is (n_c,). A whole
      chunk is computed even for a single pair, so map over all pairs at once.

    Raises:
      InputError: the native engine, an unknown one, a number of steps below 1, or a robot with a point or a
        simulator of its own, which only `evaluate` follows.
      UnsupportedModel: the given engine does not support this robot.
    """
    Robot.expect(robot)
    if robot.point or robot.simulator is not None:
        what = f"the position of its point {robot.point!r}" if robot.point else "a simulator of its own"
        raise InputError(f"pair_fitness: the fitness of {robot.name} is of {what}, outside JAX; use evaluate()")
    own = fitness_of(robot, fitness)
    samples = _samples(robot, robot.duration if steps is None else steps * _timestep(robot))

    def kernel(leaves: ModelLeaves, controllers: jax.Array, *, roll: Callable[..., Record]) -> jax.Array:
        record, dtype = roll(leaves, controllers), jnp.result_type(float)

        def value(*numbers: jax.Array) -> jax.Array:
            peak, start, position, energy, *states = (_batch_first(x).astype(np.float64) for x in numbers)
            traced: Any = map(TracedArray, (start, position, energy, *states))
            outcome = Outcome(samples * _timestep(robot), *traced)
            finite = jnp.isfinite(position).all((-2, -1)) & jnp.isfinite(energy).all(-1)
            fine = finite & (peak <= robot.speed_limit)  # a comparison that NaN fails
            return jnp.where(fine, jnp.asarray(own(outcome)), jnp.nan).astype(dtype)

        states = (record.qpos, record.qvel, record.act) if own.needs_states else ()
        peak = lax.stop_gradient(record.peak_speed)
        return in_double(value)(peak, record.start, record.position, record.energy, *states)

    return _one_pair(robot, engine, samples, own.needs_states, chunk, devices, kernel)


def pair_trajectory(
    robot: Robot,
    engine: Engine | None = None,
    *,
    times: ArrayLike | None = None,
    chunk: int | None = None,
    devices: Sequence[jax.Device] | None = None,
) -> Callable[[ModelLeaves, Any], Trajectory]:
    """A function that computes the trajectory of one pair, to be mapped with `jax.vmap`.

    Args:
      robot: the robot.
      engine: as of `pair_fitness`.
      times: (K,) ascending sample times in (0, T_e] [s], rounded to steps; None for the end alone.
      chunk: as of `pair_fitness`.
      devices: as of `pair_fitness`.

    Returns:
      trajectory(leaves, controller) -> Trajectory; arguments as those of `pair_fitness`.

    Raises:
      InputError: the native engine, an unknown one, or bad times.
      UnsupportedModel: the given engine does not support this robot.
    """

    def kernel(leaves: ModelLeaves, controllers: jax.Array, *, roll: Callable[..., Record]) -> Trajectory:
        record = roll(leaves, controllers)
        return Trajectory(*map(_batch_first, (record.position, record.energy, record.qpos, record.qvel)))

    return _one_pair(robot, engine, _samples(robot, times), True, chunk, devices, kernel)


def _one_pair(
    robot: Robot,
    engine: Engine | None,
    samples: np.ndarray,
    states: bool,
    chunk: int | None,
    devices: Sequence[jax.Device] | None,
    kernel: Callable[..., Any],
) -> Callable[[ModelLeaves, Any], Any]:
    use_all_cores()
    use_compilation_cache()
    chosen = engine or _engine(robot)
    if chosen == "native":
        raise InputError("engine: got 'native', which runs outside JAX; expected 'lanes' or 'mjx', or use evaluate()")
    width = chunk or default_chunk(devices[0] if devices else jax.devices()[0])
    address = base_address(robot)
    nominal = compile_models(robot, robot.nominal_simulation).leaves
    needed = _influential(nominal)
    stepper_of(robot, chosen)  # raises UnsupportedModel before anything is traced

    def roll(leaves: ModelLeaves, controllers: jax.Array) -> Record:
        stepper = stepper_of(robot, chosen)
        # The barrier hides the number of steps from the compiler, which would otherwise unroll short loops and change
        # the last bits of results.
        marks = lax.optimization_barrier(jnp.asarray(samples, jnp.int32))
        # Fields that an engine needs but that do not influence motion have the nominal model's values.
        params = _packed(stepper, leaves, {name: x[0] for name, x in nominal.items() if name not in needed})
        wanted = controllers.T.astype(jnp.result_type(float))
        return rollout_chunk(stepper, robot.signal, address, states, params, wanted, marks, start_of(robot))

    one = rowwise(partial(kernel, roll=roll), width, devices)

    def function(leaves: ModelLeaves, controller: Any) -> Any:
        missing = [name for name in needed if name not in leaves]
        if missing:
            raise InputError(f"leaves: expected model_leaves(robot, simulation), got none of {', '.join(missing)}")
        return one({name: leaves[name] for name in needed}, controller)

    return function


def _engine(robot: Robot) -> Engine:
    """The fastest engine without guards: a compiled function cannot hand a pair to native MuJoCo."""
    try:
        stepper_of(robot, "lanes")
    except UnsupportedModel:
        return "mjx"
    return "lanes"


def _timestep(robot: Robot) -> float:
    return float(base_model(robot).opt.timestep)


def _samples(robot: Robot, times: ArrayLike | None) -> np.ndarray:
    return sample_steps(robot, times, _timestep(robot))


def _influential(names: Any) -> list[str]:
    """The fields that can influence motion, sorted; statistics and visual fields cannot."""
    from btr_mjx.engines import influences_motion

    return sorted(name for name in names if influences_motion(name))


def _packed(stepper: Stepper, leaves: ModelLeaves, others: dict[str, np.ndarray]) -> Any:
    """The engine's parameters of one chunk, derived in double precision as on the host.

    Traced fields are (C, *field shape), the others, equal for all pairs, (*field shape).
    """
    (chunk,) = {len(value) for value in leaves.values()}

    def derived(leaves: ModelLeaves) -> Any:
        wide: dict[str, Any] = {name: TracedArray(value.astype(np.float64)[None]) for name, value in leaves.items()}
        same = {name: np.broadcast_to(value, (1, chunk, *value.shape)) for name, value in others.items()}
        packed = stepper.pack(same | wide)
        return jax.tree.map(lambda x: jnp.asarray(x)[0], packed, is_leaf=lambda x: isinstance(x, TracedArray))

    return in_double(derived)(leaves)


def _batch_first(x: jax.Array) -> jax.Array:
    return jnp.moveaxis(x, -1, 0)
