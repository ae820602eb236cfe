"""Planted errors of convention: how many are found, and how often clean data are accused.

    uv run python benchmarks/conventions.py --cases 40                 # planted errors, each with clean data beside it
    uv run python benchmarks/conventions.py --clean 500                # clean data only
    uv run python benchmarks/conventions.py --real FOLDER FOLDER       # recordings that are known to be in order

Robots: a servo arm, a legged robot on a floor, a free body with propellers, a cart with a pole; sampling rates of 50 to
1000 Hz, noise from a quarter to four times the usual; in half of the cases a physical effect is missing as well
(friction, gain, payload, lag), which must not be accused.
"""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import tyro
from hidden_cases import case_robot

from btr_mjx.errors import InputError
from btr_mjx.gap.data import DatasetDescription, Recording, open_dataset, save_dataset
from btr_mjx.gap.preflight import Finding, preflight
from btr_mjx.models import integrate

DRONE_XML = """<mujoco model="drone"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="body" pos="0 0 2"><freejoint name="root"/>
<geom type="box" size="0.12 0.1 0.03" mass="0.8" contype="0" conaffinity="0"/>
<geom type="box" size="0.02 0.02 0.02" pos="0 0 -0.03" mass="0.2" contype="0" conaffinity="0"/>
<site name="s1" pos="0.15 0.15 0"/><site name="s2" pos="-0.15 0.15 0"/>
<site name="s3" pos="-0.15 -0.15 0"/><site name="s4" pos="0.15 -0.15 0"/></body></worldbody>
<actuator>
<motor name="m1" site="s1" gear="0 0 1 0 0 0.02"/><motor name="m2" site="s2" gear="0 0 1 0 0 -0.02"/>
<motor name="m3" site="s3" gear="0 0 1 0 0 0.02"/><motor name="m4" site="s4" gear="0 0 1 0 0 -0.02"/>
</actuator></mujoco>"""

CART_XML = """<mujoco model="cart"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="cart"><joint name="slider" type="slide" axis="1 0 0" damping="2"/>
<geom type="box" size="0.08 0.05 0.04" mass="0.6" contype="0" conaffinity="0"/>
<body name="pole"><joint name="pole" axis="0 1 0" damping="0.002"/>
<geom type="capsule" fromto="0 0 0 0.05 0 -0.4" size="0.01" mass="0.15" contype="0" conaffinity="0"/>
<body name="tip" pos="0.05 0 -0.4"><joint name="tip" axis="0 1 0" damping="0.01" armature="0.002"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.1" contype="0" conaffinity="0"/></body></body></body>
</worldbody><actuator><motor name="push" joint="slider"/><motor name="twist" joint="tip"/></actuator></mujoco>"""

XML = {"arm": case_robot("arm").xml, "legged": case_robot("quadruped").xml, "drone": DRONE_XML, "cart": CART_XML}
DURATION = {"arm": 4.0, "legged": 3.0, "drone": 3.0, "cart": 5.0}
RATES = (50, 100, 200, 250, 500, 1000)
NOISE = {"hinge": 3e-4, "slide": 2e-4, "position": 1e-3, "rotation": 1e-3}
"""1 sigma of positions [rad, m]; velocities have 20 times as much a second."""


@dataclass
class Log:
    """One recording before it is written."""

    time: np.ndarray
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray


def waves(rng: np.random.Generator, amplitude: np.ndarray, low: float, high: float) -> Callable[[float], np.ndarray]:
    """Sums of three sinusoids, zero at the start."""
    n = len(amplitude)
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), (3, n)))
    phase = rng.uniform(0, 2 * np.pi, (3, n))
    share = rng.dirichlet(np.ones(3), n).T * amplitude * rng.uniform(0.6, 1.0, n)

    def command(t: float) -> np.ndarray:
        return np.sum(share * (np.sin(frequency * t + phase) - np.sin(phase) * np.exp(-6 * t)), axis=0)

    return command


def motion(robot: str, rng: np.random.Generator) -> Callable[[float], np.ndarray]:
    """A random command of a robot."""
    match robot:
        case "arm":
            wave = waves(rng, np.array([0.8, 0.6, 0.7, 0.8, 1.0]), 2, 10)
            return lambda t: np.array([0.0, -0.3, 0.6, 0.2, 0.0]) * (1 - np.exp(-6 * t)) + wave(t)
        case "legged":
            return waves(rng, np.tile([0.1, 0.3, 0.3], 4), 8, 18)
        case "drone":
            wave = waves(rng, np.full(4, 0.1), 4, 15)
            return lambda t: 2.45 + wave(t)
        case _:
            return waves(rng, np.array([4.0, 0.05]), 3, 10)


