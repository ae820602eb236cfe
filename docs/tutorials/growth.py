# %% [markdown]
# # A simulator that grows
#
# The shoulder of this arm has dry friction, which no value of the two unknown parameters (ball mass, elbow damping)
# explains; they have other values there as well. With `grow` the missing effect is sought where the best simulation
# leaves more of Delta_fitness than errors of calibration do, and its size becomes a new dimension of the space of
# simulations.

# %%
import tempfile
from pathlib import Path

import btr_mjx as btr

settings = {
    "robot": Path("examples/thrower"),
    "reality_model": Path("examples/thrower/worn.xml"),
    "iterations": 2,
    "trials": 8,
    "figures": False,
    "progress": False,
}
out = Path(tempfile.mkdtemp())
fixed = btr.coevolve(**settings, out=out / "fixed")
grown = btr.coevolve(**settings, out=out / "grown", grow=True)

# %% [markdown]
# What was found at each iteration. The first Delta_fitness is larger than small errors of calibration leave, so that an
# effect is sought; the second is within them.

# %%
for row in grown["growth"]:
    print(
        row["iteration"], f"{row['delta_before']:.4f} m, calibration leaves {row['calibration']:.4f} m:", row["verdict"]
    )
assert "dry_friction" in grown["effects"][0]["effect"]

# %%
for name, result in {"fixed": fixed, "grown": grown}.items():
    found = ", ".join(f"{unknown} {value:.3f}" for unknown, value in result["simulation"].items())
    print(f"{name}: Delta_fitness {result['delta_fitness_last']:.4f} m at {found}")

# %% [markdown]
# How often the right effect is added: [how well it works](../gap_measured.md).
