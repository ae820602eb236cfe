"""Crazyflie 2.1 Brushless of IDSIA's nano-drone benchmark: free flights, 100 Hz after their own processing.

Raw flights are used; those on the main branch are Git LFS pointers. Commands: thrust of each motor, from its measured
speed (electrical, six pole pairs). Believed: the benchmark's physical model. Flights are cut to where the drone is
above 0.3 m. The copy needs `git fetch origin refs/pull/1/head`.
"""

import io

import numpy as np
import polars
from machine import FREE, Copies, Log, Machine, Trial

REPOSITORY, REVISION = "idsia-robotics/nanodrone-sysid-benchmark", "d5b5129c7eeecd503e8e8504ed2d58970944e022"
ROOT = "data/real/raw/parquets"
THRUST, DRAG, ARM = 3.72e-8, 7.74e-12, 0.0353
"""Thrust [N s^2] and yaw torque [N m s^2] per squared motor speed, and distance of a motor from either axis [m]."""
MOTORS = ((1, -1, 1), (-1, -1, -1), (-1, 1, 1), (1, 1, -1))
"""Signs of x and y of each motor, and of its yaw torque."""
MJCF = """<mujoco model="crazyflie">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="body" pos="0 0 1">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="0.045" diaginertia="2.3951e-5 2.3951e-5 3.2347e-6"/>
{sites}    </body>
  </worldbody>
  <actuator>
{motors}  </actuator>
</mujoco>
"""
FIT = [f"{kind}_20251017_run{run}" for kind in ("random1", "random2", "multisine") for run in (1, 2)]
FIT += [f"square_20251017_run{run}" for run in (3, 4)]
TEST = [f"melon_20251017_run{run}" for run in (1, 4, 5)]


def make(copies: Copies) -> Trial:
    """The trial."""
    logs = []
    for name in FIT + TEST:
        table = polars.read_parquet(io.BytesIO(copies.read(REPOSITORY, REVISION, f"{ROOT}/{name}.parquet")))
        speeds = [f"m{i}_erpm" for i in range(1, 5)]
        columns = ["t", *speeds, *FREE["qpos"], *FREE["qvel"]]
        rows = table.select(columns).to_numpy().astype(float)
        flying = np.flatnonzero(rows[:, columns.index("z")] > 0.3)
        rows = rows[flying[0] : flying[-1] + 1]
        time, erpm, qpos, qvel = np.split(rows[np.isfinite(rows).all(1)], [1, 5, 12], axis=1)
        thrust = THRUST * (erpm * 2 * np.pi / 60 / 6) ** 2
        logs.append(Log(name, "fit" if name in FIT else "test", time[:, 0], thrust, qpos, qvel))
    signs = list(enumerate(MOTORS, 1))
    sites = "".join(f'      <site name="m{i}" pos="{ARM * x} {ARM * y} 0"/>\n' for i, (x, y, _) in signs)
    motor = '    <motor name="m{0}" site="m{0}" gear="0 0 1 0 0 {1:.6g}" ctrlrange="0 0.3"/>\n'
    motors = "".join(motor.format(i, turn * DRAG / THRUST) for i, (_, _, turn) in signs)
    return Trial(MJCF.format(sites=sites, motors=motors), tuple(logs), "linear")


MACHINE = Machine(
    name="crazyflie",
    about=__doc__,
    source=f"{REPOSITORY} (pull request 1), {ROOT}/",
    licence="none stated; not redistributed",
    citation="Busetto et al.: Nonlinear system identification for a nano-drone benchmark, Control Eng. Practice, 2026",
    split="random, multisine and square flights fitted, the three published melon flights held out",
    make=make,
    unit="rad/s",
    specialists=0.598,
    figure="mean norm of the error of the angular velocity after 50 steps (0.5 s), best learned model of the paper",
    horizon=0.5,
    measure="spin",
)
