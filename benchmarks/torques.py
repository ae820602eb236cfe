"""What measured torques tell of arms: `uv run python benchmarks/torques.py --cases 10 --json torques.json`.

    uv run python benchmarks/torques.py --cases 9 --without 4         # a weak motor and damping at the same joint
    uv run python benchmarks/torques.py --question drives             # controllers unknown: friction, damping, rotors

An arm of six joints is recorded with encoders (0.2 mrad) and drives that report their torques (0.05 N m; torque
constants of the first question 4 % off). `weak_or_stiff` is solved with the torques and without them. In `drives`
nothing but positions and torques is in the log. Exit code: 1 where a case failed.
"""

import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
import tyro

from btr_mjx.errors import cli_errors
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.inference import identify
from btr_mjx.gap.results import Diagnosis
from btr_mjx.runs import note, write_json

JOINTS = 6
LENGTHS, MASSES = (0.15, 0.35, 0.3, 0.1, 0.1, 0.08), (4.0, 3.5, 2.2, 1.2, 1.0, 0.4)
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
STRENGTH = np.array([1.0, 1.0, 0.8, 0.4, 0.4, 0.25])
"""Size of friction and rotors at each joint, in units of the first."""

STEP, EVERY = 2e-4, 20
"""Time step of the simulated reality [s], and steps per sample."""

DRIVES = {"friction": "dry_friction", "damping": "viscous_damping", "rotor": "armature"}


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    question: Literal["weak_or_stiff", "drives"] = "weak_or_stiff"
    """What is asked of the recordings."""
    cases: int = 10
    """Number of arms."""
    without: int = 10
    """Arms of the first question that are solved without their torques, too."""
    seed: int = 1
    """Seed of the arms."""
    json: Path | None = None
    """Write the rows here."""


