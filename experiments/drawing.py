"""Common parts of the experiments' figures, in the style of the package."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from btr_mjx.plotting import style
from btr_mjx.runs import write_figure


@contextmanager
def figure_of(width: float, height: float) -> Iterator[Figure]:
    """Context with an empty figure of a size [inch] in the common style; save the figure within the context."""
    with style():
        yield Figure(figsize=(width, height))


def save(figure: Figure, path: Path) -> Path:
    """Write a figure for print."""
    write_figure(path, figure, dpi=200)
    return path


def letter(axes: Axes, name: str, text: str) -> None:
    """Title of a panel: its letter in bold, then its content."""
    axes.set_title(rf"$\bf{{({name})}}$ {text}", loc="left", fontsize=8.5)


def shades(count: int, lightest: float = 0.82) -> list[str]:
    """`count` greys, from light to black."""
    return [str(grey) for grey in np.linspace(lightest, 0.0, count)]


def white_legend(axes: Axes, **options: Any) -> None:
    """A legend with a white background."""
    axes.legend(fontsize=7, frameon=True, facecolor="white", edgecolor="none", framealpha=0.85, **options)


def truth_line(axes: Axes, truth: float) -> None:
    """Mark reality."""
    axes.axvline(truth, color="#c8641e", linestyle="--", linewidth=1.1, zorder=2, label="truth")


def delta_panel(
    axes: Axes,
    grid: np.ndarray,
    delta: np.ndarray,
    truth: float,
    others: Sequence[np.ndarray] = (),
    headroom: float = 1.08,
) -> None:
    """delta_k thin and grey, their mean thick and black, and Delta_fitness of other seeds dotted.

    Args:
      axes: the axes.
      grid: (G,) values of the parameter.
      delta: (G, m).
      truth: the parameter's value in reality.
      others: (G,) each.
      headroom: upper limit of the axis, relative to the largest delta_k.
    """
    lines = axes.plot(grid, delta, color="0.72", linewidth=0.6, zorder=1)
    lines[0].set_label(rf"$\delta_k$ of {delta.shape[1]} behaviours")
    for number, curve in enumerate(others):
        label = rf"$\Delta_{{fitness}}$ of {len(others)} other seeds" if number == 0 else None
        axes.plot(grid, curve, color="0.3", linewidth=0.7, linestyle=":", zorder=2, label=label)
    axes.plot(grid, delta.mean(axis=1), color="black", linewidth=2.2, zorder=3, label=r"$\Delta_{fitness}$, their mean")
    truth_line(axes, truth)
    finite = delta[np.isfinite(delta)]
    top = np.quantile(finite, 0.995) if len(finite) else 1.0
    axes.set(ylabel=r"$\delta_k$, $\Delta_{fitness}$ [m/s]", ylim=(-0.02 * top, headroom * top))
