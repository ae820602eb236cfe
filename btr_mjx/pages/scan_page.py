"""What the page of a scan says."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.gap.results import format_number
from btr_mjx.pages.page import embedded
from btr_mjx.pages.page_content import Section, Table, with_interval
from btr_mjx.plotting import ScanData, with_unit

RESAMPLES = 999
"""Resamples of the behaviours for intervals."""

MOST_ROWS = 400
"""Rows of the table of the grid; of a larger grid every n-th is shown."""

STATISTIC_WORDS = {
    "spearman": "Spearman's rank correlation of Delta_fitness with the error |s − s_r|; 1 orders all simulations",
    "spearman_left": "the same, below the truth",
    "spearman_right": "the same, above the truth",
    "monotonicity": "fraction of neighbouring simulations ordered as their errors",
    "roughness": "total variation over range; 1 for a monotonic curve",
    "pairs": "pairs of a simulation and a behaviour",
    "diverged": "of them diverged",
}
"""Entries of result.json in words."""


def scan_sentence(data: ScanData, minimum: tuple[float, float, float]) -> str:
    """The verdict of a scan; `minimum` is where Delta_fitness is least, and the ends of its interval."""
    unit = f" {data.parameter_unit}".rstrip()
    at, low, high = minimum
    text = f"Over {data.delta.shape[1]} behaviours, Delta_fitness is least at {data.parameter} = "
    text += format_number(at) + unit if low == at == high else f"{with_interval(*minimum)}{unit}"
    if np.isfinite(data.truth):
        text += f"; the truth is {format_number(data.truth)}{unit}"
        nearest = float(data.grid[np.argmin(np.abs(data.grid - data.truth))])
        spacing = format_number(float(np.diff(data.grid).mean()), 2)
        if np.isclose(at, nearest) and not np.isclose(nearest, data.truth):
            text += f", and this is the nearest point of the grid, whose spacing is {spacing}{unit}"
        elif not np.isclose(at, nearest):
            text += f" (spacing of the grid: {spacing}{unit})"
    rho, left, right = (float(data.result.get(f"spearman{side}", np.nan)) for side in ("", "_left", "_right"))
    if np.isfinite(left) and np.isfinite(right):
        text += (
            ". It orders the simulations by their error with a rank correlation of "
            f"{format_number(left)} below and {format_number(right)} above the truth"
        )
    elif np.isfinite(rho):
        text += f". It orders the simulations by their error with a rank correlation of {format_number(rho)}"
    return f"{text}."


def scan_content(folder: Path, data: ScanData, figures: Sequence[Path]) -> dict[str, Any]:
    """Variables of the page, with the PNG files of `draw_scan`."""
    means, ends = _resampled_means(data), (0.025, 0.975)
    minima = data.grid[np.argmin(np.where(np.isfinite(means), means, np.inf), axis=1)]
    finite = np.where(np.isfinite(data.delta_fitness), data.delta_fitness, np.inf)
    minimum = (float(data.grid[np.argmin(finite)]), *np.quantile(minima, ends).tolist())
    low, high = np.quantile(means, ends, axis=0)  # NaN where a pair diverged, as the mean itself
    step = -(-len(data.grid) // MOST_ROWS)
    rows = [
        [
            float(data.grid[i]),
            with_interval(float(data.delta_fitness[i]), float(low[i]), float(high[i])),
            *(float(data.delta[i].min()), float(data.delta[i].max())),
        ]
        for i in range(0, len(data.grid), step)
    ]
    numbers = [
        (name, format_number(float(data.result[key])))
        for name, key in (
            ("rank correlation", "spearman"),
            ("monotonicity", "monotonicity"),
            ("roughness", "roughness"),
        )
        if np.isfinite(float(data.result.get(key, np.nan)))
    ]
    statistics = [[key, _number(data.result[key]), text] for key, text in STATISTIC_WORDS.items() if key in data.result]
    evolved_at = data.result.get("evolved_at")
    origin = (
        "The behaviours are random controllers."
        if evolved_at is None
        else f"The controllers evolved where {data.parameter} = {format_number(float(evolved_at))}"
        f"{f' {data.parameter_unit}'.rstrip()}."
    )
    names = [with_unit(data.parameter, data.parameter_unit), with_unit("Delta_fitness", data.unit)]
    table = Table(
        [*names, with_unit("least delta_k", data.unit), with_unit("largest delta_k", data.unit)],
        rows,
        "In brackets: 95 % interval from resampled behaviours." + (f" Every {step}th row." if step > 1 else ""),
    )
    caption = "delta_k of every behaviour, and their mean Delta_fitness, over the parameter."
    return {
        "heading": "Scan",
        "name": folder.resolve().name,
        "sentence": scan_sentence(data, minimum),
        "numbers": numbers,
        "sections": [
            Section(
                "Delta_fitness over the parameter",
                [origin] if "evolved_at" in data.result else [],
                figures=[embedded(f, caption, caption) for f in figures],
            ),
            Section("Statistics", tables=[Table(["statistic", "value", "meaning"], statistics)]),
            Section("Values", tables=[table], folded=True),
        ],
        "footer": ["Numbers: result.json. Arrays: scan.npz."],
    }


def _resampled_means(data: ScanData) -> np.ndarray:
    """Delta_fitness (R, G) of resampled behaviours; few resamples of a large scan, whose mean is exact enough."""
    count = data.delta.shape[1]
    resamples = int(np.clip(2e8 / max(1, data.delta.size), 20, RESAMPLES))
    rng = np.random.default_rng(0)
    return np.stack([data.delta[:, rng.integers(0, count, count)].mean(axis=1) for _ in range(resamples)])


def _number(value: Any) -> Any:
    return value if isinstance(value, int) else float(value)