def reality(robot: str, rng: np.random.Generator, imperfect: bool) -> mujoco.MjModel:
    """The believed model with calibration errors of some per cent, and perhaps with an effect that it lacks."""
    model = mujoco.MjModel.from_xml_string(XML[robot])
    model.opt.timestep = 5e-4
    model.body_mass[:] *= 1 + 0.02 * rng.normal(size=model.nbody)
    model.dof_damping[:] *= 1 + 0.1 * rng.normal(size=model.nv)
    if imperfect:
        match rng.integers(4):
            case 0:
                joints = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_FREE
                model.dof_frictionloss[joints] = (rng.uniform(0.2, 2) * model.dof_M0)[joints]  # rad/s^2, m/s^2
            case 1:
                gain = rng.uniform(0.5, 0.9)
                model.actuator_gainprm[:, :3] *= gain
                model.actuator_biasprm[:, :3] *= gain
            case 2:
                model.body_mass[-1] += 0.3 * model.body_mass[1:].max()
            case 3:
                joints = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_FREE
                model.dof_armature[joints] += 0.3 * model.dof_M0[joints]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def record(robot: str, rng: np.random.Generator, rate: int, noise: float, imperfect: bool) -> list[Log]:
    """Two recordings of one reality."""
    model = reality(robot, rng, imperfect)
    believed = mujoco.MjModel.from_xml_string(XML[robot])
    every, logs = round(1 / rate / model.opt.timestep), []
    for _ in range(2):
        data, command = mujoco.MjData(model), motion(robot, rng)
        if robot == "legged":
            turn = rng.uniform(-np.pi, np.pi)
            data.qpos[2] -= 0.01
            data.qpos[3:7] = np.cos(turn / 2), 0, 0, np.sin(turn / 2)
        if robot == "drone":
            axis = rng.normal(size=4) * [0, 0.3, 0.3, 1] + [1.5, 0, 0, 0]
            data.qpos[3:7] = axis / np.linalg.norm(axis)
            data.qvel[3:] = rng.normal(size=3)
        if robot == "cart":
            data.qpos[1] = rng.uniform(-1, 1)
        rows: list[tuple] = []
        for k in range(round(DURATION[robot] / model.opt.timestep) + 1):
            t = k * model.opt.timestep
            if k % every == 0:
                rows.append((t, command(t), data.qpos.copy(), data.qvel.copy()))
            data.ctrl[:] = command(t + model.opt.timestep / 2)
            mujoco.mj_step(model, data)
        time, ctrl, qpos, qvel = (np.array(x) for x in zip(*rows, strict=True))
        sigma = np.empty(model.nv)
        for kind, v in zip(model.jnt_type, model.jnt_dofadr, strict=True):
            if kind == mujoco.mjtJoint.mjJNT_FREE:
                sigma[v : v + 6] = np.repeat([NOISE["position"], NOISE["rotation"]], 3)
            else:
                sigma[v] = NOISE["slide" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "hinge"]
        qpos = integrate(believed, qpos, noise * sigma * rng.normal(size=qvel.shape))
        qvel = qvel + 20 * noise * sigma * rng.normal(size=qvel.shape)
        logs.append(Log(time, ctrl, qpos, qvel))
    return logs


def _turn(log: Log) -> np.ndarray:
    out = np.empty((len(log.time), 9))
    for k, q in enumerate(log.qpos[:, 3:7]):
        mujoco.mju_quat2Mat(out[k], q)
    return out.reshape(-1, 3, 3)


def _scale(log: Log, arrays: str, columns: int | slice | list[int], factor: float) -> None:
    for name in arrays.split():
        getattr(log, name)[:, columns] *= factor


def _swap(log: Log, arrays: str, a: int, b: int) -> None:
    for name in arrays.split():
        values = getattr(log, name)
        values[:, [a, b]] = values[:, [b, a]]


def _frame(log: Log, columns: slice, inverse: bool) -> None:
    turn = _turn(log)
    log.qvel[:, columns] = np.einsum("kji,kj->ki" if inverse else "kij,kj->ki", turn, log.qvel[:, columns])


def _xyzw(log: Log) -> None:
    log.qpos[:, 3:7] = log.qpos[:, [4, 5, 6, 3]]


def _xyzw_alone(log: Log) -> None:
    _xyzw(log)
    log.qvel = np.full_like(log.qvel, np.nan)


