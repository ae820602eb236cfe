"""Torque-limited simple pendulum of the DFKI underactuated lab: an AK80-6 drive (6:1), a rod and a weight.

Commands: the torque that the drive reports. Believed: the numbers of the testbench's description, 0.546 kg at 0.5 m, a
rod of 0.13 kg and the rotor's 6.07e-5 kg m^2 behind the gear, without friction. One recording has a weight of 1 kg.
The ends of three recordings are left out, in which the energy rises while the motor takes some out: a hand pushes.
"""

import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = (
    "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
    "ed17ea2d32a35ad944944ca03ef57693e2986732",
)
HEAVY = "model_1kg.xml"
MJCF = """<mujoco model="simple_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 -1 0" armature="0.002186"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.006" mass="0.13"/>
      <geom name="weight" type="sphere" pos="0 0 -0.5" size="0.025" mass="{mass}"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-12 12"/></actuator>
</mujoco>
"""
FIT = {
    "pd": "pd/system_identification/data_measured",
    "dircol": "direct_collocation/data_measured",
    "ddp": "ddp/data_measured",
    "swing": "pd/1nm_torque_limited_swingup_failure/data_measured",
}
TEST = {
    "ilqr": "ilqr/data_measured",
    "sac": "sac/data_measured",
    "energy": "energy_shaping/data_measured",
    "energy_1kg": "energy_shaping/data_measured_1kg",
}
PUSHED = {"sac": 17.0, "energy": 14.0, "energy_1kg": 13.0}
"""Time from which on a hand pushes [s]."""


def make(copies: Copies) -> Trial:
    """The trial."""
    logs = []
    for name, path in {**FIT, **TEST}.items():
        text = copies.text(REPOSITORY, REVISION, f"results/control_method_{path}.csv")
        rows = np.array([line.split(",") for line in text.strip().splitlines()[1:]], float)
        rows = rows[np.diff(rows[:, 0], prepend=-np.inf) > 0]
        time, position, velocity, torque = rows[rows[:, 0] < PUSHED.get(name, np.inf)].T[:4]
        ctrl, qpos, qvel = (values[:, None] for values in (torque, position, velocity))
        own = HEAVY if name == "energy_1kg" else ""
        logs.append(Log(name, "fit" if name in FIT else "test", time, ctrl, qpos, qvel, own))
    return Trial(MJCF.format(mass=0.546), tuple(logs), "linear", {HEAVY: MJCF.format(mass=1.046)})


MACHINE = Machine(
    name="simple_pendulum",
    about=__doc__,
    source=f"{REPOSITORY}, results/",
    licence="BSD-3-Clause",
    citation="Wiebe et al.: Torque-limited simple pendulum, JOSS 7(74), 2022",
    split="pd, dircol, ddp and a failed swing-up fitted; ilqr, sac and energy shaping held out",
    make=make,
    unit="rad",
    specialists=0.060,
    figure="dry friction of 0.17 N m and a gain of -23 %; RMS over the best 90 % of all stretches of 0.5 s",
    horizon=0.5,
    share=0.9,
    published={"dof_frictionloss": (0.17,), "gain": (0.77,)},
)
