"""What `lanes` covers of public models: `uv run python benchmarks/coverage.py`.

Installs the wheels of gymnasium, dm_control and robosuite in a temporary folder, loads every MJCF file that loads and
has degrees of freedom, and prints a table: computed, guarded or refused, with the reasons; for what is not refused, the
part of worlds that guards hand to native MuJoCo within a second of small random commands around the start, and the
speed relative to `mujoco.rollout` on as many threads. Every model takes 1 s to some minutes to compile; `--no-run`
leaves the rollouts out. `--oracle` compares single steps in double precision from random states with native MuJoCo,
whose solver runs to convergence, in worlds that no guard marks.

`--folder COPY --files "scene*.xml"` tries the robots of a copy of the MuJoCo Menagerie on their floors, with `--match`
those of a list. Meshes that only show the robot may be absent from the copy.
"""

import copy
import json
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import jax
import mujoco
import mujoco.rollout
import numpy as np
import tyro

from btr_mjx import lanes
from btr_mjx.engines import LanesStepper
from btr_mjx.runs import available_cores

WHEELS = ("gymnasium", "dm_control", "robosuite")
STATES = 32
"""Random states of `--oracle`."""
NUMBERS = ("handed over", "ratio", "first call [s]", "error", "marked")
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    folder: Path | None = None
    """Folder with the installed wheels; by default they are installed in a temporary one."""
    files: str = "*.xml"
    """Pattern of the names of the MJCF files that are tried."""
    run: bool = True
    """Whether models that are not refused are rolled out."""
    oracle: bool = False
    """Whether accelerations of single steps are compared with native MuJoCo."""
    match: tuple[str, ...] = ()
    """Roll out (and compare) only models whose path contains one of these texts."""
    seconds: float = 1.0
    """Length of the rollouts [s]."""
    worlds: int = 2048
    """Worlds of a rollout."""
    command: float = 0.1
    """Size of the commands, as a part of the control range (of 1 where there is none)."""
    json: Path | None = None
    """Also write the table to this file."""


def install(folder: Path) -> None:
    """Install the wheels without what they depend on."""
    subprocess.run(["uv", "pip", "install", "--quiet", "--no-deps", "--target", str(folder), *WHEELS], check=True)


def load(path: Path) -> mujoco.MjModel:
    """The model of an MJCF file, without meshes whose file is missing and the geoms that only show them."""
    spec = mujoco.MjSpec.from_file(str(path))
    absent = {
        mesh.name or Path(mesh.file).stem: mesh
        for mesh in spec.meshes
        if mesh.file and not (path.parent / spec.meshdir / mesh.file).is_file()
    }
    for geom in spec.geoms:
        if geom.meshname in absent and not (geom.contype or geom.conaffinity):
            spec.delete(geom)
    for mesh in absent.values():
        spec.delete(mesh)
    return spec.compile()


def models(folder: Path, files: str) -> dict[str, mujoco.MjModel]:
    """Every MJCF below a folder that loads and can move, by its path in the folder."""
    found = {}
    for path in sorted(folder.rglob(files)):
        try:
            model = load(path)
        except ValueError:
            continue
        if model.nv:
            found[str(path.relative_to(folder))] = model
    return found


