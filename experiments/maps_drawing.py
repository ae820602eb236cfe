"""Figure of the maps of `maps.py`."""

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from drawing import letter
from maps_tasks import Choice
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import LogLocator, NullFormatter

LOOKS = [("o", "-", "full"), ("s", "--", "none"), ("^", ":", "full"), ("D", "-.", "none"), ("v", "-", "none")]
"""Marker, line and filling of a panel's lines."""

Rows = Sequence[dict[str, Any]]


def error_line(axes: Axes, x: Sequence[float], rows: Rows, label: str, look: tuple[str, str, Any]) -> None:
    """Medians with intervals."""
    marker, line, filling = look
    middle = np.array([row["estimate"] for row in rows])
    ends = np.array([[row["low"], row["high"]] for row in rows]).T
    error = np.abs(np.where(np.isfinite(ends), ends, middle) - middle)
    axes.errorbar(
        x, middle, error, color="black", lw=1, capsize=2, label=label, marker=marker, linestyle=line, fillstyle=filling
    )


def named(summary: Mapping[str, Rows], head: str, tail: str = "") -> list[tuple[float, dict[str, Any]]]:
    """The number between head and tail in the names of a summary, and the first row there, in order."""
    inside = [(name[len(head) : len(name) - len(tail)], rows[0]) for name, rows in summary.items()
              if name.startswith(head) and name.endswith(tail)]  # fmt: skip
    numbers = [(float(text), row) for text, row in inside if text.replace(".", "", 1).isdigit()]
    return sorted(numbers, key=lambda pair: pair[0])


def noise_levels(summary: Mapping[str, Rows], head: str) -> list[float]:
    """Noises [%] in the names of a summary that begin with `head`, in order."""
    return sorted({float(n.rpartition("noise")[2]) for n in summary if n.startswith(head) and "-noise" in n})


def over(axes: Axes, points: Sequence[tuple[float, dict[str, Any]]], label: str, look: tuple[str, str, Any]) -> None:
    """A line over a logarithmic axis, ticks where the points are."""
    if points:
        x = [value for value, _ in points]
        error_line(axes, x, [row for _, row in points], label, look)
        axes.set(xscale="log", xticks=x, xticklabels=[f"{value:g}" for value in x])
        axes.minorticks_off()


def fill(figure: Figure, panels: Sequence[Axes], summary: Mapping[str, Rows]) -> int:
    """Draw all panels; those whose map was not computed are removed, and the others move up.

    Returns:
      The number of panels left.
    """
    kinds = [(f"-noise{noise:g}", f"noise {noise:g} %") for noise in noise_levels(summary, "m")] + [
        ("-native", "other physics")
    ]
    for (end, label), look in zip(kinds, LOOKS, strict=False):
        over(panels[0], named(summary, "m", end), label, look)
    for noise, look in zip(noise_levels(summary, "horizon"), LOOKS, strict=False):
        over(panels[1], named(summary, "horizon", f"-noise{noise:g}"), f"noise {noise:g} %", look)
        for row in summary.get(f"curriculum-noise{noise:g}", ())[:1]:
            axis = panels[1].axhline(row["estimate"], color="0.5", lw=1, linestyle=look[1])
            axis.set_label(f"curriculum, {noise:g} %")
    over(panels[2], named(summary, "marks"), "", LOOKS[0])
    over(panels[3], named(summary, "p_m"), "mutants", LOOKS[0])
    for row in summary.get("p_m-random", ())[:1]:
        panels[3].axhline(row["estimate"], color="0.5", lw=1, label="random")
    for i, (choice, look) in enumerate(zip(get_args(Choice), LOOKS, strict=False)):
        rows = summary.get(f"choice-{choice}", [])
        if rows:
            m = [row["m"] for row in rows]
            # Slightly displaced, so that intervals do not overlap.
            error_line(panels[4], [value + 0.3 * (i - 1) for value in m], rows, choice, look)
            panels[4].set(xticks=m, xticklabels=[f"{value:g}" for value in m])
    values = np.sort(summary["truth"][0]["values"]) if "truth" in summary else np.zeros(0)
    if len(values):
        panels[5].plot(values, (np.arange(len(values)) + 1) / len(values), "k.-", drawstyle="steps-post")
        panels[5].set(xscale="log")
        panels[5].xaxis.set_minor_formatter(NullFormatter())
    panels[5].set(ylim=(0, 1.05), ylabel="share of truths", xlabel="mean error of lengths [m]")
    titles = ("behaviours", "horizon", "marks", "diversity", "choice", "random truths")
    below = ("$m$", "last mark [s]", "marks", "$p_m$", "trials in reality")
    for axes, name, text in zip(panels, "abcdef", titles, strict=True):
        letter(axes, name, text)
    for axes, words in zip(panels, below, strict=False):
        axes.set(xlabel=words, ylabel="mean error of lengths [m]")
        if axes.lines:
            axes.set(yscale="log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
            if axes is not panels[2]:
                axes.legend(fontsize=7)
    left = [axes for axes in panels if axes.lines]
    for axes in panels:
        if not axes.lines:
            axes.remove()
    grid = GridSpec(-(-len(left) // 3), min(len(left), 3), figure=figure)
    for place, axes in enumerate(left):
        axes.set_subplotspec(grid[divmod(place, 3)])
    return len(left)