def arm(actuator: str = 'position kp="200" kv="5"') -> str:
    """MJCF of an arm whose joints are driven by actuators of one kind."""
    bodies = ""
    for i, (axis, length, mass) in enumerate(zip(AXES, LENGTHS, MASSES, strict=True)):
        at = LENGTHS[i - 1] if i else 0.1
        bodies += (
            f'<body name="link{i}" pos="0 0 {at}"><joint name="j{i}" axis="{axis}"/><geom type="capsule" '
            f'fromto="0 0 0 0.03 0 {length}" size="0.03" mass="{mass}" contype="0" conaffinity="0"/>'
        )
    kind, _, numbers = actuator.partition(" ")
    drives = "".join(f'<{kind} name="m{i}" joint="j{i}" {numbers}/>' for i in range(JOINTS))
    return (
        '<mujoco><option timestep="0.001" integrator="implicitfast"/><default><joint damping="0.3" armature="0.02"/>'
        f"</default><worldbody>{bodies}{'</body>' * JOINTS}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def references(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """(steps, joints) smooth motion that begins at rest [rad]."""
    size, rate = rng.uniform(0.1, 0.4, (JOINTS, 3)), rng.uniform(0.1, 0.9, (JOINTS, 3))
    phase = rng.uniform(0, 2 * np.pi, (JOINTS, 3))
    t = np.arange(round(seconds / STEP))[:, None, None] * STEP
    return (size * (np.sin(2 * np.pi * rate * t + phase) - np.sin(phase))).sum(-1)


def write_log(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write arrays (K, joints) by the ending of their names, with time stamps."""
    count = len(next(iter(columns.values())))
    head = ["t", *(f"j{i}_{name}" for name in columns for i in range(JOINTS))]
    rows = np.concatenate([np.arange(count)[:, None] * STEP * EVERY, *columns.values()], 1)
    np.savetxt(path, rows, "%.6f", delimiter=",", header=",".join(head), comments="")


def weak_or_stiff(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Record a weak motor and damping at one joint, with reported torques and without."""
    model = mujoco.MjModel.from_xml_string(arm())
    model.opt.timestep = STEP
    joint = int(rng.integers(JOINTS))
    model.dof_damping *= 1 + 0.03 * rng.standard_normal(JOINTS)
    model.body_mass[1:] *= 1 + 0.005 * rng.standard_normal(JOINTS)
    model.actuator_gainprm[joint] *= 0.85
    model.actuator_biasprm[joint] *= 0.85
    damping = float(rng.uniform(0.5, 1.5) * STRENGTH[joint])
    model.dof_damping[joint] += damping
    mujoco.mj_setConst(model, mujoco.MjData(model))
    constant = 1 + 0.04 * rng.standard_normal(JOINTS)
    for name in ("with", "without"):
        (folder / name).mkdir()
        (folder / name / "arm.xml").write_text(arm())
    for number in range(4):
        data, wanted, rows = mujoco.MjData(model), references(rng, 8.0), []
        for k, target in enumerate(wanted):
            data.ctrl[:] = target
            mujoco.mj_step1(model, data)
            if k % EVERY == 0:
                mujoco.mj_fwdActuation(model, data)
                rows.append((data.qpos.copy(), target, constant * data.actuator_force))
            mujoco.mj_step2(model, data)
        position, command, torque = map(np.array, zip(*rows, strict=True))
        position += 2e-4 * rng.standard_normal(position.shape)
        torque += 0.05 * rng.standard_normal(torque.shape)
        write_log(folder / "without" / f"{number}.csv", {"pos": position, "cmd": command})
        write_log(folder / "with" / f"{number}.csv", {"pos": position, "cmd": command, "effort": torque})
    return {"joint": joint, "change": -0.15, "damping": damping}


def drives(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Record an arm whose controller is unknown and whose drives rub, are damped and have rotors."""
    model = mujoco.MjModel.from_xml_string(arm("motor"))
    model.opt.timestep = STEP
    friction, rotor = rng.uniform(0.3, 1.5, JOINTS) * STRENGTH, rng.uniform(0.1, 0.4, JOINTS) * STRENGTH
    damping = rng.uniform(0.2, 1.2, JOINTS)
    model.dof_frictionloss[:] = friction
    model.dof_armature += rotor
    model.dof_damping += damping
    stiffness, rate = rng.uniform(100, 400, JOINTS), rng.uniform(3, 12, JOINTS)
    (folder / "arm.xml").write_text(arm())
    for number in range(4):
        data, wanted, rows = mujoco.MjData(model), references(rng, 12.0), []
        for k, target in enumerate(wanted):
            data.ctrl[:] = stiffness * (target - data.qpos) - rate * data.qvel + 0.6 * data.qfrc_bias
            if k % EVERY == 0:
                rows.append((data.qpos.copy(), data.ctrl.copy()))
            mujoco.mj_step(model, data)
        position, torque = map(np.array, zip(*rows, strict=True))
        position += 2e-4 * rng.standard_normal(position.shape)
        torque += 0.05 * rng.standard_normal(torque.shape)
        write_log(folder / f"{number}.csv", {"pos": position, "effort": torque})
    return {name: own.tolist() for name, own in (("friction", friction), ("damping", damping), ("rotor", rotor))}


def both_found(truth: Mapping[str, Any], found: Diagnosis) -> bool:
    """Whether the weak motor and the damping are named at their joint, each once, and nothing else."""
    joint = truth["joint"]
    wanted = {("actuator_gain", f"actuator:m{joint}"), ("viscous_damping", f"joint:j{joint}")}
    return {(e.effect, e.location) for e in found.effects} == wanted


def errors_of(truth: Mapping[str, Any], found: Diagnosis) -> dict[str, list[float]]:
    """Relative errors of the numbers of all drives."""
    out = {}
    for name, effect in DRIVES.items():
        total = np.zeros(JOINTS)
        for one in (*found.effects, *found.calibration):
            for number, own in one.parameters.items() if one.effect == effect else ():
                at = [
                    f"[j{i}]" in number or one.location == f"joint:j{i}" or one.location == "all" for i in range(JOINTS)
                ]
                total += own.value * np.array(at)
        out[name] = (total / np.array(truth[name]) - 1).tolist()
    return out


def solved(folder: Path) -> tuple[Diagnosis, float]:
    """The diagnosis of a folder, and its CPU time [s]."""
    begun = time.process_time()
    return identify(open_dataset(folder)), time.process_time() - begun


def row_of(config: Config, index: int) -> dict[str, Any]:
    """Make and solve one arm."""
    rng = np.random.default_rng([config.seed, index])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if config.question == "drives":
            truth = drives(rng, folder)
            found, seconds = solved(folder)
            return {"truth": truth, "verdict": found.verdict, "errors": errors_of(truth, found), "seconds": seconds}
        truth = weak_or_stiff(rng, folder)
        row: dict[str, Any] = {"truth": truth}
        for side in ("with", "without") if index < config.without else ("with",):
            found, seconds = solved(folder / side)
            names = [f"{e.effect}@{e.location}" for e in found.effects]
            row[side] = {"both": both_found(truth, found), "names": names, "seconds": seconds}
        return row


def main(config: Config) -> None:
    """Run the benchmark."""
    rows = []
    for index in range(config.cases):
        rows.append(row_of(config, index))
        note(f"{index}: {rows[-1]}")
        if config.json:
            write_json(config.json, {"question": config.question, "rows": rows})
    if config.question == "drives":
        for name in DRIVES:
            errors = np.abs([row["errors"][name] for row in rows])
            print(f"{name}: {(errors < 0.1).mean():.0%} of {errors.size} within 10 %, median {np.median(errors):.1%}")
        whole = [all(max(map(abs, row["errors"][name])) < 0.1 for name in ("friction", "rotor")) for row in rows]
        print(f"arms with all friction and rotors within 10 %: {sum(whole)} of {len(rows)}")
    else:
        for side in ("with", "without"):
            found = [row[side]["both"] for row in rows if side in row]
            print(f"{side} torques: both found in {sum(found)} of {len(found)}")


if __name__ == "__main__":
    with cli_errors():
        main(tyro.cli(Config, description=__doc__))
