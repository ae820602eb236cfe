"""Unitree Go2 whose trunk is held in the air, 200 Hz: joints follow a triangle that gets faster.

Commands: desired positions, turned into torque by the motors' gains (20 N m/rad, 1.5 N m s/rad towards standstill).
Believed: the repository's MJCF with a fixed trunk, without contacts, joint friction and damping, with its rotor inertia
of 0.01 kg m^2. The file's own friction and damping are the published numbers.
"""

import io
import zipfile

import mujoco
import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "iit-DLSLab/sim2real-robot-identification", "06739ea0424fa8b2e141df0942ecdaf27a5c8600"
JOINTS = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
HELD_OUT = 0.62
"""Share of the recording behind which it is held out."""
PARTS = 3
"""Recordings into which either side is cut."""


def mjcf(text: str) -> str:
    """The believed model from the repository's MJCF."""
    spec = mujoco.MjSpec.from_string(text)
    for part in (*spec.geoms, *spec.meshes, *spec.textures, *spec.materials, *spec.keys, *spec.sensors, *spec.pairs):
        spec.delete(part)
    for part in (*spec.actuators, *(j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE)):
        spec.delete(part)
    for joint in spec.joints:
        joint.damping[:], joint.frictionloss = 0.0, 0.0
    for name in JOINTS:
        limit = 45.43 if name.endswith("calf") else 23.7
        motor = spec.add_actuator(name=name, target=f"{name}_joint", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=20.0, kv=1.5)
        motor.forcelimited, motor.forcerange[:] = 1, (-limit, limit)
    spec.option.timestep, spec.option.integrator = 0.001, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    assert [model.joint(j).name for j in range(model.njnt)] == [f"{name}_joint" for name in JOINTS]
    return str(spec.to_xml())


def make(copies: Copies) -> Trial:
    """The trial."""
    archive = zipfile.ZipFile(io.BytesIO(copies.read(REPOSITORY, REVISION, "datasets/go2/traj_0.pt")))
    time, qpos, ctrl = (np.frombuffer(archive.read(f"traj_0/data/{i}"), "<f4").astype(float) for i in range(3))
    whole = Log("whole", "fit", time, ctrl.reshape(-1, 12), qpos.reshape(-1, 12))
    logs = []
    for split, first, last in (("fit", 0.0, HELD_OUT), ("test", HELD_OUT, 1.0)):
        edges = np.linspace(first, last, PARTS + 1)
        logs += [whole.part(edges[i], edges[i + 1], split, f"{split}{i}") for i in range(PARTS)]  # type: ignore[arg-type]
    return Trial(mjcf(copies.text(REPOSITORY, REVISION, "robot_model/go2/go2.xml")), tuple(logs), "hold")


MACHINE = Machine(
    name="go2_air",
    about=__doc__,
    source=f"{REPOSITORY}, datasets/go2/traj_0.pt and robot_model/go2/",
    licence="BSD-3-Clause",
    citation="DLS Lab, IIT: github.com/iit-DLSLab/sim2real-robot-identification",
    split="first 62 % of the recording in three parts fitted, the faster rest in three parts held out",
    make=make,
    unit="rad",
    specialists=0.0183,
    figure="RMS over the held-out parts, with the repository's own damping of 0.6 and dry friction of 0.2 N m",
    published={"dof_damping": (0.6,) * 12, "dof_frictionloss": (0.2,) * 12},
)
