"""Speed of lanes and native MuJoCo on short windows: `uv run python benchmarks/window_lanes.py`.

The search for a missing effect simulates many short windows in float64, of models that differ in the fields that
effects change. In `lanes` these fields are arguments of the program, not constants. Both engines simulate the same
rows, from states in the middle of a gait, on one core each, one after the other in every round; times are per row and
step. In favour of lanes, all its chunks run in one call and only the last state is kept.
"""

import json
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
from mujoco.batch import Batch

from btr_mjx.engines import LanesStepper, base_field, use_all_cores
from btr_mjx.gap.simulate.batch import _unneeded_features
from btr_mjx.models import compile_models
from btr_mjx.robots import Robot, hexapod

CHANGED = (
    *("actuator_biasprm", "actuator_forcerange", "actuator_gainprm", "dof_armature", "dof_damping", "dof_frictionloss"),
    *("jnt_stiffness", "qpos_spring", "qpos0", "body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos"),
    *("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_solref", "body_invweight0", "dof_invweight0"),
    *("opt.gravity", "opt.density", "opt.viscosity"),
)
"""Fields that effects of the library change and that lanes can vary by row."""

SCALED = ("actuator_biasprm", "actuator_gainprm", "dof_armature", "dof_damping", "geom_friction", "body_mass")
"""Fields that are multiplied by a random factor in every row."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    rows: int = 1024
    """Number of windows."""
    steps: tuple[int, ...] = (1, 4, 16, 64)
    """Numbers of steps of a window."""
    warm_up: int = 600
    """Steps of the gait before the windows begin."""
    chunk: int = 64
    """Rows of a chunk of lanes."""
    rounds: int = 5
    """Number of rounds; both engines run once a round."""
    json: Path | None = None
    """Also write the numbers to this file."""


@dataclass(frozen=True)
class Rows:
    """Starting states of windows, and fields of their models.

    Attributes:
      qpos, qvel, act, ctrl: (rows, ...) states and controls.
      fields: values (rows, ...) by name of the field.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    fields: dict[str, np.ndarray]


def starting_rows(robot: Robot, model: mujoco.MjModel, config: Config) -> Rows:
    """Rows in the middle of random gaits."""
    rng = np.random.default_rng(0)
    controllers = robot.controller_box.sample(rng, config.rows)
    times = np.arange(config.warm_up) * model.opt.timestep
    control = np.moveaxis(np.stack([robot.signal(controllers.T, t, np) for t in times]), 2, 0)
    batch = Batch(model, nsim=config.rows)
    batch.rollout(config.warm_up, np.ascontiguousarray(control))
    fields = {}
    for name in CHANGED:
        base = base_field(model, name)
        fields[name] = np.tile(base, (config.rows, *(1,) * base.ndim))
        if name in SCALED:
            fields[name] *= rng.uniform(0.9, 1.1, (config.rows, *(1,) * base.ndim))
    qpos, qvel, act = (batch.bind(name).copy() for name in ("qpos", "qvel", "act"))
    return Rows(qpos, qvel, act, control[:, -1].copy(), fields)


def in_native(model: mujoco.MjModel, rows: Rows) -> Callable[[int], np.ndarray]:
    """A function of the number of steps that runs MuJoCo on one thread and returns states (rows, nq + nv)."""
    model.opt.disableflags |= _unneeded_features(model)
    batch = Batch(model, nsim=len(rows.qpos), nthread=1)
    for name, values in rows.fields.items():
        batch.expand(name)[...] = values
    state = {name: batch.bind(name) for name in ("qpos", "qvel", "act", "ctrl")}

    def run(steps: int) -> np.ndarray:
        for name, values in state.items():
            values[...] = getattr(rows, name)
        batch.bind("qacc_warmstart")[...] = 0.0
        batch.rollout(steps)
        return np.concatenate([state["qpos"], state["qvel"]], 1)

    return run


