"""Speed of `lanes` and of MuJoCo Warp on a GPU, beside native MuJoCo on all cores of the same machine.

    uv run --with mujoco-warp python benchmarks/accelerator.py --models humanoid.xml unitree_go1/scene.xml

The trial hexapod comes first, then the models (MJCF, or MJB) in the order given. The worlds start near the first
keyframe, or near qpos0, each with constant random commands; some steps pass before the clock runs, so that feet are on
the ground. All engines get the same model, states, commands and numbers of steps. Programs are compiled side by side,
each in a process of its own, and timed one after the other. After a few steps positions are compared with those of
native MuJoCo with a tolerance of 1e-12, so that a fast wrong answer does not count.
"""

import copy
import fcntl
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
import tyro

from btr_mjx.robots import hexapod
from btr_mjx.runs import available_cores

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
COMPARED = 64
"""Worlds whose positions are compared with native MuJoCo's."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    models: tuple[Path, ...] = ()
    """MJCF or MJB files, beside the hexapod."""
    engines: tuple[str, ...] = ("native", "lanes", "mujoco_warp")
    """Engines."""
    worlds: tuple[int, ...] = (1024, 8192, 65536)
    """Worlds that are stepped together; native MuJoCo gets the smallest number only."""
    before: int = 100
    """Steps before the clock runs."""
    steps: int = 200
    """Timed steps."""
    compared: int = 10
    """Steps after which positions are compared."""
    command: float = 0.2
    """Size of the commands, as a part of the control range (of 1 where there is none)."""
    timeout: float = 300.0
    """Time limit of a measurement, compiling and waiting included [s]."""
    jobs: int = 16
    """Measurements that are prepared side by side."""
    json: Path | None = None
    """Also write the rows to this file."""
    alone: Path | None = None
    """Measure the first of everything in this process, while this file is locked, and print one line of JSON."""


@dataclass(frozen=True)
class Task:
    """One measurement: a model, where its worlds start, (B, nq) and (B, nv), and their commands (B, nu)."""

    model: mujoco.MjModel
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray


def load(path: Path | None) -> mujoco.MjModel:
    """A model from MJCF or MJB; without a path the hexapod, less what Warp refuses: integrals of motors, a flag."""
    if path is None:
        robot = hexapod()
        text = robot.render(robot.nominal).replace("<pid ", "<position ")
        return mujoco.MjModel.from_xml_string(re.sub(r' ki="[^"]*"| input="pos"| autoreset="disable"', "", text))
    return getattr(mujoco.MjModel, "from_binary_path" if path.suffix == ".mjb" else "from_xml_path")(str(path))


def task_of(model: mujoco.MjModel, worlds: int, command: float) -> Task:
    """Worlds near the first keyframe; the same for every engine."""
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    qpos = np.tile(data.qpos, (worlds, 1))
    for row, turn in zip(qpos, rng.uniform(-0.02, 0.02, (worlds, model.nv)), strict=True):
        mujoco.mj_integratePos(model, row, turn, 1.0)
    limited = model.actuator_ctrllimited.astype(bool)
    half = np.where(limited, np.ptp(model.actuator_ctrlrange, axis=1) / 2, 1.0)
    centre = data.ctrl if model.nkey else np.where(limited, model.actuator_ctrlrange.mean(1), 0.0)
    ctrl = centre + command * half * rng.uniform(-1, 1, (worlds, model.nu))
    return Task(model, qpos, rng.uniform(-0.1, 0.1, (worlds, model.nv)), ctrl)


def native(task: Task, steps: int) -> np.ndarray:
    """States (B, T, n) by `mujoco.rollout` on all cores."""
    data = mujoco.MjData(task.model)
    start = np.zeros((len(task.qpos), mujoco.mj_stateSize(task.model, FULL)))
    for row, qpos, qvel in zip(start, task.qpos, task.qvel, strict=True):
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_getState(task.model, data, row, FULL)
    threads = [mujoco.MjData(task.model) for _ in range(available_cores())]
    control = np.repeat(task.ctrl[:, None], steps, axis=1)
    return mujoco.rollout.rollout(task.model, threads, start, control)[0]


def reference(task: Task, steps: int) -> np.ndarray:
    """Positions (COMPARED, nq) after some steps, with a solver that goes on to the end."""
    model = copy.copy(task.model)
    model.opt.tolerance, model.opt.iterations, model.opt.ls_iterations = 1e-12, 500, 100
    few = Task(model, task.qpos[:COMPARED], task.qvel[:COMPARED], task.ctrl[:COMPARED])
    return native(few, steps)[:, -1, 1 : 1 + task.model.nq]


Advance = Callable[[int], None]
Read = Callable[[], np.ndarray]


def lanes_run(task: Task) -> tuple[Advance, Read, Callable[[], dict[str, Any]]]:
    """A function that makes steps on the device, one that reads positions, and what else there is to say."""
    import jax
    from jax import lax

    from btr_mjx.engines import LanesStepper

    stepper = LanesStepper(task.model, guards=True)
    params: Any = stepper.pack({})

    @jax.jit
    def run(state: Any, ctrl: jax.Array, steps: jax.Array) -> Any:
        return lax.fori_loop(0, steps, lambda _, s: stepper.step(params, s, ctrl), state)

    ctrl = jax.device_put(task.ctrl.T.astype(np.float32))
    rows = (x.T.astype(np.float32) for x in (task.qpos, task.qvel, np.zeros((len(task.qpos), task.model.na))))
    states = [jax.jit(stepper.state)(*rows)]
    compiled = run.lower(states[0], ctrl, np.int32(1)).compile()

    def advance(steps: int) -> None:
        states[0] = jax.block_until_ready(compiled(states[0], ctrl, np.int32(steps)))

    def notes() -> dict[str, Any]:
        marked = float(np.mean(np.asarray(stepper.tripped(states[0]))))
        return {"device": jax.devices()[0].device_kind, "handed over": round(marked, 4)}

    return advance, lambda: np.asarray(stepper.qpos(states[0])).T, notes


def warp_run(task: Task) -> tuple[Advance, Read, Callable[[], dict[str, Any]]]:
    """The same by MuJoCo Warp: one CUDA graph of a step, launched again and again."""
    import mujoco_warp as mjw
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    contacts, rows = room(task)
    m = mjw.put_model(task.model)
    d = mjw.make_data(task.model, nworld=len(task.qpos), nconmax=contacts, njmax=rows)

    def start() -> None:
        for array, values in ((d.qpos, task.qpos), (d.qvel, task.qvel), (d.ctrl, task.ctrl)):
            array.assign(values.astype(np.float32))

    mjw.step(m, d)  # compiles
    graph = None
    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as capture:
            mjw.step(m, d)
        graph = capture.graph
    mjw.reset_data(m, d)
    start()

    def advance(steps: int) -> None:
        for _ in range(steps):
            if graph is None:
                mjw.step(m, d)
            else:
                wp.capture_launch(graph)
        wp.synchronize()

    def notes() -> dict[str, Any]:
        return {
            "device": wp.get_device().name,
            "overflows": int(np.count_nonzero(d.overflow.numpy())),
            "iterations": round(float(d.solver_niter.numpy().mean()), 2),
            "contacts": contacts,
            "rows": rows,
        }

    return advance, lambda: d.qpos.numpy(), notes


def room(task: Task) -> tuple[int, int]:
    """Contacts and constraint rows a world needs, with half as much again, from native rollouts of some worlds."""
    contacts, rows = 1, 1
    for qpos, qvel, ctrl in zip(task.qpos[:COMPARED], task.qvel, task.ctrl, strict=False):
        data = mujoco.MjData(task.model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        for _ in range(300):
            mujoco.mj_step(task.model, data)
            contacts, rows = max(contacts, data.ncon), max(rows, data.nefc)
    return contacts * 3 // 2 + 8, rows * 3 // 2 + 16


@contextmanager
def locked(path: Path) -> Any:
    """Nobody else measures meanwhile."""
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def measure(config: Config) -> dict[str, Any]:
    """One row of the table."""
    engine, worlds, lock = config.engines[0], config.worlds[0], config.alone
    assert lock is not None
    path = config.models[0] if config.models else None
    task = task_of(load(path), worlds, config.command)
    start = time.perf_counter()
    row: dict[str, Any] = {"model": path.stem if path else "hexapod", "engine": engine}
    if engine == "native":
        with locked(lock):
            native(task, config.before)
            start = time.perf_counter()
            native(task, config.before + config.steps)
            seconds = (time.perf_counter() - start) * config.steps / (config.before + config.steps)
        extra: dict[str, Any] = {"device": f"{available_cores()} cores"}
    else:
        advance, read, notes = {"lanes": lanes_run, "mujoco_warp": warp_run}[engine](task)
        prepared = time.perf_counter() - start
        with locked(lock):
            advance(config.compared)
            error = np.abs(read()[:COMPARED] - reference(task, config.compared)).max(1)
            advance(config.before - config.compared)
            seconds = np.inf
            for _ in range(2):
                start = time.perf_counter()
                advance(config.steps // 2)
                seconds = min(seconds, 2 * (time.perf_counter() - start))
            invalid = float(np.mean(~np.isfinite(read()).all(1)))
            extra = {"compile [s]": round(prepared, 1), "error": float(f"{np.median(error):.1e}"), **notes()}
            extra["invalid"] = round(invalid, 4)
    return row | {"worlds": worlds, "steps/s": round(worlds * config.steps / seconds), **extra}


def main(config: Config) -> None:
    """Measure everything and print the table."""
    if config.alone:
        print(json.dumps(measure(config)), flush=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        jobs = []
        for model in (None, *config.models):
            for engine in config.engines:
                for worlds in sorted(config.worlds)[: 1 if engine == "native" else None]:
                    command = [sys.executable, __file__, "--engines", engine, "--worlds", str(worlds)]
                    command += ["--models", str(model)] if model else []
                    command += [
                        text
                        for name in ("before", "steps", "compared", "command")
                        for text in (f"--{name}", str(getattr(config, name)))
                    ]
                    jobs.append([*command, "--alone", f"{folder}/lock"])
        rows = []
        with ThreadPoolExecutor(config.jobs) as pool:
            for row in pool.map(lambda job: _answer(job, config.timeout), jobs):
                print(json.dumps(row), flush=True)
                rows.append(row)
    if config.json:
        config.json.write_text(json.dumps(rows, indent=1) + "\n")


def _answer(job: list[str], timeout: float) -> dict[str, Any]:
    """The row that another process prints, or why there is none."""
    try:
        done = subprocess.run(job, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return {"job": job[2:-2], "failed": f"no answer within {timeout:g} s"}
    if done.returncode:
        return {"job": job[2:-2], "failed": done.stderr.strip()[-600:]}
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
