"""Minimal version of Fig. 2b: `uv run python experiments/scan_bl14.py`, or paste it into a notebook.

Scans the length of the left rear tibia, bl_14, over 49 simulations with 15 evolved behaviours and draws Delta_fitness
with its components delta_k. The data are saved beside the figure.
"""

from pathlib import Path

import btr_mjx as btr
from btr_mjx.backtoreality import SearchSettings, evolve_controllers, select_transferable
from btr_mjx.plotting import draw_scan
from btr_mjx.runs import write_arrays, write_json


def main(out: Path = Path("runs/fig2b")) -> None:
    """Compute, save, draw."""
    robot = btr.hexapod()
    line = btr.scan.along(robot, "bl_14", 49)  # (49, 12) simulations that differ in bl_14
    reality = btr.scan.along(robot, "bl_14", [1.6])
    # Step 1 of Back-to-Reality in the simulation with the shortest leg; its 15 best controllers.
    genomes, fitness = evolve_controllers(robot, line[0], SearchSettings(population=60, generations=10), seed=0)
    best, _ = select_transferable(genomes, fitness, 15, maximise=True)
    controllers = robot.controller_box.decode(best)
    # Step 2: their fitness in reality. Then the scan, 49 x 15 pairs in one compiled program.
    f_r = btr.evaluate(robot, reality, controllers).fitness[0]
    delta = btr.scan.delta(robot, line, controllers, f_r)
    curve, grid = delta.mean(axis=1), line[:, robot.simulation_box.index("bl_14")]
    arrays = {"parameter": "bl_14", "grid": grid, "truth": 1.6, "delta": delta, "delta_fitness": curve, "f_r": f_r}
    write_arrays(out / "scan.npz", arrays)
    units = {"parameter_unit": "m", "fitness_unit": "m/s"}
    write_json(out / "result.json", btr.scan.curve_statistics(grid, curve, 1.6) | units)
    draw_scan(out)
    print(f"Spearman's rho {btr.scan.curve_statistics(grid, curve, 1.6)['spearman']:.3f}; files in {out}")


if __name__ == "__main__":
    main()
