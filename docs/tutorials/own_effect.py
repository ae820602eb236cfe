# %% [markdown]
# # An effect of your own
#
# The motor of a pendulum has cogging torque: its magnets hold it at seven positions a turn. No entry of the
# [library](../effects.md) says so; a term of the dictionary of laws [finds its equation](law.md). Who knows more, here
# the number of poles and their phase, writes it as an effect of its own with one number. An effect is data: a name, its
# places in a model, its parameters with ranges, and one edit of a simulated world, which the search, the mended model
# and Back-to-Reality use alike.

# %%
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.gap.data import make_recording, open_dataset, save_dataset
from btr_mjx.gap.effects import EFFECTS, Effect, Parameter, joint_places
from btr_mjx.gap.inference import identify
from btr_mjx.gap.results import as_result, verdict_sentence

MODEL = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2"/>
    </body>
  </worldbody>
  <actuator><motor name="hinge" joint="hinge"/></actuator>
</mujoco>"""
POLES, COGGING = 7, 0.03  # the second is hidden [N m]

# %% [markdown]
# Four recordings of three seconds of a robot that has this torque, sampled at 250 Hz:

# %%
model = mujoco.MjModel.from_xml_string(MODEL)
model.opt.timestep = 2e-4  # of reality
recordings = []
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
            data.qfrc_applied[:] = COGGING * np.sin(POLES * data.qpos)
            mujoco.mj_step(model, data)
    measured = np.array(rows) + rng.normal(size=(len(rows), 2)) * [5e-4, 5e-3]
    columns = {"time": time, "ctrl/hinge": torque, "qpos/hinge": measured[:, 0], "qvel/hinge": measured[:, 1]}
    recording = make_recording(columns, model, "tutorial", f"swing{i}")
    recordings.append(recording.part(slice(None), "fit" if i < 3 else "test", recording.name))
folder = Path(tempfile.mkdtemp())
save_dataset(folder, MODEL, recordings)
dataset = open_dataset(folder)

# %% [markdown]
# The effect. MuJoCo has no field for it, so that it is a *law*: a term that is called before every step, with the
# rows of its world in the batch. (What a field of MjModel can say is an edit of one line, [as here](../effects.md).)
# Its range follows the data: `scales` has the peak torque of each joint.


# %%
class Cogging:
    """A torque that repeats along a turn."""

    fields = ()  # MjModel fields that it writes between steps

    def __init__(self, place, model, size):
        self.dofs, self.size = place.dofs(model), size
        self.positions = model.jnt_qposadr[list(place.joints)]

    def __call__(self, rows):
        """Add to the applied force of the next step."""
        rows.qfrc_applied[:, self.dofs] += self.size * np.sin(POLES * rows.qpos[:, self.positions])


def ranges(model, scales, place):
    """Up to the peak torque."""
    most = scales.torque[place.dofs(model)].mean()
    return (Parameter("torque", "N m", -most, most, 0.02 * most),)


def edit(world, place, values):
    """Add the law."""
    world.laws.append(Cogging(place, world.model, values[0]))


mine = Effect("cogging", joint_places, ranges, edit, equation="τ = A sin(7 q)")
diagnosis = identify(dataset, (*EFFECTS, mine))
print(verdict_sentence(as_result(diagnosis, dataset)))
assert diagnosis.effects[0].effect == "cogging"

# %% [markdown]
# In a command: `uv run python -m btr_mjx.diagnose DATASET --effects all FILE.py:mine`.
