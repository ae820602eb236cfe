# %% [markdown]
# # Co-evolve a controller and a simulation
#
# Back-to-Reality repeats three steps: evolve controllers in the best simulation so far; try the best of them in
# reality; evolve simulations until they predict what was measured. Here a hidden simulation of the hexapod plays
# reality: a femur and a tibia have other lengths than the first simulation believes.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import btr_mjx as btr

out = Path(tempfile.mkdtemp()) / "run"
result = btr.coevolve(
    preset="quick",
    iterations=2,
    trials=8,
    controllers=32,
    controller_generations=4,
    out=out,
    figures=False,
    progress=False,
)

# %% [markdown]
# `result` is what the run folder holds as result.json. The simulation that was found, beside the truth:

# %%
for name, value in result["simulation"].items():
    print(f"{name:6} found {value:.3f} m, truth {result['truth'][name]:.3f} m")
print(f"Delta_fitness {result['delta_fitness_first']:.3f} -> {result['delta_fitness_last']:.3f} m/s")
assert result["parameter_error_last"] < 0.05

# %% [markdown]
# trials.npz holds every trial: the fitness that the simulation of that time predicted, $f_{s,k}$, and the fitness that
# was measured, $f_{r,k}$. The gap closes from one iteration to the next.

# %%
with np.load(out / "trials.npz") as trials:
    f_s, f_r, iteration = trials["f_s"], trials["f_r"], trials["iteration"]
figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
for i in np.unique(iteration):
    own = iteration == i
    axes.scatter(f_s[own], f_r[own], label="the start" if i == 0 else f"iteration {i}")
axes.axline((0, 0), slope=1, color="0.7", lw=1, zorder=0)
axes.set(xlabel="predicted fitness [m/s]", ylabel="measured fitness [m/s]")
axes.legend()
plt.show()

# %% [markdown]
# As a command, with a page, figures and a film:
#
#     uv run python -m btr_mjx.coevolve --out runs/quick
#     uv run python -m btr_mjx.replay runs/quick
#
# [All settings and pictures](../coevolution.md); [the equations](../method.md).
