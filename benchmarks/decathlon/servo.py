"""Dynamixel XL330 position servo that swings a pendulum, from Rhoban's BAM, about 190 Hz.

Commands: goals. Believed: the equivalent of a voltage-controlled motor with nominal torque constant, winding and rotor,
and a rod with a mass. Firmware gains differ between recordings, so that each gain has its own model.
"""

import json

import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "Rhoban/bam", "af2260462471"
ROOT = "bam/data.bak/raw"
KT, WINDING, ERROR_GAIN = 0.37, 3.5, 0.0028774
"""Torque constant [N m/A], resistance [ohm], duty per rad and per unit of firmware gain."""
RECORDINGS = {
    "2026-01-15_10h28m10": "fit",
    "2026-01-15_10h28m24": "fit",
    "2026-01-15_10h28m32": "test",
    "2026-01-15_10h29m14": "fit",
    "2026-01-15_10h29m29": "test",
    "2026-01-15_10h29m37": "fit",
}
MJCF = """<mujoco model="servo_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0 0 {middle}" mass="0.02" diaginertia="{rod} {rod} 1e-8"/>
      <joint name="servo" axis="0 -1 0" damping="{damping}" armature="0.0018"
        solreffriction="0.004 1" solimpfriction="0.9999 0.9999 0.001"/>
      <body name="load" pos="0 0 {end}"><inertial pos="0 0 0" mass="{mass}" diaginertia="1e-7 1e-7 1e-7"/></body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="servo" kp="{gain}" forcerange="-{limit} {limit}"/></actuator>
</mujoco>
"""


def mjcf(log: dict[str, float]) -> str:
    """The believed model of a recording."""
    limit, length = KT / WINDING * log["vin"], log["length"]
    numbers = {"gain": log["kp"] * ERROR_GAIN * limit, "damping": KT**2 / WINDING + 0.002, "mass": log["mass"]}
    return MJCF.format(middle=-length / 2, rod=0.02 * length**2 / 12, end=-length, limit=limit, **numbers)


def make(copies: Copies) -> Trial:
    """The trial."""
    logs, models = [], {}
    for name, split in RECORDINGS.items():
        log = json.loads(copies.text(REPOSITORY, REVISION, f"{ROOT}/{name}.json"))
        keys = ("timestamp", "goal_position", "position", "speed")
        time, *columns = (np.array([entry[key] for entry in log["entries"]], float) for key in keys)
        models[f"kp{log['kp']}.xml"] = mjcf(log)
        ctrl, qpos, qvel = (values[:, None] for values in columns)
        logs.append(Log(name, split, time, ctrl, qpos, qvel, f"kp{log['kp']}.xml"))  # type: ignore[arg-type]
    return Trial(next(iter(models.values())), tuple(logs), "linear", models)


MACHINE = Machine(
    name="servo",
    about=__doc__,
    source=f"{REPOSITORY}, {ROOT}/",
    licence="Apache-2.0",
    citation="Duclusaud et al.: Extended friction models for the physics simulation of servo actuators, ICRA 2025",
    split="four recordings fitted, two held out, alternating",
    make=make,
    unit="rad",
    specialists=0.0268,
    figure="mean absolute error over whole recordings of an independent fit with load-dependent friction",
    measure="mean",
)
