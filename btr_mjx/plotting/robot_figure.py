"""Figure of the robot in its default posture with the morphologies of a run side by side; Fig. 1 of the paper."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from matplotlib.figure import Figure

from btr_mjx.models import compile_models
from btr_mjx.plotting.camera import camera_for
from btr_mjx.plotting.rendering import render
from btr_mjx.plotting.run_data import RunData
from btr_mjx.robots import Robot

WIDTH, HEIGHT = 640, 560
"""Size of a picture [pixels]."""

UNKNOWN = (0.97, 0.80, 0.30, 1.0)
"""Colour of geoms whose size is searched: lighter than the others, also in grey scale."""


def morphologies(robot: Robot, run: RunData) -> Figure | None:
    """Pictures of the nominal, the identified and (where known) the true morphology, to the same scale.

    None on a machine that renders nothing.
    """
    nominal = robot.nominal_simulation
    # Numbers of effects that were added to the simulator change no shape.
    own = [i for i, name in enumerate(run.box.names) if name in robot.simulation_box.names]
    names, indices = [run.box.names[i] for i in own], robot.simulation_box.indices(run.box.names[i] for i in own)
    truth = run.truth[own] if run.truth is not None and np.isfinite(run.truth[own]).all() else None
    shown = {"nominal": nominal[indices], "identified": run.identified[own], "reality": truth}
    cases = {title: values for title, values in shown.items() if values is not None}
    models = []
    for values in cases.values():
        simulation = nominal.copy()
        simulation[indices] = values
        models.append(compile_models(robot, simulation).row(0))
    highlight(robot, models, indices)
    pictures = render(
        [(model, model.qpos0[None]) for model in models], WIDTH, HEIGHT, camera_for(models, WIDTH / HEIGHT)
    )
    if pictures is None:
        return None
    columns, size = (2, 8.5) if run.box.n <= 4 else (3, 7.5)
    figure = Figure(figsize=(3.3 * len(cases), 3.2 + 0.18 * math.ceil(run.box.n / columns)))
    panels = figure.subplots(1, len(cases), squeeze=False)[0]
    for axes, (title, values), picture in zip(panels, cases.items(), pictures, strict=True):
        axes.imshow(picture[0], interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(title, fontsize=11)
        units = [f" {run.box.units[i]}" if run.box.units[i] else "" for i in own]
        told = names if title != "identified" else run.result.get("told", {}).get("told", names)
        lengths = [
            f"{n}: {v:.2f}{unit}" if n in told else f"{n}: not told"
            for n, v, unit in zip(names, values, units, strict=True)
        ]
        lines = [",  ".join(lengths[i : i + columns]) for i in range(0, len(lengths), columns)]
        axes.text(0.5, -0.03, "\n".join(lines), transform=axes.transAxes, ha="center", va="top", fontsize=size)
    return figure


def highlight(robot: Robot, models: Sequence[mujoco.MjModel], indices: np.ndarray) -> None:
    """Colour the geoms of a robot's models whose size depends on some parameters, by index (k,), in place."""
    searched = _searched_geoms(robot, indices)
    for model in models:
        model.geom_rgba[searched] = UNKNOWN
        model.geom_matid[searched] = -1


def _searched_geoms(robot: Robot, indices: np.ndarray) -> np.ndarray:
    """Ids of the geoms whose size depends on the unknown parameters."""
    low, high = robot.nominal_simulation, robot.nominal_simulation
    low[indices], high[indices] = robot.simulation_box.low[indices], robot.simulation_box.high[indices]
    sizes = [compile_models(robot, values).row(0).geom_size for values in (low, high)]
    return np.flatnonzero((sizes[0] != sizes[1]).any(axis=1))
