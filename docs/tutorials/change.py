# %% [markdown]
# # What has changed since yesterday
#
# Nobody has calibrated this arm: its masses, its motors and its damping are not quite those of the model. It was
# recorded yesterday, and again today, after a fall. What is different since?

# %%
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.diagnose import diagnose

MODEL = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.015" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="30" kv="1.5"/>
    <position name="elbow" joint="elbow" kp="15" kv="0.8"/>
  </actuator>
</mujoco>"""


def robot(strength: float) -> mujoco.MjModel:
    """The robot as it is, with the strength of the elbow's motor in units of yesterday's."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.opt.timestep = 2e-4
    model.body_mass[1:] *= [1.05, 0.96]
    model.body_inertia[1:] *= [[1.05], [0.96]]
    for gain in (model.actuator_gainprm, model.actuator_biasprm):
        gain[:] *= [[1.03], [1.04 * strength]]
    model.dof_damping[:] = [0.16, 0.07]
    return model


def record(folder: Path, model: mujoco.MjModel, seed: int) -> None:
    """Three logs of three seconds at 250 Hz; motions are new each time."""
    folder.mkdir()
    (folder / "model.xml").write_text(MODEL)
    rng, time = np.random.default_rng(seed), np.arange(0, 3, 0.004)
    for i in range(3):
        phase = 2 * np.pi * (rng.uniform(0.2, 1.5, (4, 2)) * time[:, None, None] + rng.uniform(0, 1, (4, 2)))
        command = (np.sin(phase) * rng.uniform(0.1, 0.4, (4, 2))).sum(1)
        data, rows = mujoco.MjData(model), []
        for now in time:
            rows.append([*data.qpos, *data.qvel])
            while data.time < now + 0.004 - 1e-9:
                data.ctrl[:] = [np.interp(data.time, time, own) for own in command.T]
                mujoco.mj_step(model, data)
        measured = np.array(rows) + rng.normal(size=(len(rows), 4)) * [5e-4, 5e-4, 5e-3, 5e-3]
        header = "time,ctrl/shoulder,ctrl/elbow,qpos/shoulder,qpos/elbow,qvel/shoulder,qvel/elbow"
        table = np.column_stack([time, command, measured])
        np.savetxt(folder / f"motion{i}.csv", table, delimiter=",", header=header, comments="")


runs = Path(tempfile.mkdtemp())
record(runs / "yesterday", robot(1.0), seed=1)
record(runs / "today", robot(0.94), seed=2)

# %% [markdown]
# Alone, the recordings of today say what the motor is beside the model, not what it has lost:

# %%
alone = diagnose(dataset=runs / "today", out=runs / "alone", progress=False, figures=False)
print(alone["sentence"])

# %% [markdown]
# Beside those of yesterday, calibration is the same in both sets and cancels. This is
# `uv run python -m btr_mjx.diagnose today --before yesterday`:

# %%
both = diagnose(
    dataset=runs / "today", before=(runs / "yesterday",), out=runs / "change", progress=False, figures=False
)
print(both["sentence"])
change = both["effects"][0]
assert change["effect"] == "actuator_gain"
numbers = change["parameters"]  # of the elbow alone, or of both joints, each with its own number
elbow = numbers["change"] if change["location"] == "actuator:elbow" else numbers["change[elbow]"]
assert abs(elbow["value"] + 0.06) < 0.012

# %% [markdown]
# What yesterday's recordings say is kept beside it, and `sets.csv` has the numbers of every set beside the model. With
# `--before` several times, the oldest first, it is a curve of wear ([What has changed](../changes.md)).

# %%
print(both["before"]["sentence"])
print((runs / "change" / "sets.csv").read_text())
