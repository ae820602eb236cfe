"""Universal Robots UR10e on Fourier trajectories, 100 Hz.

Commands: measured motor currents times the controller's own torque constants, which a regression of the logged target
current on the logged target torque and on friction gives. Believed: the manufacturer's masses and inertias, without
friction and rotor inertia.
"""

import numpy as np
from machine import Copies, Log, Machine, Trial, arm_from_urdf

REPOSITORY, REVISION = "shamilmamedov/dynamic_calibration", "11af40e7deb758ec080a175fed8fcdd6c99aca29"
DATA = "dataset_ur10e/identification_data"
FIT = ("ur-20_02_05-20sec_8harm", "ur-20_02_06-20sec_10harm")
TEST = ("ur-20_02_06-20sec_5harm", "ur-20_02_05-20sec_12harm")
POSITION, VELOCITY, CURRENT, TARGET, TORQUE = (slice(1 + 6 * k, 7 + 6 * k) for k in range(5))
"""Columns of a log after the time."""


def torque_constants(rows: np.ndarray) -> np.ndarray:
    """(6,) torque of the joint per ampere of its motor [N m/A]."""
    out = np.empty(6)
    for j in range(6):
        speed, target = rows[:, VELOCITY][:, j], rows[:, TARGET][:, j]
        unknowns = np.column_stack([rows[:, TORQUE][:, j], np.sign(speed), speed])
        out[j] = 1 / np.linalg.lstsq(unknowns, target)[0][0]
    return out


def make(copies: Copies) -> Trial:
    """The trial."""
    tables = {}
    for name in (*FIT, *TEST):
        text = copies.text(REPOSITORY, REVISION, f"{DATA}/{name}.csv")
        tables[name] = np.array([line.split(",") for line in text.split()], float)
    constants = torque_constants(np.vstack([tables[name] for name in FIT]))
    logs = []
    for name, rows in tables.items():
        moving = np.flatnonzero((np.abs(rows[:, VELOCITY]) > 0.01).any(1))
        rows = rows[moving[0] : moving[-1] + 1]
        rows = rows[np.diff(rows[:, 0], prepend=-np.inf) > 0]
        time, ctrl = rows[:, 0] - rows[0, 0], rows[:, CURRENT] * constants
        logs.append(Log(name, "fit" if name in FIT else "test", time, ctrl, rows[:, POSITION], rows[:, VELOCITY]))
    xml = arm_from_urdf(copies.text(REPOSITORY, REVISION, "URe/urdf/ur10e.urdf"))
    return Trial(xml, tuple(logs), "linear")


MACHINE = Machine(
    name="ur10e",
    about=__doc__,
    source=f"{REPOSITORY}, {DATA}/ and URe/urdf/",
    licence="none stated; not redistributed",
    citation="Mamedov: dynamic_calibration, github.com/shamilmamedov/dynamic_calibration",
    split="8 and 10 harmonics fitted, 5 and 12 held out",
    make=make,
    unit="rad",
    specialists=0.0095,
    figure="least squares of dry friction, damping and rotor inertia; the repository publishes the method, no numbers",
    horizon=0.25,
)
