"""Plays the robot in the next room: tries what a co-evolution asks for, and writes what came out.

    uv run python -m btr_mjx.coevolve --robot examples/thrower --reality folder --exchange runs/room --wait
    uv run python examples/robot_in_the_next_room.py runs/room        # in another terminal

It knows nothing of the co-evolution but the files in the exchange folder. The robot here is MuJoCo with a finer time
step, a heavier ball and more friction in the elbow than the co-evolution believes, and sensors with noise.
"""

import csv
import os
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

MODEL = Path(__file__).parent / "thrower" / "robot.xml"
TARGET = np.array([0.35, 0.0, 1.3])
NOISE = 1e-3  # of a measured distance [m]


def real_robot() -> mujoco.MjModel:
    """The robot as it is."""
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    model.opt.timestep = 2.5e-4
    ball, elbow = model.body("ball").id, int(model.joint("elbow").dofadr[0])
    model.body_inertia[ball] *= 0.4 / model.body_mass[ball]
    model.body_mass[ball] = 0.4
    model.dof_damping[elbow] = 0.7
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def try_on_robot(model: mujoco.MjModel, signal: Path) -> float:
    """Distance of the hand from the target after the motors have followed a signal [m]."""
    table = np.loadtxt(signal, delimiter=",", skiprows=1)
    data = mujoco.MjData(model)
    while data.time < table[-1, 0] - 1e-9:
        data.ctrl[:] = [np.interp(data.time, table[:, 0], column) for column in table[:, 1:].T]
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return float(np.linalg.norm(data.site("hand").xpos - TARGET))


def serve(exchange: Path) -> int:
    """Try every trial that has not been measured; returns their number."""
    model, count = real_robot(), 0
    for asked in sorted((exchange / "trials").glob("*.csv")):
        measured = exchange / "measured" / asked.name
        if measured.exists():
            continue
        rows = []
        for row in csv.DictReader(asked.read_text().splitlines()):
            rng = np.random.default_rng(int(row["id"]))
            distance = try_on_robot(model, exchange / "signals" / f"trial-{row['id']}.csv")
            rows += [f"{row['id']},{distance + NOISE * rng.normal():.6f}" for _ in range(2)]  # measured twice
            count += 1
        draft = measured.with_suffix(".draft")
        draft.write_text("\n".join(["id,fitness", *rows]) + "\n")
        os.replace(draft, measured)  # all rows at once
    return count


def main() -> None:
    """Measure whatever is asked for, once or until it is stopped."""
    if len(sys.argv) < 2 or "--help" in sys.argv:
        print(__doc__)
        return
    exchange, once = Path(sys.argv[1]), "--once" in sys.argv
    while True:
        count = serve(exchange)
        if count:
            print(f"measured {count} trials", flush=True)
        if once:
            return
        time.sleep(0.2)


if __name__ == "__main__":
    main()
