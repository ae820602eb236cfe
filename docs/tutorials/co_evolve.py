# %% [markdown]
# # Co-evolve a controller and a simulation
#
# Back-to-Reality repeats three steps: evolve controllers in the best simulation so far; try the best of them in reality;
# evolve simulations until they predict what was measured. Here a hidden simulation of the hexapod plays reality: two of
# its tibiae and femurs have other lengths than the first simulation believes.

# %%
import json
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

import btr_mjx as btr

out = Path(tempfile.mkdtemp()) / "run"
result = btr.coevolve(
    preset="quick", iterations=2, trials=8, controllers=32, controller_generations=4, out=out, progress=False
)

# %% [markdown]
# `result` is what the run folder holds as result.json. The simulation that was found, beside the truth:

# %%
for name, value in result["simulation"].items():
    print(f"{name:6} found {value:.3f} m, truth {result['truth'][name]:.3f} m")

# %% [markdown]
# One row an iteration: the fitness that the simulation predicted for the transferred controllers, and the fitness that
# they had in reality. The gap closes.

# %%
pl.Config.set_tbl_hide_dataframe_shape(True)
iterations = pl.read_parquet(out / "iterations.parquet")
iterations

# %% [markdown]
# The folder holds every trial, too, in a form that NumPy reads, and `report.html` for people.

# %%
with np.load(out / "trials.npz") as trials:
    print({name: trials[name].shape for name in trials.files})
sorted(path.name for path in out.iterdir())
