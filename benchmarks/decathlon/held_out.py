"""One held-out curve of each machine: chosen by one rule, kept as arrays, then drawn.

The stretch is that with the median error of the mended model, of the believed one where there is no mended one; the
coordinate is the one of those that count that moves most in it.
"""

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import mujoco
import numpy as np
from machine import FREE, Machine
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from open_loop import Predictor, Stretch

from btr_mjx.plotting import style
from btr_mjx.runs import read_arrays, write_arrays

LOOKS: Mapping[str, tuple[str, dict[str, Any]]] = {
    "steady": ("constant velocity", {"color": "C4", "linestyle": (0, (1, 1.2))}),
    "believed": ("believed", {"color": "C2", "linestyle": (0, (4, 2))}),
    "mended": ("mended", {"color": "C1", "linestyle": "-"}),
}
"""Label and line of each prediction; dots, dashes and solid lines distinguish them in grey as well."""
LONGEST = 30.0
"""Time that a picture shows at most [s]; the arrays have all of it."""
MARGIN, ROOM = 0.25, 3.0
"""Room beside the measured range, as a share of it; range of the differences, in largest ones of the mended model."""
MARKS = 100
"""Measured samples that are marked, about."""
PLACES = re.compile(r"(\d{1,4}\.\d{2})\d+(?=[ \n\"])")
"""Coordinates of an SVG, with the decimals that nobody sees."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A coordinate over a held-out stretch.

    Attributes:
      recording: its name.
      start: time in the recording at which the stretch begins [s].
      coordinate: name of the joint, with its part where it is free.
      unit: of the coordinate.
      time: (K,) since the start [s].
      measured: (K,) data.
      predicted: (K,) predictions by the names of `LOOKS`.
    """

    recording: str
    start: float
    coordinate: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    predicted: Mapping[str, np.ndarray]


def median_place(errors: Sequence[float] | np.ndarray) -> int:
    """Place of the median error, of the smaller one where two are in the middle."""
    return int(np.argsort(errors, kind="stable")[(len(errors) - 1) // 2])


def coordinates(machine: Machine, model: mujoco.MjModel) -> dict[str, int]:
    """Columns of the coordinates that count by name: of qpos, or of qvel where spin is measured."""
    if machine.measure == "spin":
        return {f"{model.joint(0).name} {FREE['qvel'][k]}": k for k in (3, 4, 5)}
    out = {}
    for dof in machine.dofs or range(model.nv):
        joint = model.joint(int(model.dof_jntid[dof]))
        place = int(joint.qposadr[0]) + dof - int(joint.dofadr[0])
        free = joint.type[0] == mujoco.mjtJoint.mjJNT_FREE
        if not free or dof - int(joint.dofadr[0]) < 3:  # a rotation is no single number
            out[f"{joint.name} {FREE['qpos'][place]}" if free else str(joint.name)] = place
    return out


def curve(machine: Machine, model: mujoco.MjModel, stretch: Stretch, predictors: Mapping[str, Predictor]) -> Curve:
    """The curve of a stretch.

    Args:
      machine: says what counts.
      model: believed model.
      stretch: recording, first and last sample.
      predictors: by the names of `LOOKS`.
    """
    log, first, last = stretch
    kind = int(machine.measure == "spin")
    measured = np.asarray((log.qpos, log.qvel)[kind])[first : last + 1]
    name, place = max(coordinates(machine, model).items(), key=lambda item: float(np.ptp(measured[:, item[1]])))
    predicted = {key: predict(log, first, last)[kind][:, place] for key, predict in predictors.items()}
    since = log.time[first : last + 1] - log.time[first]
    return Curve(log.name, float(log.time[first]), name, machine.unit, since, measured[:, place], predicted)


def save(found: Curve, path: Path) -> None:
    """Write a curve as `.npz`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = {key: np.array(getattr(found, key)) for key in ("recording", "start", "coordinate", "unit")}
    write_arrays(path, {**text, "time": found.time, "measured": found.measured, **found.predicted}, compress=True)


def read(path: Path) -> Curve:
    """Read a curve."""
    arrays = read_arrays(path)
    recording, coordinate, unit = (str(arrays[key]) for key in ("recording", "coordinate", "unit"))
    predicted = {key: arrays[key] for key in LOOKS if key in arrays}
    start, time, measured = float(arrays["start"]), arrays["time"], arrays["measured"]
    return Curve(recording, start, coordinate, unit, time, measured, predicted)


def picture(found: Curve) -> Figure:
    """The curve, and beside it the differences from the data; models that diverge leave the axes."""
    shown = found.time <= LONGEST
    time, measured = found.time[shown], found.measured[shown]
    figure = Figure(figsize=(7.2, 2.1))
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1])
    every = math.ceil(len(time) / MARKS)
    left.plot(time[::every], measured[::every], ".", color="C0", markersize=2.8, label="measured", zorder=3)
    right.axhline(0.0, color="0.7", linewidth=0.6)
    low, high = float(measured.min()), float(measured.max())
    span, sizes = high - low, {}
    for key, values in found.predicted.items():
        # Values far outside would only make the file long.
        values = np.clip(np.nan_to_num(values[shown], nan=np.inf), low - 9 * span, high + 9 * span)
        label, look = LOOKS[key]
        left.plot(time, values, linewidth=1.1, label=label, **look)
        right.plot(time, values - measured, linewidth=0.9, **look)
        sizes[key] = float(np.max(np.abs(values - measured)))
    limit = min(span, ROOM * sizes.get("mended", min(sizes.values())))
    left.set_ylim(low - MARGIN * span, high + MARGIN * span)
    right.set_ylim(-limit, limit)
    left.set_ylabel(f"{found.coordinate} [{found.unit}]")
    right.set_title(f"predicted − measured [{found.unit}]", loc="left", fontsize=8)
    for panel in (left, right):
        panel.set_xlabel("time [s]")
        panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        panel.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


def draw(source: Path, target: Path) -> None:
    """Draw a saved curve as SVG; equal arrays give equal files."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with style(), matplotlib.rc_context({"svg.hashsalt": "curve", "path.simplify_threshold": 0.3}):
        buffer = io.StringIO()
        picture(read(source)).savefig(buffer, format="svg", metadata={"Date": None})
    target.write_text(PLACES.sub(r"\1", buffer.getvalue()))