def small_commands(model: mujoco.MjModel, config: Config, rng: np.random.Generator) -> np.ndarray:
    """Random controls (B, T, nu), held for 20 steps, around those that are nearest to zero."""
    steps = max(1, round(config.seconds / model.opt.timestep))
    low, high = np.where(model.actuator_ctrllimited[:, None], model.actuator_ctrlrange, [-1.0, 1.0]).T
    held = rng.uniform(-1, 1, (config.worlds, -(-steps // 20), model.nu))
    control = np.clip(0, low, high) + config.command * (high - low) / 2 * np.repeat(held, 20, 1)[:, :steps]
    return np.clip(control, low, high)


def start_state(model: mujoco.MjModel) -> np.ndarray:
    """The first keyframe, or the model's qpos0 at rest, (1, n)."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    state = np.zeros((1, mujoco.mj_stateSize(model, FULL)))
    mujoco.mj_getState(model, data, state[0], FULL)
    return state


def measure(model: mujoco.MjModel, config: Config) -> dict[str, float]:
    """Part of the worlds that guards hand over, and the ratio of speeds, each the better of two runs."""
    controls, start = small_commands(model, config, np.random.default_rng(0)), start_state(model)
    threads = [mujoco.MjData(model) for _ in range(available_cores())]
    begun = time.perf_counter()
    share = lanes.rollout(model, start, controls).native_share
    first = time.perf_counter() - begun
    times: dict[str, list[float]] = {"lanes": [], "native": []}
    for _ in range(2):
        for name, call in (
            ("lanes", lambda: lanes.rollout(model, start, controls)),
            ("native", lambda: mujoco.rollout.rollout(model, threads, np.repeat(start, len(controls), 0), controls)),
        ):
            begun = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - begun)
    return {"handed over": share, "ratio": min(times["native"]) / min(times["lanes"]), "first call [s]": first}


def compare(model: mujoco.MjModel) -> dict[str, float]:
    """Largest relative error of the acceleration in a step from random states, and the part that guards mark."""
    rng, states = np.random.default_rng(0), []
    for _ in range(STATES):
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, start_state(model)[0], FULL)
        mujoco.mj_integratePos(model, data.qpos, 0.2 * rng.normal(size=model.nv), 1.0)
        data.qvel[:], data.ctrl[:] = rng.normal(size=model.nv), rng.uniform(-0.5, 0.5, model.nu)
        states.append(data)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=True)
        before = stepper.state(*(np.stack([getattr(d, name) for d in states], 1) for name in ("qpos", "qvel", "act")))
        step = jax.jit(stepper.step, compiler_options={"xla_backend_optimization_level": 0})
        after = step({}, before, np.stack([d.ctrl for d in states], 1))
        found, marked = np.asarray(stepper.qacc(after)), np.asarray(stepper.tripped(after))
    exact = copy.copy(model)
    exact.opt.iterations, exact.opt.ls_iterations, exact.opt.tolerance = 100, 100, 0
    errors = [0.0]
    for i in np.flatnonzero(~marked):
        mujoco.mj_step(exact, states[i])
        true = states[i].qacc
        errors.append(float(np.linalg.norm(found[:, i] - true) / max(np.linalg.norm(true), 1e-3)))
    return {"error": max(errors), "marked": float(marked.mean())}


def main(config: Config) -> None:
    """Print the table and its sums."""
    if config.folder is None:
        with tempfile.TemporaryDirectory() as folder:
            install(Path(folder))
            table = tabulate(Path(folder), config)
    else:
        table = tabulate(config.folder, config)
    print(Counter(row["verdict"] for row in table))
    for reason, count in Counter(reason for row in table for reason in row["reasons"]).most_common():
        print(f"{count:4d}  {reason}")
    if config.json:
        config.json.write_text(json.dumps(table, indent=1))


def tabulate(folder: Path, config: Config) -> list[dict]:
    """One row for each model."""
    table = []
    for path, model in models(folder, config.files).items():
        covered = lanes.coverage(model)
        # A reason without the elements that it names.
        reasons = sorted({text.split(" (")[0] for text in covered.refused or covered.guarded})
        row: dict = {"model": path, "verdict": covered.verdict, "guards": len(covered.guarded), "reasons": reasons}
        if config.run and not covered.refused and (not config.match or any(text in path for text in config.match)):
            row |= measure(model, config)
        if config.oracle and not covered.refused and (not config.match or any(text in path for text in config.match)):
            row |= compare(model)
        table.append(row)
        numbers = "  ".join(f"{key} {row[key]:.3g}" for key in NUMBERS if key in row)
        print(f"{path:70s} {covered.verdict:9s} {len(covered.guarded):4d}  {numbers}  {'; '.join(reasons)}", flush=True)
    return table


if __name__ == "__main__":
    main(tyro.cli(Config))
