"""Work of a step of `lanes` beside what a core can do: `taskset -c 0 uv run python benchmarks/roofline.py`.

For each model, per world and step: time, speed relative to native MuJoCo on one thread, arithmetic operations, bytes
that loops read and write (`work_count.py`), and the part of the peak rate of multiply-adds, which a small kernel
measures in the same process. Then, of the loops in which worlds wait for each other, how often they are run for the
slowest world of a chunk and in the mean of the worlds: of Newton's method, and of the search along a line where there
is one; before that, of conjugate gradients where bodies touch each other.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from coverage import FULL, small_commands, start_state
from coverage import Config as Commands
from engine_choice import NAMES, robot_of
from jax import lax
from mujoco import rollout
from work_count import counted, loops, work_of

from btr_mjx.engines import LanesStepper, Stepper, use_all_cores
from btr_mjx.evaluation.engine_choice import stepper_of
from btr_mjx.models import compile_models, start_of


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    models: tyro.conf.Positional[tuple[str, ...]] = NAMES
    """Robots of `engine_choice.py`, or MJCF files."""
    chunk: int = 64
    """Worlds that are stepped together."""
    steps: int = 300
    """Steps of one run."""
    rounds: int = 5
    """Number of runs; the fastest counts."""
    json: Path | None = None
    """Also write the numbers to this file."""


def fastest(run: Callable[[], Any], rounds: int) -> float:
    """Least time of several runs after a first one [s]."""
    found = []
    for _ in range(rounds + 1):
        begun = time.perf_counter()
        jax.block_until_ready(run())
        found.append(time.perf_counter() - begun)
    return min(found[1:])


def peak_rate(rounds: int) -> float:
    """Multiply-adds of a core in a program of XLA, each two operations [1/s]."""
    chains, length, width, times = 8, 16, 256, 20_000

    def work(_: jax.Array, x: jax.Array) -> jax.Array:
        ends = [x] * chains
        for _pass in range(length):
            ends = [y * (0.5 + 0.01 * k) + 0.25 for k, y in enumerate(ends)]
        return 0.1 * reduce(jnp.add, ends)

    run = jax.jit(lambda x: lax.fori_loop(0, times, work, x))
    return times * width * (2 * chains * length + chains) / fastest(partial(run, jnp.ones(width)), rounds)


def case_of(name: str, config: Config) -> tuple[mujoco.MjModel, Stepper, Any, np.ndarray, np.ndarray]:
    """A model, its stepper and parameters, the state in which its worlds begin (n,), and controls (C, T, nu).

    Robots have random controllers, MJCF files small random commands.
    """
    rng = np.random.default_rng(0)
    if name not in NAMES:
        model = mujoco.MjModel.from_xml_path(name)
        commands = Commands(worlds=config.chunk, seconds=config.steps * model.opt.timestep)
        return model, LanesStepper(model, guards=True), {}, start_state(model)[0], small_commands(model, commands, rng)
    robot = robot_of(name)
    models = compile_models(robot, robot.nominal_simulation[None])
    model, stepper, data = models.row(0), stepper_of(robot, "lanes", True), mujoco.MjData(models.row(0))
    if (at := start_of(robot)) is not None:
        data.qpos, data.qvel, data.act = at
    start = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, start, FULL)
    c = robot.controller_box.sample(rng, config.chunk).T
    controls = np.stack([robot.signal(c, k * model.opt.timestep, np) for k in range(config.steps)])
    leaves = {key: np.repeat(values, config.chunk, 0)[None] for key, values in models.leaves.items()}
    params = jax.tree.map(lambda x: x[0], stepper.pack(leaves))
    return model, stepper, params, start, np.ascontiguousarray(np.moveaxis(controls, 2, 0))


def measure(name: str, config: Config, peak: float) -> dict[str, float]:
    """The numbers of one model."""
    model, stepper, params, start, driven = case_of(name, config)
    worlds = np.repeat(start[None], config.chunk, 0)
    state = stepper.state(*(x.T for x in np.split(worlds, np.cumsum([1, model.nq, model.nv, model.na]), axis=1)[1:4]))
    controls = jnp.asarray(np.moveaxis(driven, 0, -1), jnp.float32)
    step = lambda u, s: stepper.step(params, s, u)  # noqa: E731
    repeated = lambda one, s: lax.fori_loop(0, len(controls), lambda k, s: one(controls[k], s), s)  # noqa: E731
    wide = {"xla_cpu_prefer_vector_width": "512"}
    program = jax.jit(partial(repeated, step), compiler_options=wide).lower(state).compile()
    seconds = fastest(partial(program, state), config.rounds) / len(controls)

    jaxpr = jax.make_jaxpr(step)(controls[0], state)

    def counting(u: jax.Array, carry: tuple) -> tuple:
        results, runs = counted(jaxpr.jaxpr, jaxpr.consts, [u, *carry[0]])
        return results, [x + y for x, y in zip(carry[1], runs, strict=True)]

    slow = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
    sums = [jnp.float32(0)] * (2 * loops(jaxpr.jaxpr))
    _, sums = jax.jit(partial(repeated, counting), compiler_options=slow)((jax.tree.leaves(state), sums))
    runs = np.array(sums).reshape(-1, 2) / len(controls)
    operations, moved = work_of(program.as_text() or "", [1.0, *runs[:, 0]])
    pool, threads = rollout.Rollout(nthread=1), [mujoco.MjData(model)]
    native = fastest(lambda: pool.rollout(model, threads, worlds, driven), config.rounds) / len(controls)
    waits = [(k, pair) for k, pair in enumerate(runs) if pair[1] != pair[0]]
    return {
        "us": 1e6 * seconds / config.chunk,
        "of native": native / seconds,
        "kop": operations / config.chunk / 1e3,
        "kB": moved / config.chunk / 1e3,
        "of peak": operations / seconds / peak,
        **{f"{word} {k}": x for k, pair in waits for word, x in zip(("runs", "mean"), pair, strict=True)},
    }


def main(config: Config) -> None:
    """Print a row for each model."""
    use_all_cores()
    peak, rows = peak_rate(config.rounds), {}
    print(f"peak {peak / 1e9:.0f} Gop/s")
    for name in config.models:
        rows[name] = measure(name, config, peak)
        print(f"{Path(name).stem:20}" + "  ".join(f"{key} {x:.3g}" for key, x in rows[name].items()), flush=True)
    if config.json is not None:
        config.json.write_text(json.dumps({"peak": peak, **rows}, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
