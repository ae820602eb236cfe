"""EMPS, a prismatic electromechanical drive, 1 kHz.

Commands: motor force, the logged voltage times the published gain 35.15 N/V. Believed: the published moving mass of
95.11 kg, which includes the rotor, without friction.
"""

import io

import numpy as np
import scipy.io
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "MDMonkey/EMPS_RBF", "d5238ee84ec2e9d93d2c5a758696331356f38ca9"
MJCF = """<mujoco model="emps">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="95.11" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" ctrlrange="-400 400"/></actuator>
</mujoco>
"""


def make(copies: Copies) -> Trial:
    """The trial."""
    logs = []
    for name, split in (("DATA_EMPS", "fit"), ("DATA_EMPS_PULSES", "test")):
        table = scipy.io.loadmat(io.BytesIO(copies.read(REPOSITORY, REVISION, f"Data/{name}.mat")))
        time, volts, position = (np.asarray(table[key], float).ravel() for key in ("t", "vir", "qm"))
        force = volts * float(table["gtau"].item())
        logs.append(Log(name, split, time, force[:, None], position[:, None]))  # type: ignore[arg-type]
    return Trial(MJCF, tuple(logs), "hold")


MACHINE = Machine(
    name="emps",
    about=__doc__,
    source=f"{REPOSITORY}, Data/",
    licence="none stated; not redistributed",
    citation="Janot, Gautier, Brunot: Data set and reference models of EMPS, nonlinearbenchmark.org, 2019",
    split="DATA_EMPS fitted, DATA_EMPS_PULSES held out",
    make=make,
    unit="m",
    specialists=0.0092,
    figure="RMS of the simulated position on the pulses, without the first 20 samples, with the authors' parameters",
    skip=20,
    published={"dof_damping": (203.5,), "dof_frictionloss": (20.39,), "offset": (-3.16,)},
)
