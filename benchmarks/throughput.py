"""Steps per second of every way to run the hexapod: `uv run python benchmarks/throughput.py`.

All contestants simulate the same pairs (per-pair morphologies, random controllers) with converged solvers, one after
the other in each of several rounds, so that other load on the machine affects all of them. Ratios are medians of the
ratios of the rounds. Compile times are measured separately. MJX is slow on a CPU and runs the first steps only; its
cost per step does not depend on contact.
"""

import json
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from jax import lax
from mujoco import rollout
from mujoco.batch import Batch

from btr_mjx.engines import MjxStepper, Program, native, use_all_cores
from btr_mjx.evaluation.engine_choice import program_of, stepper_of
from btr_mjx.models import Models, base_address, compile_models
from btr_mjx.robots import Robot, hexapod
from btr_mjx.runs import available_cores


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    pairs: int = 512
    """Number of pairs (s, c) for lanes."""
    morphologies: int = 64
    """Number of different simulations among them."""
    native_pairs: int = 64
    """Number of pairs for native MuJoCo."""
    mjx_pairs: int = 128
    """Number of pairs for MJX."""
    steps: int = 3400
    """Steps per pair."""
    mjx_steps: int = 150
    """Steps per pair for MJX."""
    rounds: int = 3
    """Number of rounds; every contestant runs once a round."""
    mjx: bool = True
    """Run MJX."""
    json: Path | None = None
    """Also write the numbers to this file."""


@dataclass(frozen=True)
class Contestant:
    """A way to simulate the pairs.

    Attributes:
      name: label in the table.
      steps: environment steps of one run.
      compile_s: time to trace and compile [s].
      run: runs once and returns when all results are there.
    """

    name: str
    steps: int
    compile_s: float
    run: Callable[[], object]


def timed_compile(program: Program, arguments: tuple) -> tuple[Callable, float]:
    """Trace and compile a program; returns it with the time that took [s]."""
    start = time.perf_counter()
    compiled = program.function.lower(*arguments).compile()
    return compiled, time.perf_counter() - start


def gathered(models: Models, index: np.ndarray) -> dict[str, np.ndarray]:
    """Leaves of each pair's model."""
    return {name: values[index] for name, values in models.leaves.items()}


