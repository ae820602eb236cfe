"""The panels of Fig. 4; see fig4_identification.py."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from drawing import figure_of, letter, save
from identification import Search
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from units import Arrays

LOOKS: dict[str, tuple[str, dict[str, Any]]] = {
    "ga": ("genetic algorithm", {"color": "black", "linestyle": "-"}),
    "cma": ("CMA-ES", {"color": "black", "linestyle": "--"}),
    "adam-12": ("multiscale, Adam", {"color": "0.4", "linestyle": (0, (5, 1))}),
    "delta-12": (r"$\Delta_{fitness}$", {"color": "0.55", "linestyle": "-"}),
    "multiscale-12": ("multiscale", {"color": "black", "linestyle": "-"}),
    "noisy-12": ("multiscale, noise", {"color": "black", "linestyle": ":"}),
    "native-12": ("multiscale, other physics", {"color": "black", "linestyle": "--"}),
}
"""Legend text and line style of every search."""


def draw_searches(
    path: Path, names: Sequence[str], searches: Mapping[str, list[Arrays]], summary: Mapping[str, Any]
) -> Path:
    """Draw the figure.

    Args:
      path: of the picture.
      names: of the four lengths.
      searches: saved searches by name, one per seed.
      summary: fig4.json.
    """
    with figure_of(9.6, 6.6) as figure:
        rows: Any = figure.subfigures(3, 1, height_ratios=[1.0, 0.9, 1.05])
        top: Any = rows[0].subplots(1, 1)
        distance_panel(top, searches["ga"][0])
        letter(top, "a", "genetic algorithm, four unknown lengths, seed 0")
        middle: Any = rows[1].subplots(1, len(names), sharex=True, sharey=True)
        for i, (axes, name) in enumerate(zip(middle, names, strict=True)):
            parameter_panel(axes, searches["ga"][0], i, name)
        letter(middle[0], "b", names[0])
        bottom: Any = rows[2].subplots(1, 3)
        for axes, chosen in ((bottom[0], ("ga", "cma")), (bottom[2], [n for n in searches if n.endswith("12")])):
            for name in chosen:
                error_lines(axes, searches[name], *LOOKS[name])
            axes.set(xscale="log", yscale="log", xlabel="whole trials simulated", ylabel="mean error of lengths [m]")
            axes.legend(fontsize=7, loc="lower left")
        letter(bottom[0], "c", "four unknown, all seeds")
        sensitivity_panel(bottom[1], summary["felt"])
        letter(bottom[1], "d", "felt at the truth")
        letter(bottom[2], "e", "twelve unknown")
        return save(figure, path)


def distance_panel(axes: Axes, arrays: Arrays) -> None:
    """Delta_fitness of every member against the generation, the best in black."""
    values = arrays["values"]
    x = np.arange(1, len(values) + 1)
    axes.plot(np.repeat(x, values.shape[1]), values.ravel(), ".", color="0.75", markersize=1.5, label="members")
    axes.plot(x, np.nanmin(values, axis=1), color="black", label="best of the generation")
    axes.set(xlabel="generation", ylabel=r"$\Delta_{fitness}$ [m/s]", ylim=(0, None))
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    axes.legend(fontsize=7, ncols=2, loc="upper right")


def parameter_panel(axes: Axes, arrays: Arrays, index: int, name: str) -> None:
    """One length of every member, darker for a larger distance; the best in black, the truth dashed."""
    values, parameters = arrays["values"], arrays["parameters"][..., index]
    rank = np.argsort(np.argsort(np.where(np.isfinite(values), values, np.inf).ravel()))
    grey = 0.85 - 0.5 * rank / max(len(rank) - 1, 1)
    x = np.repeat(np.arange(1, len(values) + 1), values.shape[1])
    axes.scatter(x, parameters.ravel(), c=grey.astype(str).tolist(), s=2, linewidths=0, rasterized=True)
    search = Search(arrays["parameters"], values, arrays["simulated"])
    axes.plot(np.arange(1, len(values) + 1), search.best[:, index], color="black", linewidth=1.4)
    axes.axhline(arrays["truth"][index], color="#c8641e", linestyle="--", linewidth=1.2)
    axes.plot(0, arrays["start"][index], "ko", fillstyle="none", clip_on=False)
    axes.set_title(name, loc="left", fontsize=8.5)
    axes.set(xlabel="generation", ylim=(0.36, 1.64))
    if index == 0:
        axes.set_ylabel("length [m]")


def error_lines(axes: Axes, runs: Sequence[Arrays], label: str, look: Mapping[str, Any]) -> None:
    """Error of the best member so far, thin per seed, and their median thick while all seeds go on."""
    errors = [Search(run["parameters"], run["values"], run["simulated"]).error(run["truth"]) for run in runs]
    for run, error in zip(runs, errors, strict=True):
        axes.plot(run["trials"], np.maximum(error, 1e-5), linewidth=0.5, alpha=0.7, **look)
    longest = max(runs, key=lambda run: len(run["trials"]))["trials"]
    # A search that has converged keeps its last error.
    padded = [np.concatenate([error, np.full(len(longest) - len(error), error[-1])]) for error in errors]
    axes.plot(longest, np.maximum(np.median(padded, axis=0), 1e-5), linewidth=2, label=label, **look)


def sensitivity_panel(axes: Axes, felt: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Sensitivity of both distances to each length, relative to the largest."""
    names = [row["name"].removeprefix("bl_") for row in felt["delta"]]
    x = np.arange(len(names))
    looks = (("delta", r"$\Delta_{fitness}$", "0.25", -0.2), ("multiscale", "multiscale", "0.8", 0.2))
    for kind, label, color, shift in looks:
        rows = felt[kind]
        middle = np.array([row["estimate"] for row in rows])
        ends = np.array([[row["low"], row["high"]] for row in rows]).T
        error = np.abs(np.where(np.isfinite(ends), ends, middle) - middle) / middle.max()
        axes.bar(
            x + shift, middle / middle.max(), 0.4, yerr=error, color=color, edgecolor="black", linewidth=0.4,
            error_kw={"elinewidth": 0.7}, label=label,
        )  # fmt: skip
    axes.set(xticks=x, xticklabels=names, xlabel="length bl_i", ylabel="change per metre, relative", ylim=(0, None))
    axes.legend(fontsize=7, ncols=2, loc="upper center")
    axes.set_ylim(0, 1.25 * axes.get_ylim()[1])
