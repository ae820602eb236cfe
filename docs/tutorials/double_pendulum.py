# %% [markdown]
# # Diagnose a double pendulum
#
# A model of a double pendulum lacks something. Recordings of commands and motion say what, where, and how large it is.
# The robot is simulated here, so that the truth is known; `robot.xml` and CSV files are all that you would have.

# %%
import contextlib
import io
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import polars as pl

from btr_mjx.diagnose import diagnose
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.preflight import preflight

MODEL = """
<mujoco model="double_pendulum">
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom type="capsule" size="0.01" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 -1 0"/>
      <geom fromto="0 0 0 0 0 -0.2" mass="0.6"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 -1 0"/>
        <geom fromto="0 0 0 0 0 -0.25" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator>
</mujoco>"""

# %% [markdown]
# ## Recordings
#
# The robot has dry friction in the elbow's gear, 0.08 N m, which the model lacks. Torques of several frequencies drive
# it for three seconds; positions are sampled at 250 Hz with noise of 1 mrad.

# %%
robot = mujoco.MjModel.from_xml_string(MODEL)
robot.opt.timestep = 1e-4
robot.dof_frictionloss[robot.joint("elbow").dofadr] = 0.08


def record(seed: int) -> dict[str, np.ndarray]:
    """Columns of a recording of random torques."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 3, 0.004)
    waves = rng.uniform(0.2, 0.6, (3, 2)) * [1.0, 0.5]
    phases = rng.uniform(0, 6.28, (3, 2))
    speeds = 2 * np.pi * rng.uniform(0.4, 3.0, (3, 2))
    torque = (waves * np.sin(speeds * time[:, None, None] + phases)).sum(axis=1)
    data, rows = mujoco.MjData(robot), []
    for own in torque:
        rows.append(data.qpos.copy())
        data.ctrl[:] = own  # held until the next sample
        for _ in range(40):
            mujoco.mj_step(robot, data)
    qpos = np.array(rows) + 1e-3 * rng.normal(size=(len(rows), 2))
    columns = dict(zip(("ctrl/shoulder", "ctrl/elbow"), torque.T, strict=True))
    return {"time": time} | columns | dict(zip(("qpos/shoulder", "qpos/elbow"), qpos.T, strict=True))


folder = Path(tempfile.mkdtemp())
(folder / "robot.xml").write_text(MODEL)
header = '[model]\nfile = "robot.xml"\n[control]\ninterpolation = "hold"\n'
for i in range(5):
    pl.DataFrame(record(i)).write_csv(folder / f"r{i}.csv")
    header += f'[[recording]]\nfile = "r{i}.csv"\nsplit = "{"fit" if i < 3 else "test"}"\n'
(folder / "dataset.toml").write_text(header)
print(header[:140])

# %% [markdown]
# ## Check
#
# What is odd about the data is said within seconds, before anything is fitted (`diagnose DATASET --check`).

# %%
for finding in preflight(open_dataset(folder)):
    print(f"{finding.level}: {finding.message}")

# %% [markdown]
# ## Diagnose
#
# As a command: `uv run python -m btr_mjx.diagnose FOLDER --out runs/pendulum`.

# %%
with contextlib.redirect_stdout(io.StringIO()):
    result = diagnose(dataset=folder, out=folder / "run", progress=False)
print(result["sentence"])

# %%
(effect,) = result["effects"]
((name, size),) = effect["parameters"].items()
interval = f"90 % {size['low']:.4f} .. {size['high']:.4f}"
print(f"{effect['effect']} at {effect['location']}: {name} {size['value']:.4f}, {interval}")
assert effect["effect"] == "dry_friction"
assert "elbow" in effect["location"]
assert abs(size["value"] - 0.08) < 0.008

# %% [markdown]
# The run folder holds the page `report.html`, the mended model `mended.xml`, and ranges for domain randomisation.
# How well this does on real robots, a double pendulum among them: [measured](../gap_measured.md). How it works:
# [the method](../gap_method.md).