def in_lanes(model: mujoco.MjModel, rows: Rows, chunk: int) -> tuple[Callable[[int], np.ndarray], dict[str, float]]:
    """The same function in lanes on one device; and the times of laying out the models and compiling."""
    stepper = LanesStepper(model, CHANGED, dtype=np.float64)
    started = time.perf_counter()
    chunks = lambda x: x.reshape(len(x) // chunk, chunk, *x.shape[1:])  # noqa: E731
    packed = stepper.pack({name: chunks(values) for name, values in rows.fields.items()})
    laid_out = time.perf_counter()
    states = [np.swapaxes(chunks(x), 1, 2) for x in (rows.qpos, rows.qvel, rows.act, rows.ctrl)]

    def window(params: dict, state: tuple[jax.Array, ...], ctrl: jax.Array, steps: jax.Array) -> jax.Array:
        begin = stepper.state(*state)
        end = lax.fori_loop(0, steps, lambda _, state: stepper.step(params, state, ctrl), begin)
        return jnp.concatenate([stepper.qpos(end), stepper.qvel(end)])

    def every(params: dict, states: list[jax.Array], steps: jax.Array) -> jax.Array:
        return lax.map(lambda one: window(one[0], one[1][:3], one[1][3], steps), (params, states))

    arguments = jax.device_put((packed, states))
    compiled = jax.jit(every, compiler_options={"xla_cpu_prefer_vector_width": "512"}).lower(*arguments, 1).compile()
    done = time.perf_counter()

    def run(steps: int) -> np.ndarray:
        found = jax.block_until_ready(compiled(*arguments, jnp.int64(steps)))
        return np.swapaxes(np.asarray(found), 1, 2).reshape(len(rows.qpos), -1)

    return run, {"pack_us_per_row": 1e6 * (laid_out - started) / len(rows.qpos), "compile_s": done - laid_out}


def measure(config: Config) -> dict:
    """All numbers; JAX has to be in float64.

    Raises:
      ValueError: rows that are no multiple of the chunk.
    """
    if config.rows % config.chunk:
        raise ValueError(f"rows: got {config.rows}, expected a multiple of the chunk, {config.chunk}")
    robot = hexapod()
    model = compile_models(robot, robot.nominal_simulation[None]).base
    rows = starting_rows(robot, model, config)
    lanes, once = in_lanes(model, rows, config.chunk)
    native = in_native(model, rows)
    table = []
    for steps in config.steps:
        costs: dict[str, list[float]] = {"native": [], "lanes": []}
        ends = {}
        for _ in range(config.rounds + 1):
            for name, run in (("native", native), ("lanes", lanes)):
                begin = time.perf_counter()
                ends[name] = run(steps)
                costs[name].append(1e6 * (time.perf_counter() - begin) / (config.rows * steps))
        warm = {name: np.array(values[1:]) for name, values in costs.items()}
        table.append(
            {
                "steps": steps,
                **{f"{name}_us": float(np.median(values)) for name, values in warm.items()},
                "ratio": float(np.median(warm["native"] / warm["lanes"])),
                "apart": float(np.abs(ends["native"] - ends["lanes"]).max()),
            }
        )
    return {"rows": config.rows, **once, "windows": table}


def main(config: Config) -> None:
    """Measure, print, write."""
    use_all_cores()
    with jax.enable_x64(True):
        numbers = measure(config)
    print(f"compiling {numbers['compile_s']:.1f} s, laying models out {numbers['pack_us_per_row']:.0f} us a row")
    for row in numbers["windows"]:
        print(
            f"{row['steps']:4d} steps: native {row['native_us']:6.2f} us, lanes {row['lanes_us']:6.2f} us a row and "
            f"step, ratio {row['ratio']:.2f}, apart by {row['apart']:.1e}"
        )
    if config.json:
        config.json.write_text(json.dumps(numbers, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Config))
