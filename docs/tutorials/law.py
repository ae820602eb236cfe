# %% [markdown]
# # A law that no library has
#
# The magnets of a pendulum's motor hold it at some positions of a turn. No effect of the
# [library](../effects.md) says so. Where nothing there fits, terms of a dictionary compete, and the answer is an
# equation.

# %%
import json
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from btr_mjx.diagnose import diagnose
from btr_mjx.gap.results import Callback

MODEL = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" damping="0.002"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2"/>
    </body>
  </worldbody>
  <actuator><motor name="hinge" joint="hinge"/></actuator>
</mujoco>"""


def hidden(q):
    """What the model lacks [N m]."""
    return 0.03 * np.sin(7 * q + 0.5)


# %% [markdown]
# Four logs of three seconds of the robot as it is, sampled at 250 Hz:

# %%
folder = Path(tempfile.mkdtemp())
(folder / "model.xml").write_text(MODEL)
model = mujoco.MjModel.from_xml_string(MODEL)
model.opt.timestep = 2e-4  # of reality
for i in range(4):
    rng = np.random.default_rng(i)
    time = np.arange(0, 3, 0.004)
    waves = np.sin(2 * np.pi * rng.uniform(0.3, 2.5, 3) * time[:, None] + rng.uniform(0, 6.28, 3))
    torque = waves @ rng.uniform(0.1, 0.3, 3)
    data, rows = mujoco.MjData(model), []
    for now in time:
        rows.append([*data.qpos, *data.qvel])
        while data.time < now + 0.004 - 1e-9:
            data.ctrl[:] = np.interp(data.time, time, torque)
            data.qfrc_applied[:] = hidden(data.qpos)
            mujoco.mj_step(model, data)
    measured = np.array(rows) + rng.normal(size=(len(rows), 2)) * [5e-4, 5e-3]
    table = np.column_stack([time, torque, measured])
    header = "time,ctrl/hinge,qpos/hinge,qvel/hinge"
    np.savetxt(folder / f"swing{i}.csv", table, delimiter=",", header=header, comments="")

# %% [markdown]
# One command, `uv run python -m btr_mjx.diagnose FOLDER`, or as a function:

# %%
run = folder / "run"
result = diagnose(dataset=folder, out=run, progress=False, figures=False)
print(result["sentence"])
print(result["effects"][0]["latex"])
assert result["effects"][0]["effect"] == "law_ripple"

# %% [markdown]
# Held-out recordings confirm a law as they confirm a name of the library, and its numbers have intervals:

# %%
for name, number in result["effects"][0]["parameters"].items():
    print(f"{name:8} {number['value']:8.4f}  [{number['low']:.4f}, {number['high']:.4f}] {number['unit']}")

# %% [markdown]
# The page draws the force that the believed model lacks against what it depends on, from joint_forces.npz:

# %%
with np.load(run / "joint_forces.npz") as forces:
    q, missing, left, law = (forces[f"{name}_0"] for name in ("position", "before", "after", "law"))
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(q, missing, ".", color="0.6", ms=3, label="missing")
axes.plot(q, left, ".", ms=2, label="left")
at = np.argsort(q)
axes.plot(q[at], law[at], lw=2, label="law")
axes.set(xlabel="position [rad]", ylabel="force [N m]")
axes.legend()
plt.show()

# %% [markdown]
# `mended.json` plays the law in any simulation:

# %%
mended = mujoco.MjModel.from_xml_path(str(run / "mended.xml"))
play, data = Callback(mended, json.loads((run / "mended.json").read_text())["terms"]), mujoco.MjData(mended)
for q in (-0.4, 0.0, 0.4):
    data.qpos[:] = q
    play(mended, data)
    print(f"q = {q:4.1f}: {data.qfrc_applied[0]:8.4f} N m, hidden {hidden(q):8.4f} N m")
    assert abs(data.qfrc_applied[0] - hidden(q)) < 0.006

# %% [markdown]
# What a law cannot say is its cause, and beyond the recorded range it is a guess. Where nothing fits, the verdict stays
# "unexplained"; `--residual` then adds [a table](../effects.md#a-table-of-what-nothing-explains).
