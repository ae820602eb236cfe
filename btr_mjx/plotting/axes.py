"""Common parts of the figures: axes of generations grouped by iteration, axis scales, legends."""

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
"""Text properties of annotations along the upper edge of the axes."""


MOST_NAMES = 10
"""Iterations that are named along an axis, at most."""


def figure_width(searches: Sequence[Search], per_generation: float) -> float:
    """Width of a figure by its number of generations, limited to the width of a page [inch]."""
    return float(np.clip(2.6 + per_generation * sum(len(search.scores) for search in searches), 5.6, 9.0))


def search_spacing(searches: Sequence[Search]) -> float:
    """Horizontal space between two searches [generations], where the state before the next one is marked."""
    return max(1.0, 0.03 * sum(len(search.scores) for search in searches))


def block_offsets(searches: Sequence[Search], spacing: float, first: float) -> list[float]:
    """Offset of each iteration on the x axis [generations]; its generations are at offset + 1, offset + 2, ...

    `spacing` is added between the last generation of a block and the first of the next, beyond the usual 1; `first` is
    the offset of the first block, where the state before the run is at 0.
    """
    lengths = [len(search.scores) + spacing for search in searches]
    return [first, *(first + np.cumsum(lengths[:-1])).tolist()]


def generation_axis(
    axes: Axes, searches: Sequence[Search], offsets: list[float], spacing: float, border: float, sides: str = "tb"
) -> None:
    """Name the iterations along the top ("t" in `sides`), number the last generation of each, label the axis ("b").

    Offsets and spacing are those of `block_offsets`, `border` is a block's left border relative to its offset.
    """
    count, lengths = len(searches), [len(search.scores) for search in searches]
    shown = range(0, count, math.ceil(count / MOST_NAMES))
    for i in shown if "t" in sides else ():
        text = f"iteration {searches[i].iteration}" if count <= MOST_NAMES / 2 else str(searches[i].iteration)
        text += ", grown" if searches[i].part > 1 else ""
        middle = offsets[i] + border + (lengths[i] + spacing) / 2
        axes.annotate(text, (middle, 1), xycoords=("data", "axes fraction"), xytext=(0, 2), **ABOVE)
    for offset in offsets[1:]:
        axes.axvline(offset + border, color="0.8", linewidth=0.7, zorder=0)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks([offsets[i] + lengths[i] for i in shown], [str(lengths[i]) for i in shown])
    axes.set_xlim(-0.5 - 0.012 * sum(lengths), offsets[-1] + border + lengths[-1] + spacing + 0.1)
    if "b" in sides:
        axes.set_xlabel("generation")


def positive_scale(axes: Axes, values: np.ndarray) -> None:
    """Logarithmic y axis if values span more than a decade, linear from 0 below the smallest positive value."""
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
    """One legend for all panels, above them."""
    return figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=columns)
