# %% [markdown]
# # A robot of your own
#
# A robot is an MJCF and a robot.toml that says what is unknown of it and what a controller can ask of it. Here: a
# worm of three links that pushes itself along; how far the ground slopes and how strong the motors are is not known.

# %%
import tempfile
from pathlib import Path

import numpy as np

import btr_mjx as btr

folder = Path(tempfile.mkdtemp())
(folder / "robot.xml").write_text("""
<mujoco>
  <option timestep="0.002"/>
  <default>
    <geom type="capsule" size="0.02" density="600" friction="0.8"/>
    <joint axis="0 1 0" damping="0.05" armature="0.002"/>
    <position kp="25" kv="0.5" ctrlrange="-0.9 0.9"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="middle" pos="0 0 0.02">
      <freejoint/>
      <geom name="trunk" fromto="-0.06 0 0 0.06 0 0"/>
      <body pos="0.06 0 0"><joint name="front"/><geom name="head" fromto="0 0 0 0.1 0 0"/></body>
      <body pos="-0.06 0 0"><joint name="back"/><geom name="tail" fromto="0 0 0 -0.1 0 0"/></body>
    </body>
  </worldbody>
  <actuator><position name="front" joint="front"/><position name="back" joint="back"/></actuator>
</mujoco>""")
(folder / "robot.toml").write_text("""
model = "robot.xml"
duration = 1.5

[[parameter]]
name = "slope"
path = "option/gravity[0]"   # gravity along x
bounds = [-1.5, 1.5]
unit = "m/s^2"

[[parameter]]
name = "motor stiffness"
path = ["actuator:front/kp", "actuator:back/kp"]
bounds = [0.5, 1.5]
relative = true

[controller]
signal = "sinusoid"
frequency = [1.0, 4.0]
""")

# %%
robot = btr.load_robot(folder / "robot.toml")
print(robot.simulation_box.names, robot.controller_box.names)

# %% [markdown]
# The fitness is the distance from the start, over the duration. A scan of each unknown parameter tells whether
# trials feel it:

# %%
rng = np.random.default_rng(1)
controllers = robot.controller_box.sample(rng, 20)
fitness = btr.evaluate(robot, robot.nominal, controllers).fitness[0]
print("fitness of random controllers [m/s]:", np.sort(fitness.round(3))[-5:])
for name in robot.simulation_box.names:
    line = btr.scan.along(robot, name, 5)
    felt = np.ptp(btr.evaluate(robot, line, controllers).fitness, axis=0)
    print(f"{name}: changes the fitness by {np.median(felt):.3f} m/s in the median, {felt.max():.3f} at most")

# %% [markdown]
# Both are felt, so that Delta_fitness can find them. A hidden simulation plays reality:

# %%
result = btr.coevolve(
    robot=folder / "robot.toml",
    truth=("slope=0.8", "motor stiffness=1.3"),
    iterations=2,
    trials=8,
    controllers=24,
    controller_generations=4,
    out=folder / "run",
    figures=False,
    progress=False,
)
print({name: round(value, 3) for name, value in result["simulation"].items()})
assert abs(result["simulation"]["slope"] - 0.8) < 0.2
print(f"Delta_fitness {result['delta_fitness_first']:.4f} -> {result['delta_fitness_last']:.4f} m/s")

# %% [markdown]
# Other signals, fitness functions, targets, meshes and templates: [the file](../robot_file.md). Your robot may stand in
# the next room: [the next tutorial](next_room.md).
