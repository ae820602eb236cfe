# %% [markdown]
# # A robot in the next room
#
# The robot is not in this process: trials are written into a folder, and measurements are read from it. Whoever tries
# them, a person or another program, needs to know nothing else. Here `examples/robot_in_the_next_room.py` plays the
# robot, an arm that swings a ball to a point; its ball is heavier, and its elbow has more damping, than believed.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

import btr_mjx as btr
from btr_mjx.backtoreality import Waiting

folder = Path(tempfile.mkdtemp())
settings = {
    "robot": Path("examples/thrower"),
    "reality": "folder",
    "exchange": folder / "exchange",
    "out": folder / "run",
    "iterations": 2,
    "trials": 6,
    "figures": False,
    "progress": False,
}

# %% [markdown]
# The first call evolves controllers in the believed simulation, writes what is to be tried, and ends by saying what it
# waits for. (The command says the same and ends; with `--wait` it stays.)

# %%
try:
    btr.coevolve(**settings)
except Waiting as waiting:
    print(str(waiting).replace(str(folder), "..."))
print(sorted(str(path.relative_to(folder)) for path in folder.glob("exchange/*/*"))[:4])

# %% [markdown]
# The reference signal of a trial is a table: time, and a column for each motor.

# %%
signal = next(iter(sorted(folder.glob("exchange/signals/*.csv"))))
print(*signal.read_text().splitlines()[:4], sep="\n")

# %% [markdown]
# Measure, and continue, until nothing is asked for any more.

# %%
result = None
while result is None:
    robot = [sys.executable, "examples/robot_in_the_next_room.py", str(settings["exchange"]), "--once"]
    print(subprocess.run(robot, capture_output=True, text=True, check=True).stdout.strip())
    try:
        result = btr.coevolve(**settings, resume=True)
    except Waiting:
        pass
print(*sorted(folder.glob("exchange/measured/*.csv"))[0].read_text().splitlines()[:3], sep="\n")

# %% [markdown]
# The mass of the robot's ball is 0.4 kg and the damping of its elbow 0.7 N m s/rad; the model believed 0.15 and 0.2.

# %%
print({name: round(value, 3) for name, value in result["simulation"].items()})
print(f"Delta_fitness {result['delta_fitness_first']:.4f} -> {result['delta_fitness_last']:.4f} m")
assert abs(result["simulation"]["ball mass"] - 0.4) < 0.05
