"""Double pendulum of the DFKI underactuated lab (design C.0), six identification runs of 10 s at about 500 Hz.

Commands: torques sent. Believed: masses and inertias that the laboratory identified, shifted within what leaves the
planar dynamics as they are, without friction, damping and rotor inertia.
"""

import io

import polars
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "dfki-ric-underactuated-lab/double_pendulum", "1e8544e67f3da72a51ee52fbbb278e131ce2a43f"
ROOT = "data/experiment_records/design_C.0/20220914/sys_id"
KINDS = ("tau_con", "pos_meas", "vel_meas")
"""Columns of the commands, positions and velocities, without the number of the joint."""
MJCF = """<mujoco model="double_pendulum">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 -1 0"/>
      <inertial pos="0 0 -0.157402" mass="0.641694" diaginertia="0.005346 0.005346 0.002673"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 -1 0"/>
        <inertial pos="0 0 -0.258594" mass="0.700611" diaginertia="0.007028 0.007028 0.003514"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="elbow"/></actuator>
</mujoco>
"""


def make(copies: Copies) -> Trial:
    """The trial."""
    logs = []
    for i in range(6):
        table = polars.read_csv(io.BytesIO(copies.read(REPOSITORY, REVISION, f"{ROOT}/trajectory_0{i}.csv")))
        ctrl, qpos, qvel = (table.select(f"{kind}1", f"{kind}2").to_numpy() for kind in KINDS)
        logs.append(Log(f"r{i}", "fit" if i < 4 else "test", table["time"].to_numpy(), ctrl, qpos, qvel))
    return Trial(MJCF, tuple(logs), "hold")


MACHINE = Machine(
    name="double_pendulum",
    about=__doc__,
    source=f"{REPOSITORY}, {ROOT}/",
    licence="BSD-3-Clause",
    citation="Wiebe et al.: Open source dual-purpose acrobot and pendubot platform, IEEE RAM 31(2), 2024",
    split="runs 0 to 3 fitted, 4 and 5 held out",
    make=make,
    unit="rad",
    specialists=None,
    figure="none published; the laboratory's own numbers run beside it",
    published={"dof_damping": (0.001, 0.001), "dof_frictionloss": (0.093, 0.078), "dof_armature": (0.0036, 0.0036)},
)