def _down(log: Log) -> None:
    _scale(log, "qpos", [1, 2, 5, 6], -1)
    _scale(log, "qvel", [1, 2, 4, 5], -1)


def _swapped_legs(log: Log) -> None:
    _swap(log, "qpos", 8, 9)
    _swap(log, "qvel", 7, 8)


def _leg_backwards(log: Log) -> None:
    _scale(log, "qpos", 8, -1)
    _scale(log, "qvel", 7, -1)


def _hold(log: Log, every: int) -> None:
    fresh = np.arange(len(log.time)) // every * every
    log.qpos, log.qvel = log.qpos[fresh], log.qvel[fresh]


def _wrap(log: Log, column: int) -> None:
    log.qpos[:, column] = (log.qpos[:, column] + np.pi) % (2 * np.pi) - np.pi


def _drift(log: Log, rate: float) -> None:
    late = log.time * (1 + rate)
    log.ctrl = np.stack([np.interp(log.time, late, c) for c in log.ctrl.T], 1)


D = 180 / np.pi
Plant = tuple[Callable[[Log], None], str]
"""What is done to each recording, and a word that a finding must hold."""
PLANTS: Mapping[str, Mapping[str, Plant]] = {
    "arm": {
        "encoder counts the other way": (lambda g: _scale(g, "qpos qvel", 2, -1), "shoulder|elbow|wrist"),
        "command of opposite sign": (lambda g: _scale(g, "ctrl", 1, -1), "shoulder"),
        "velocity of opposite sign": (lambda g: _scale(g, "qvel", 3, -1), "wrist"),
        "degrees, one joint": (lambda g: _scale(g, "qpos qvel", 2, D), "degrees"),
        "degrees, all": (lambda g: _scale(g, "qpos qvel ctrl", slice(0, 5), D), "degrees"),
        "velocity in degrees/s": (lambda g: _scale(g, "qvel", 2, D), "degrees"),
        "velocity in rpm": (lambda g: _scale(g, "qvel", 2, 60 / 2 / np.pi), "revolutions per minute"),
        "encoder counts": (lambda g: _scale(g, "qpos qvel ctrl", 2, 4096 / 2 / np.pi), "4096"),
        "two joints swapped": (lambda g: _swap(g, "qpos qvel", 1, 2), "swapped"),
        "two commands swapped": (lambda g: _swap(g, "ctrl", 2, 3), "swapped"),
        "time in ms": (lambda g: setattr(g, "time", g.time * 1e3), "milliseconds|are in ms"),
        "time in ns": (lambda g: setattr(g, "time", g.time * 1e9), "nanoseconds|are in ns"),
        "repeated rows": (lambda g: _hold(g, 5), "repeat"),
        "drifting clock": (lambda g: _drift(g, 0.01), "drift"),
    },
    "legged": {
        "encoder counts the other way": (_leg_backwards, "fl_swing"),
        "quaternion xyzw": (_xyzw, "x, y, z, w"),
        "angular velocity in the world": (lambda g: _frame(g, slice(3, 6), False), "world's frame"),
        "linear velocity in the body": (lambda g: _frame(g, slice(0, 3), True), "body's frame"),
        "position in mm": (lambda g: _scale(g, "qpos", slice(0, 3), 1e3), "millimetres|mm|1000"),
        "two joints swapped": (_swapped_legs, "swapped"),
    },
    "drone": {
        "quaternion xyzw": (_xyzw, "x, y, z, w"),
        "quaternion xyzw, no velocities": (_xyzw_alone, "x, y, z, w"),
        "angular velocity in the world": (lambda g: _frame(g, slice(3, 6), False), "world's frame"),
        "linear velocity in the body": (lambda g: _frame(g, slice(0, 3), True), "body's frame"),
        "angular velocity in degrees/s": (lambda g: _scale(g, "qvel", slice(3, 6), D), "degrees"),
        "position in mm": (lambda g: _scale(g, "qpos", slice(0, 3), 1e3), "millimetres|mm|1000"),
        "z down": (_down, "z down|gravity"),
    },
    "cart": {
        "slide in mm": (lambda g: _scale(g, "qpos qvel", 0, 1e3), "millimetres"),
        "pole in degrees": (lambda g: _scale(g, "qpos qvel", 1, D), "degrees"),
        "force of opposite sign": (lambda g: _scale(g, "ctrl", 0, -1), "push|slider"),
        "encoder counts the other way": (lambda g: _scale(g, "qpos qvel", 1, -1), "pole"),
        "slide velocity in mm/s": (lambda g: _scale(g, "qvel", 0, 1e3), "mm"),
        "force in mN": (lambda g: _scale(g, "ctrl", 0, 1e3), "thousandths"),
    },
}


