"""Arms of `field_robots` that are recorded, changed and recorded again.

    make_changed(folder, seed=1, index=0)        # writes folder/before and folder/after, returns the truth

The calibration is wide: masses 5 %, gains 4 %, damping from nothing to twice of what is believed, zeros 4 mrad.
Motions, noise, and when commands act within a sample are new each time.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hidden_cases.field_cases import Logging, UsualSizes, log_rows, usual_sizes
from hidden_cases.field_physics import SETTLE, Calibration, Controlled, Motion, build, move
from hidden_cases.field_robots import ROBOTS, FieldRobot

CHANGES = ("dry_friction", "payload", "actuator_gain", "viscous_damping", "nothing")
RUNS, DURATION = 3, 4.0
"""Recordings of a set, and their length [s]."""
MOST_JOINTS = 4
"""Joints of the arms; more take longer."""


def wide_calibration(rng: np.random.Generator, model: mujoco.MjModel) -> Calibration:
    """A robot that nobody has calibrated: masses 5 %, gains 4 %, damping 0 to 200 %, zeros 4 mrad."""
    return Calibration(
        rng.uniform(0, 2, model.nv),
        1 + 0.04 * rng.standard_normal(model.nactuator).clip(-2, 2),
        1 + 0.05 * rng.standard_normal(model.nbody).clip(-2, 2),
        4e-3 * rng.standard_normal(model.nv).clip(-2, 2),
    )


def change_of(rng: np.random.Generator, model: mujoco.MjModel, usual: UsualSizes, kind: str) -> list[dict[str, Any]]:
    """The change: 0.08 N m, 60 g, -5 %, 0.12 N m s/rad; at a joint that moves with less, as a part of what is usual."""
    if kind == "nothing":
        return []
    a = int(rng.integers(model.nactuator))
    dof = int(model.jnt_dofadr[model.actuator_trnid[a, 0]])
    torque, speed = usual.torque[dof], usual.speed[dof]
    if kind == "payload":
        body = model.nbody - 1
        geom = int(model.body_geomadr[body])
        place = dict(zip("xyz", (1.7 * model.geom_pos[geom]).tolist(), strict=True))
        return [{"effect": kind, "location": f"body:{model.body(body).name}", "parameters": {"mass": 0.06, **place}}]
    if kind == "actuator_gain":
        return [{"effect": kind, "location": f"actuator:{model.actuator(a).name}", "parameters": {"change": -0.05}}]
    size = min(0.08, 0.2 * torque) if kind == "dry_friction" else min(0.12, 0.3 * torque / speed)
    parameter = "torque" if kind == "dry_friction" else "damping"
    joint = model.joint(int(model.actuator_trnid[a, 0])).name
    return [{"effect": kind, "location": f"joint:{joint}", "parameters": {parameter: float(size)}}]


def record(
    folder: Path, rng: np.random.Generator, robot: FieldRobot, calibration: Calibration, hidden: Any, kept: bool = True
) -> None:
    """Write the folder of a set of recordings; of one that is not kept, only its random numbers are drawn."""
    model, interval = mujoco.MjModel.from_xml_string(robot.xml), 1 / float(rng.choice((100, 125)))
    calibration = replace(calibration, shift=float(rng.uniform(0, 0.5 * interval)))
    log = Logging(interval, (), bool(rng.random() < 0.5), 0.0, 0, robot.noise)
    times = np.arange(-round(SETTLE / robot.step), round(DURATION / robot.step)) * robot.step
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(robot.xml)
    count = round(DURATION / robot.step)
    still = Motion(
        robot.step * np.arange(count), *(np.zeros((count, n)) for n in (model.nq, model.nv, model.nu, model.nv))
    )
    for k in range(RUNS):
        control = Controlled(robot, robot.reference(rng)(times))
        motion = move(build(robot, calibration, hidden), control) if kept else still
        (folder / f"run{k + 1}.csv").write_text(log_rows(rng, robot, model, motion, log))


def make_changed(folder: Path, seed: int, index: int) -> dict[str, Any]:
    """Write recordings of a robot before a change, and after it.

    Args:
      folder: gets folders of logs, before and after.
      seed: of everything random.
      index: of the case; one robot has a case for each of `CHANGES`.

    Returns:
      The truth: the change, as an effect of the library; none for "nothing".
    """
    robot_seed = int(np.random.SeedSequence([seed, index // len(CHANGES)]).generate_state(1)[0])
    rng = np.random.default_rng([robot_seed, 7])
    robot = ROBOTS["arm"](rng)
    while (model := mujoco.MjModel.from_xml_string(robot.xml)).nv > MOST_JOINTS:
        robot = ROBOTS["arm"](rng)
    calibration = wide_calibration(rng, model)
    times = np.arange(-round(SETTLE / robot.step), round(DURATION / robot.step)) * robot.step
    usual = usual_sizes(model, move(build(robot, calibration), Controlled(robot, robot.reference(rng)(times))))
    record(folder / "before", rng, robot, calibration, ())
    asked = CHANGES[index % len(CHANGES)]
    for kind in CHANGES[: CHANGES.index(asked) + 1]:  # one sequence of random numbers makes all recordings of a robot
        change = change_of(rng, model, usual, kind)
        record(folder / "after", rng, robot, calibration, change, kept=kind == asked)
    return {"effects": change}
