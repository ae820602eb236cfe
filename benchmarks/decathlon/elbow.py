"""Tossed elbow of ContactNets: two boxes with a free hinge between them, 148 Hz, measured by AprilTags.

Believed: the repository's URDF, 0.37 kg and 0.1 x 0.05 x 0.05 m each, friction 0.3, a hinge without friction. Logged
velocities are smoothed, so that positions only are used. There are no commands.
"""

import io
import zipfile

import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "DAIRLab/dair_pll", "5b02d284fcec81ca796b648ef72e842df30db656"
ROOT = "assets/contactnets_elbow"
RATE = 148.0
"""Samples per second."""
MJCF = """<mujoco model="elbow">
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom friction="0.3 0.005 0.0001" size="0.05 0.025 0.025"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="5 5 0.1"/>
    <body name="elbow_1" pos="0 0 0.2">
      <freejoint name="base"/>
      <inertial pos="0 0 0" mass="0.37" diaginertia="0.0006167 0.0006167 0.0006167"/>
      <geom name="box_1" type="box"/>
      <body name="elbow_2" pos="-0.035 0.06 0">
        <joint name="hinge" axis="0 1 0"/>
        <inertial pos="0.035 0 0" mass="0.37" diaginertia="0.0006167 0.0006167 0.0006167"/>
        <geom name="box_2" type="box" pos="0.035 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def make(copies: Copies) -> Trial:
    """The trial."""
    logs = []
    for split, numbers in (("fit", range(16)), ("test", range(100, 116))):
        for number in numbers:
            archive = zipfile.ZipFile(io.BytesIO(copies.read(REPOSITORY, REVISION, f"{ROOT}/{number}.pt")))
            state = np.frombuffer(archive.read("archive/data/0"), "<f8").reshape(-1, 15)
            qpos = np.hstack([state[:, 4:7], state[:, 0:4], state[:, 7:8]])  # the quaternion comes first in the log
            time, ctrl = np.arange(len(state)) / RATE, np.empty((len(state), 0))
            logs.append(Log(f"toss_{number}", split, time, ctrl, qpos))  # type: ignore[arg-type]
    return Trial(MJCF, tuple(logs), None)


MACHINE = Machine(
    name="elbow",
    about=__doc__,
    source=f"{REPOSITORY} (tag v0.0.2), {ROOT}/",
    licence="BSD-3-Clause",
    citation="Pfrommer, Halm, Posa: ContactNets, CoRL 2020; github.com/DAIRLab/dair_pll",
    split="tosses 0 to 15 fitted, 100 to 115 held out",
    make=make,
    unit="m",
    specialists=None,
    figure="none known; the error is that of the first box's position over whole tosses",
    dofs=(0, 1, 2),
)
