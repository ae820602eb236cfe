"""Axes of generations, iteration by iteration, and other parts that the figures share."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import NullLocator

from btr_mjx.plotting.run_data import Search

ABOVE: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "bottom", "fontsize": 8, "color": "0.3"}
"""How notes along the upper edge of the axes are set."""


def width(searches: Sequence[Search], per_generation: float) -> float:
    """Wide enough to tell generations apart, narrow enough for a page [inch]."""
    return float(np.clip(2.6 + per_generation * sum(len(search.scores) for search in searches), 5.6, 9.0))


def gap(searches: Sequence[Search]) -> float:
    """Room between two searches, in which the state before the next one is marked."""
    return max(1.0, 0.03 * sum(len(search.scores) for search in searches))


def blocks(searches: Sequence[Search], gap: float, first: float) -> list[float]:
    """Where each iteration begins; its generations stand at 1, 2, ... after that, then comes the gap.

    Args:
      searches: one per iteration.
      gap: width added between the last generation of a block and the first of the next, beyond the usual 1.
      first: the first block begins here; what was before the run stands at 0.
    """
    lengths = [len(search.scores) + gap for search in searches]
    return [first, *(first + np.cumsum(lengths[:-1])).tolist()]


def generation_axis(
    axes: Axes,
    searches: Sequence[Search],
    offsets: list[float],
    gap: float,
    border: float,
    most: int = 18,
    sides: str = "tb",
) -> None:
    """Number the generations of each iteration from 1, and the iterations along the top.

    Args:
      axes: where.
      searches: one per iteration.
      offsets: from `blocks`.
      gap: as given to `blocks`.
      border: where a block's left border lies, from its offset.
      most: about how many numbers there is room for.
      sides: with "t" iterations are named along the top, with "b" generations along the bottom.
    """
    total, count = sum(len(search.scores) for search in searches), len(searches)
    step = next(step for step in (1, 2, 5, 10, 20, 50, 100, 200, 500, total) if total / step <= most)
    places, names = [], []
    for i, (search, offset) in enumerate(zip(searches, offsets, strict=True)):
        last = len(search.scores)
        for generation in range(1, last + 1):
            if generation == last or (generation % step == 0 and last - generation >= 0.6 * step):
                places.append(offset + generation)
                names.append(str(generation))
        if "t" in sides and i % math.ceil(1.2 * count / most) == 0:
            text = f"iteration {search.iteration}" if count <= most / 3 else str(search.iteration)
            middle = offset + border + (last + gap) / 2
            axes.annotate(text, (middle, 1), xycoords=("data", "axes fraction"), xytext=(0, 2), **ABOVE)
    for offset in offsets[1:]:
        axes.axvline(offset + border, color="0.8", linewidth=0.7, zorder=0)
    crowded = count > most
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks([] if crowded else places, [] if crowded else names)
    axes.set_xlim(-0.5 - 0.012 * total, offsets[-1] + border + last + gap + 0.1)
    if "b" in sides:
        axes.set_xlabel(f"{len(searches[0].scores)} generations per iteration" if crowded else "generation")


def positive_scale(axes: Axes, values: np.ndarray) -> None:
    """A logarithmic axis where values span more than a decade; below the least positive one it is linear down to 0."""
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0]
    if not len(positive) or positive.max() <= 10 * positive.min():
        axes.set_ylim(bottom=0)
    elif (finite <= 0).any():
        axes.set_yscale("symlog", linthresh=10 ** math.floor(math.log10(positive.min())), linscale=0.5)
        axes.set_ylim(bottom=0)
    else:
        axes.set_yscale("log")


def legend_above(figure: Figure, axes: Axes, columns: int = 3) -> Legend:
    """One legend for all panels, where it hides no data."""
    return figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=columns)
