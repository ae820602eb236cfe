"""SO-101, a small arm of six Feetech STS3215 servos, from NVIDIA's SAGE, 50 Hz.

Commands: goals, held by the servo. The jaw is logged as a share of its range. Believed: the manufacturer's MJCF as
published, with its gains, damping, friction and rotor inertia, without meshes.
"""

import ast
import re

import mujoco
import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "isaac-sim2real/sage", "4ffd2627df9d23e279b35712a67e629ce0c0dfa7"
ROOT = "output/real/so101/custom"
MODEL, MODEL_REVISION = "TheRobotStudio/SO-ARM100", "fda892cba81032c46c40976a48c9ceadbf40a9ca"
JAW = (-0.17453297762778586, 1.7453291995659765)
"""Range of the jaw in the MJCF [rad]."""


def rows(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and the first list of numbers of each line of a log."""
    lines = text.strip().splitlines()[1:]
    values = np.array([ast.literal_eval(re.findall(r"\[[^]]*\]", line)[0]) for line in lines], float)
    values[:, 5] = JAW[0] + values[:, 5] * (JAW[1] - JAW[0])
    return np.array([1e-6 * float(line.split(",")[1]) for line in lines]), values


def mjcf(text: str) -> str:
    """The published model without shapes."""
    spec = mujoco.MjSpec.from_string(text)
    for part in (*spec.geoms, *spec.meshes, *spec.materials):
        spec.delete(part)
    spec.compile()
    return str(spec.to_xml())


def make(copies: Copies) -> Trial:
    """The trial."""
    motions = copies.names(REPOSITORY, REVISION, ROOT)
    logs = []
    for split, chosen in (("fit", motions[0::4]), ("test", motions[2::4])):
        for motion in chosen:
            folder = f"{ROOT}/{motion}"
            time, goals = rows(copies.text(REPOSITORY, REVISION, f"{folder}/control.csv"))
            _, qpos = rows(copies.text(REPOSITORY, REVISION, f"{folder}/state_motor.csv"))
            n = min(len(goals), len(qpos))
            logs.append(Log(motion, split, time[:n], goals[:n], qpos[:n]))  # type: ignore[arg-type]
    return Trial(mjcf(copies.text(MODEL, MODEL_REVISION, "Simulation/SO101/so101_new_calib.xml")), tuple(logs), "hold")


MACHINE = Machine(
    name="so101",
    about=__doc__,
    source=f"{REPOSITORY}, {ROOT}/; {MODEL}, Simulation/SO101/",
    licence="Apache-2.0 (both)",
    citation="NVIDIA: SAGE, github.com/isaac-sim2real/sage; The Robot Studio: SO-ARM100",
    split="every fourth motion fitted, those halfway between held out",
    make=make,
    unit="rad",
    specialists=0.0241,
    figure="RMS over whole motions and five joints without the jaw, with NVIDIA's tuned model (gtc_berlin)",
    dofs=(0, 1, 2, 3, 4),
)