def contestants(config: Config, robot: Robot) -> list[Contestant]:
    """All contestants, compiled."""
    rng = np.random.default_rng(0)
    simulations = robot.simulation_box.clip(robot.nominal_simulation * rng.uniform(0.8, 1.2, (config.morphologies, 12)))
    controllers = robot.controller_box.sample(rng, config.pairs)
    index = np.arange(config.pairs) % config.morphologies
    models = compile_models(robot, simulations)
    cores, result = available_cores(), []

    n = config.native_pairs
    rows = [models.row(i) for i in index[:n]]
    data = [mujoco.MjData(rows[0]) for _ in range(cores)]
    times = np.arange(config.steps) * rows[0].opt.timestep
    control = np.stack([robot.signal(controllers[:n].T, t, np) for t in times])  # (steps, nu, n)
    control = np.ascontiguousarray(np.moveaxis(control, 2, 0))
    size = mujoco.mj_stateSize(rows[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.zeros((n, size))
    for i, row in enumerate(rows):
        mujoco.mj_getState(row, mujoco.MjData(row), initial[i], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    pool = rollout.Rollout(nthread=cores)
    result.append(
        Contestant("mujoco.rollout", n * config.steps, 0.0, lambda: pool.rollout(rows, data, initial, control))
    )

    def batch() -> None:
        worlds = Batch(rows[0], nsim=n, nthread=cores)
        worlds.set_models(rows)
        worlds.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        for first in range(0, config.steps, 100):
            worlds.rollout(min(100, config.steps - first), control[:, first : first + 100], record=("qpos",))

    result.append(Contestant("mujoco.batch", n * config.steps, 0.0, batch))
    samples = np.array([config.steps])
    leaves = gathered(models, index[:n])
    result.append(
        Contestant(
            "engine native",
            n * config.steps,
            0.0,
            lambda: native.rollout_native(
                models.base,
                leaves,
                controllers[:n],
                samples,
                signal=robot.signal,
                base_address=base_address(robot),
                record_states=False,
            ),
        )
    )
    if config.mjx:
        result += mjx_contestants(config, robot, models, index, controllers)
    program = program_of(robot, "lanes", 1, False, None)
    arguments = program.arguments(gathered(models, index), controllers, samples)
    compiled, seconds = timed_compile(program, arguments)
    result.append(
        Contestant(
            "engine lanes",
            config.pairs * config.steps,
            seconds,
            lambda: jax.block_until_ready(compiled(*arguments)),
        )
    )
    return result


def mjx_contestants(
    config: Config, robot: Robot, models: Models, index: np.ndarray, controllers: np.ndarray
) -> list[Contestant]:
    """Plain `jax.vmap(mjx.step)` on one device, and the `mjx` engine on all devices."""
    n, steps = config.mjx_pairs, config.mjx_steps
    stepper = stepper_of(robot, "mjx")
    assert isinstance(stepper, MjxStepper)
    leaves = gathered(models, index[:n])
    packed = jax.tree.map(lambda x: x[0], stepper.pack({name: values[None] for name, values in leaves.items()}))
    c = jnp.asarray(controllers[:n].T, jnp.float32)

    @jax.jit
    def plain(params: dict, controllers: jax.Array) -> jax.Array:
        def step(state: dict, k: jax.Array) -> tuple[dict, None]:
            control = robot.signal(controllers, k * jnp.float32(stepper.timestep), jnp)
            return jax.vmap(stepper.step_one)(params, state, control.T), None

        return lax.scan(step, stepper.initial(params, n), jnp.arange(steps, dtype=jnp.float32))[0]["qpos"]

    start = time.perf_counter()
    compiled_plain = plain.lower(packed, c).compile()
    plain_seconds = time.perf_counter() - start
    program = program_of(robot, "mjx", 1, False, None)
    arguments = program.arguments(leaves, controllers[:n], np.array([steps]))
    compiled, seconds = timed_compile(program, arguments)
    return [
        Contestant(
            "vmap(mjx.step), one device",
            n * steps,
            plain_seconds,
            lambda: jax.block_until_ready(compiled_plain(packed, c)),
        ),
        Contestant("engine mjx", n * steps, seconds, lambda: jax.block_until_ready(compiled(*arguments))),
    ]


def main(config: Config) -> None:
    """Run all rounds and print the table."""
    use_all_cores()
    robot = hexapod()
    entered = contestants(config, robot)
    rates: dict[str, list[float]] = {c.name: [] for c in entered}
    for c in entered:
        c.run()  # warm up
    for _ in range(config.rounds):
        for c in entered:
            start = time.perf_counter()
            c.run()
            rates[c.name].append(c.steps / (time.perf_counter() - start))
    native_best = np.maximum(rates["mujoco.rollout"], rates["mujoco.batch"])
    ratio = lambda name, base: float(np.median(np.array(rates[name]) / base))  # noqa: E731
    lanes = np.array(rates["engine lanes"])
    print(f"{available_cores()} cores, {jax.device_count()} JAX devices, {config.steps} steps, {config.rounds} rounds")
    print(f"{'':30}{'steps/s':>12}{'of native':>11}{'lanes is x':>12}{'compile s':>11}")
    for c in entered:
        values = np.array(rates[c.name])
        print(
            f"{c.name:30}{np.median(values):12,.0f}{ratio(c.name, native_best):11.2f}"
            f"{float(np.median(lanes / values)):12.2f}{c.compile_s:11.1f}"
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory of the process {peak:.2f} GiB")
    numbers = {
        "lanes_steps_per_s": float(np.median(lanes)),
        "native_steps_per_s": float(np.median(native_best)),
        "mjx_steps_per_s": float(np.median(rates["engine mjx"])) if config.mjx else None,
        "lanes_vs_native": ratio("engine lanes", native_best),
        "lanes_vs_mjx": ratio("engine lanes", np.array(rates["engine mjx"])) if config.mjx else None,
        "mjx_vs_plain_vmap": (
            ratio("engine mjx", np.array(rates["vmap(mjx.step), one device"])) if config.mjx else None
        ),
        "compile_s": next(c.compile_s for c in entered if c.name == "engine lanes"),
        "peak_memory_gib": peak,
        "rates": rates,
    }
    if config.json is not None:
        config.json.write_text(json.dumps(numbers, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
