"""Number of trials needed to identify a robot: `uv run python experiments/maps.py`.

Twelve unknown lengths, CMA-ES on `distances.multiscale_fitness`, error of the simulation found:
(a) against the number m of random controllers tried in reality, for several levels of noise on every measurement, and
for a reality that is native MuJoCo at another time step and integrator;
(b) against the last of the eight marks, m = 15, with exact and with noisy measurements, and with a curriculum of marks;
(c) against the number of marks;
(d) against the diversity p_m of the behaviours, mutants of one evolved controller;
(e) against m where noisy trials are chosen three at a time: at random, the fittest of an evolution in s_0 (the paper's
choice), or those with the largest disagreement of simulations that agree with the trials so far;
(f) for random truths, m = 15.

The run folder holds one file per search and seed, NAME-0.npz, ...: error [m] of the best simulation, distance, m, and
for choices one entry a round. maps.json holds medians and intervals over seeds, maps.png the figure.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from common import TINY, command
from curves import interval
from drawing import figure_of, save
from fig4_identification import OTHER_PHYSICS
from maps_drawing import fill
from maps_tasks import ROUND, Choice, MapsConfig, Point, choose, other_truth, search_at
from units import Unit, load, run_units

from btr_mjx.errors import InputError
from btr_mjx.runs import write_json

PRESETS = {
    "quick": MapsConfig(
        seeds=1, truths=2, noises=(0.0, 0.05), search_generations=60, horizons=(0.05, 0.2), behaviours=(3, 15),
        mark_counts=(1, 8), diversities=(0.02, 0.2),
    ),
    "paper": MapsConfig(preset="paper", seeds=5),
    "tiny": MapsConfig(
        preset="tiny", **TINY, members=6, search_generations=2, behaviours=(2, 4), horizons=(0.02, 0.05), pool=5,
        believed=3, truths=2, noises=(0.0, 0.05), curriculum=(0.02, 0.04), mark_counts=(1, 2), diversities=(0.2,),
    ),
}  # fmt: skip
"""Settings by preset."""


def points_of(config: MapsConfig) -> dict[str, Point]:
    """The points of the maps (a) to (d), by name."""
    found: dict[str, Point] = {}
    for m in config.behaviours if "behaviours" in config.parts else ():
        found |= {f"m{m}-noise{100 * noise:g}": Point(m, noise) for noise in config.noises}
        found[f"m{m}-native"] = Point(m, reality=OTHER_PHYSICS)
    for noise in config.horizon_noises if "horizon" in config.parts else ():
        for horizon in config.horizons:
            found[f"horizon{horizon:g}-noise{100 * noise:g}"] = Point(config.trials, noise, (horizon,))
        found[f"curriculum-noise{100 * noise:g}"] = Point(config.trials, noise, config.curriculum)
    for count in config.mark_counts if "marks" in config.parts else ():
        found[f"marks{count}"] = Point(config.trials, marks=count)
    if "diversity" in config.parts:
        found |= {f"p_m{p_m:g}": Point(config.trials, p_m=p_m) for p_m in config.diversities}
        found["p_m-random"] = Point(config.trials)
    return found


def cost_of(config: MapsConfig, point: Point) -> float:
    """Whole trials of a search."""
    horizon = float(np.mean(point.horizons or (config.horizon,)))
    evolved = 0 if point.p_m is None else config.population * config.generations
    return evolved + (config.members * config.search_generations + 1) * point.m * horizon / config.duration


def units(config: MapsConfig) -> list[Unit]:
    """One unit per point of a map and seed."""
    share, searched = config.horizon / config.duration, config.members * config.search_generations
    rounds = range(ROUND, config.trials + 1, ROUND)
    found = []
    for seed in range(config.seeds):
        for name, point in points_of(config).items():
            found.append(Unit(f"{name}-{seed}", cost_of(config, point), partial(search_at, config, point, seed)))
        for choice in get_args(Choice) if "choice" in config.parts else ():
            cost = (searched * (sum(rounds) + ROUND) / 2 + sum(rounds)) * share
            if choice == "fittest":
                cost += config.population * config.generations
            if choice == "disagreement":
                cost += (len(rounds) - 1) * config.believed * config.pool * share
            found.append(Unit(f"choice-{choice}-{seed}", cost, partial(choose, config, choice, seed)))
    for seed in range(config.truths if "truth" in config.parts else 0):
        cost = (searched + 1) * config.trials * share
        found.append(Unit(f"truth-{seed}", cost, partial(other_truth, config, seed)))
    return found


def compute(config: MapsConfig) -> int:
    """Compute the points that are missing; returns how many there were."""
    return run_units(config, units(config), "maps")


def summarise(folder: Path) -> dict[str, Any]:
    """Median error [m] with its interval over seeds, by the name of the map's point; per round for choices."""
    names = sorted({path.stem.rpartition("-")[0] for path in folder.glob("*.npz") if not path.stem.startswith("check")})
    result = {}
    for name in names:
        found = load(folder, name)
        errors, m = np.array([np.atleast_1d(a["error"]) for a in found]), np.atleast_1d(found[0]["m"])
        result[name] = [
            {"m": float(m[i]), **interval(errors[:, i], np.median), "values": errors[:, i]} for i in range(len(m))
        ]
    return result


def draw(folder: Path) -> list[Path]:
    """maps.json and maps.png from the saved searches."""
    summary = summarise(folder)
    if not summary:
        raise InputError(f"{folder} holds no results: nothing was computed yet; run without --draw-only")
    write_json(folder / "maps.json", summary)
    with figure_of(8.4, 5.6) as figure:
        panels: Any = figure.subplots(2, 3)
        count = fill(figure, panels.ravel().tolist(), summary)
        figure.set_size_inches(2.8 * min(count, 3), 2.8 * -(-count // 3))
        return [folder / "maps.json", save(figure, folder / "maps.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "maps", argv, compute, draw)


if __name__ == "__main__":
    main()