MENDED = ("repeated rows", "time in ms", "time in ns")
"""Kinds that are mended and noted instead of being refused; they count as refused."""


def save_logs(robot: str, logs: Sequence[Log], folder: Path) -> None:
    """Write a dataset: the first recording to fit, the others held out."""
    model = mujoco.MjModel.from_xml_string(XML[robot])
    measured = np.isfinite(logs[0].qvel).all(axis=0)
    recordings = [
        Recording(f"r{i}", g.time, g.ctrl, g.qpos, g.qvel, measured, "test" if i else "fit", model)
        for i, g in enumerate(logs)
    ]
    save_dataset(folder, XML[robot], recordings, DatasetDescription())


def findings_of(robot: str, logs: list[Log], folder: Path) -> list[Finding]:
    """Write and check a dataset; a refusal by the reader counts as an error."""
    save_logs(robot, logs, folder)
    try:
        return preflight(open_dataset(folder))
    except InputError as error:
        return [Finding("error", "loading", str(error))]


@dataclass(frozen=True)
class Config:
    """Settings."""

    cases: int = 0
    """Planted cases for each robot and kind."""
    clean: int = 0
    """Clean datasets."""
    seed: int = 0
    """Seed of everything random."""
    real: tuple[Path, ...] = ()
    """Datasets that are known to be in order."""
    only: str = ""
    """Only kinds whose name holds this."""
    verbose: bool = False
    """Print what is missed and what is accused."""


def draw(seed: int, robot: str, rate: int | None = None) -> tuple[list[Log], dict[str, float]]:
    """Recordings of a random reality, and its settings."""
    rng = np.random.default_rng([seed, *robot.encode()])
    rate = int(rng.choice(RATES)) if rate is None else rate
    noise, imperfect = float(np.exp(rng.uniform(np.log(0.25), np.log(4)))), bool(rng.integers(2))
    return record(robot, rng, rate, noise, imperfect), {"rate": rate, "noise": noise, "imperfect": imperfect}


def accused(findings: list[Finding]) -> list[Finding]:
    """Findings that would be false alarms for clean data: errors, and warnings about conventions."""
    return [f for f in findings if f.level == "error" or (f.level == "warning" and f.topic in ("convention", "clocks"))]


def planted(config: Config) -> None:
    """Print the share of planted errors that are found."""
    from re import search

    print(f"{'robot':8} {'planted':34} {'refused':>8} {'named':>6} {'of':>4}")
    for robot, kinds in PLANTS.items():
        for kind, (plant, word) in kinds.items():
            if config.only not in f"{robot} {kind}":
                continue
            refused = named = 0
            for case in range(config.cases):
                logs, about = draw(config.seed + case, robot)
                for log in logs:
                    plant(log)
                with TemporaryDirectory() as folder:
                    found = findings_of(robot, logs, Path(folder))
                bad = [f for f in found if f.level != "note" or f.topic == "loading"]
                hit = any(search(word, f.message) for f in bad)
                refused += any(f.level == "error" for f in found) or (kind in MENDED and hit)
                named += hit
                if config.verbose and not hit:
                    print("   ", config.seed + case, about, [f.message for f in bad])
            print(f"{robot:8} {kind:34} {refused:8} {named:6} {config.cases:4}", flush=True)


def clean(config: Config) -> None:
    """Print the share of clean datasets that are accused."""
    count: Counter[str] = Counter()
    robots = list(XML)
    for case in range(config.clean):
        robot = robots[case % len(robots)]
        logs, about = draw(10_000 + config.seed + case, robot)
        with TemporaryDirectory() as folder:
            bad = accused(findings_of(robot, logs, Path(folder)))
        count[robot] += bool(bad)
        if bad and config.verbose:
            print("   ", robot, 10_000 + config.seed + case, about, [f.message for f in bad], flush=True)
    print(f"clean datasets accused: {sum(count.values())} of {config.clean} ({dict(count)})")


def main(config: Config) -> None:
    """Run what was asked for."""
    mujoco.set_mju_user_warning(lambda _: None)  # alternatives that diverge are what they are
    if config.cases:
        planted(config)
    if config.clean:
        clean(config)
    for folder in config.real:
        bad = accused(preflight(open_dataset(folder)))
        print(folder, [dataclasses.asdict(f) for f in bad] or "nothing is accused")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
