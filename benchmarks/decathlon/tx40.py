"""Staubli TX40 on an exciting trajectory, 9 s at 5 kHz, of which every fifth sample is used.

Motor angles are divided by the gear ratios; motor 6 also moves behind joint 5. Commands: motor torques times the same
matrix, transposed. Believed: the URDF's masses and inertias, without friction and rotor inertia; its last link has no
mass and gets 0.01 kg.
"""

import io

import numpy as np
from machine import Copies, Log, Machine, Trial, arm_from_urdf

REPOSITORY, REVISION = "thanhndv212/figaroh-examples", "c0b5c7f0fda10078be55104f9ee76ac106b7a5ee"
ROOT = "examples/staubli_TX40"
RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
ZERO = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
"""Joint angles where the motor angles are zero [rad]."""
HELD_OUT = 0.6
"""Share of the trajectory behind which it is held out."""


def make(copies: Copies) -> Trial:
    """The trial."""
    angles, torques = (
        np.loadtxt(
            io.StringIO(copies.text(REPOSITORY, REVISION, f"{ROOT}/data/{name}.csv")), delimiter=",", skiprows=1
        )[::5]
        for name in ("pos_read_data", "curr_data")
    )
    ratios = np.diag(RATIOS)
    ratios[5, 4] = RATIOS[5]
    qpos = np.linalg.solve(ratios, angles.T).T + ZERO
    whole = Log("trajectory", "fit", 1e-3 * np.arange(len(qpos)), torques @ ratios, qpos)
    urdf = copies.text(REPOSITORY, REVISION, f"{ROOT}/urdf/tx40_mdh_modified.urdf")
    xml = arm_from_urdf(urdf, 'boundmass="0.01" boundinertia="0.0001"')
    parts = (whole.part(0.0, HELD_OUT, "fit", "first"), whole.part(HELD_OUT, 1.0, "test", "last"))
    return Trial(xml, parts, "linear")


MACHINE = Machine(
    name="tx40",
    about=__doc__,
    source=f"{REPOSITORY}, {ROOT}/",
    licence="none stated for the data (code Apache-2.0); not redistributed",
    citation="Nguyen et al.: FIGAROH, github.com/thanhndv212/figaroh-examples",
    split="first 60 % of the trajectory fitted, the rest held out",
    make=make,
    unit="rad",
    specialists=0.153,
    figure="least squares of dry friction, damping and rotor inertia; the repository publishes parameters, no error",
    horizon=0.25,
    published={
        "dof_damping": (8.05, 5.53, 1.97, 1.11, 1.86, 0.65),
        "dof_frictionloss": (7.14, 8.26, 6.34, 2.48, 3.03, 0.282),
        "dof_armature": (0.362, 0.362, 0.0988, 0.0313, 0.0468, 0.0105),
    },
)
