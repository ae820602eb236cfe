"""Franka Emika Panda on an exciting trajectory, 21 s at about 1 kHz.

Commands: measured joint torques. Believed: masses, centres and inertias that Gaz et al. identified, as public models of
the arm have them, without gripper, friction and rotor inertia.
"""

import numpy as np
from machine import Copies, Log, Machine, Trial

REPOSITORY, REVISION = "marcocognetti/FrankaEmikaPandaDynModel", "24d85ce4e648e2e894c832bfeee9b16711eb1a1a"
ROOT = "matlab/data/Exciting_Traj/Trajectory_1/rbt_log"
HELD_OUT = 0.6
"""Share of the trajectory behind which it is held out."""
LINKS = """
0 0 0.333     | 1 0 0 0  | 4.970684 | 0.003875 0.002081 -0.04762   | 0.70337 0.70661 0.009117 -0.000139 0.006772 0.019169
0 0 0         | 1 -1 0 0 | 0.646926 | -0.003141 -0.02872 0.003495  | 0.007962 0.02811 0.025995 -0.003925 0.010254 0.000704
0 -0.316 0    | 1 1 0 0  | 3.228604 | 0.027518 0.039252 -0.066502  | 0.037242 0.036155 0.01083 -0.004761 -0.011396 -0.012805
0.0825 0 0    | 1 1 0 0  | 3.587895 | -0.05317 0.104419 0.027454   | 0.025853 0.019552 0.028323 0.007796 -0.001332 0.008641
-0.0825 0.384 0 | 1 -1 0 0 | 1.225946 | -0.011953 0.041065 -0.038437 | 0.035549 0.029474 0.008627 -0.002117 -0.004037 0.000229
0 0 0         | 1 1 0 0  | 1.666555 | 0.060149 -0.014117 -0.010517 | 0.001964 0.004354 0.005433 0.000109 -0.001158 0.000341
0.088 0 0     | 1 1 0 0  | 0.735522 | 0.010517 -0.004252 0.061597  | 0.012516 0.010027 0.004815 -0.000428 -0.001196 -0.000741
"""  # noqa: E501
"""Position, orientation, mass, centre and inertia (xx yy zz xy xz yz) of each link in the frame of its joint."""


def mjcf() -> str:
    """The believed model."""
    bodies, motors, lines = "", "", LINKS.strip().splitlines()
    for i, line in enumerate(lines, 1):
        pos, quat, mass, centre, inertia = (cell.strip() for cell in line.split("|"))
        bodies += f'<body name="link{i}" pos="{pos}" quat="{quat}"><joint name="joint{i}" axis="0 0 1"/>'
        bodies += f'<inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>\n'
        motors += f'<motor name="joint{i}" joint="joint{i}" ctrlrange="-87 87"/>\n'
    return f"""<mujoco model="panda"><compiler angle="radian"/>
<option timestep="0.001" integrator="implicitfast"/>
<worldbody>{bodies}{"</body>" * len(lines)}</worldbody>
<actuator>{motors}</actuator></mujoco>
"""


def make(copies: Copies) -> Trial:
    """The trial."""
    time, torque, position, velocity = (
        np.array(copies.text(REPOSITORY, REVISION, f"{ROOT}/exciting_traj_{name}.txt").split(), float)
        for name in ("time", "torques", "positions", "velocity")
    )
    later = np.diff(time, prepend=-np.inf) > 0
    ctrl, qpos, qvel = (values.reshape(-1, 7)[later] for values in (torque, position, velocity))
    whole = Log("trajectory", "fit", time[later], ctrl, qpos, qvel)
    parts = (whole.part(0.0, HELD_OUT, "fit", "first"), whole.part(HELD_OUT, 1.0, "test", "last"))
    return Trial(mjcf(), parts, "linear")


MACHINE = Machine(
    name="panda",
    about=__doc__,
    source=f"{REPOSITORY}, {ROOT}/",
    licence="GPL-3.0; not redistributed",
    citation="Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca: IEEE RA-L 4(4), 2019",
    split="first 60 % of the trajectory fitted, the rest held out",
    make=make,
    unit="rad",
    specialists=0.056,
    figure="least squares of dry friction, damping and rotor inertia; constant velocity is at 0.021",
    horizon=0.25,
    published={"dof_frictionloss": (0.273, 0.434, 0.320, 0.642, 0.422, 0.152, 0.280)},
)
