# %% [markdown]
# # Scan one unknown
#
# How does Delta_fitness change along one parameter of the simulation, and does its minimum lie at the truth? The robot
# is the hexapod of the paper: 12 limb lengths are its simulation *s*, 36 amplitudes and phases its controller *c*.

# %%
import matplotlib.pyplot as plt
import numpy as np

import btr_mjx as btr

robot = btr.hexapod()
print(*robot.simulation_box.names, robot.controller_box.n)

# %% [markdown]
# `evaluate` computes the fitness of all pairs: here 3 simulations and 15 controllers, drawn at random. The first call
# compiles the program, which takes some seconds; it then serves any number of pairs.

# %%
rng = np.random.default_rng(0)
controllers = robot.controller_box.sample(rng, 15)  # (15, 36)
simulations = robot.simulation_box.sample(rng, 3)  # (3, 12)
evaluation = btr.evaluate(robot, simulations, controllers)
evaluation.fitness.shape, evaluation.fitness.round(2)[:, :5]  # [m/s]

# %% [markdown]
# Reality is hidden from the search. Here it is a simulation as well: the tibia `bl_14` is 1.6 m long. Of each trial one
# number is known, the measured fitness $f_{r,k}$.

# %%
reality = btr.scan.along(robot, "bl_14", [1.6])  # (1, 12): all other lengths are nominal
f_r = btr.evaluate(robot, reality, controllers).fitness[0]  # (15,)

line = btr.scan.along(robot, "bl_14", 25)  # (25, 12), over the range of bl_14
f_s = btr.evaluate(robot, line, controllers).fitness  # (25, 15)
delta = np.abs(f_s - f_r)  # delta_k, (25, 15)
delta_fitness = btr.scan.delta_fitness(robot, line, controllers, f_r)  # (25,)
assert np.allclose(delta_fitness, delta.mean(axis=1))

# %%
grid = line[:, robot.simulation_box.names.index("bl_14")]
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(grid, delta, color="0.8", lw=0.8)
axes.plot(grid, delta_fitness, color="C0", lw=2.5, label="Delta_fitness")
axes.axvline(1.6, color="C3", ls=":", label="reality")
axes.set(xlabel="bl_14 [m]", ylabel="delta_k, Delta_fitness [m/s]")
axes.legend()
plt.show()

# %% [markdown]
# A single delta_k (grey) may touch zero away from the truth; their mean does so at the truth only. Below about 1.1 m
# the foot does not reach the ground, so that the length hardly matters: a plateau.

# %%
best = grid[np.argmin(delta_fitness)]
assert best == 1.6
print(f"least Delta_fitness {delta_fitness.min():.3g} m/s at bl_14 = {best:.2f} m")

# %% [markdown]
# The same as a command, with a run folder that a killed scan continues from:
#
#     uv run python -m btr_mjx.scan --parameter bl_14 --grid 49 --out runs/scan
#
# More: [the function `evaluate`](../api/btr_mjx.md), [scans on a cluster](../scaling.md),
# [the paper's scans](../gallery/claims.md).
