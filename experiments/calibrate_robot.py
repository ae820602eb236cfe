"""Choose the hexapod's constants: `uv run python experiments/calibrate_robot.py --out runs/calibration`.

For every candidate set of constants and every seed: controllers are evolved where bl_14 is shortest, bl_14 is scanned
with the 15 best (reality 1.6 m) and bl_5 with mutants of the best (reality 0.88 m) at p_m = 0.02 and 0.2. A set of
constants is suitable if gaits are fast, random controllers do not diverge and Delta_fitness orders simulations by their
error.

The run folder keeps one row per candidate and seed (calibration.csv) and the curves (curves-*.npz); an
interrupted run is continued with --resume. calibration.md and calibration.png are made from these files.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import tyro
from matplotlib.figure import Figure

from btr_mjx import scan
from btr_mjx.backtoreality import Progress, SearchSettings, evolve_controllers, select_transferable
from btr_mjx.errors import InputError, cli_errors, resume_command
from btr_mjx.evaluation import evaluate
from btr_mjx.optimise import mutate
from btr_mjx.robots import Robot, hexapod
from btr_mjx.runs import (
    RunFolder,
    atomic_write,
    graceful_interrupt,
    progress,
    read_arrays,
    read_table,
    write_arrays,
    write_figure,
    write_json,
)

CANDIDATES: dict[str, dict[str, float]] = {
    "chosen": {},
    "no integral": {"ki": 0.0},
    "strong integral": {"ki": 10_000.0},
    "kv 60": {"kv": 60.0},
    "kv 120": {"kv": 120.0},
    "kv 300": {"kv": 300.0},
    "kp 1000": {"kp": 1000.0},
    "kp 4000": {"kp": 4000.0},
    "kp 4000, kv 400": {"kp": 4000.0, "kv": 400.0},
    "density 100": {"density": 100.0},
    "density 400": {"density": 400.0},
    "friction 0.5": {"friction": 0.5},
    "friction 1.2": {"friction": 1.2},
    "soft contact": {"contact_time_constant": 0.05},
}
"""Candidates by name: values that differ from `btr_mjx.robots.HEXAPOD`."""

SCANS = (("bl_14", 1.6, "evolved", 0.0), ("bl_5", 0.88, "mutants", 0.02), ("bl_5", 0.88, "mutants", 0.2))
"""(parameter, truth, behaviours, p_m)."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    out: Path = Path("runs/calibration")
    """Run folder."""
    resume: bool = False
    """Continue the run in --out."""
    candidates: tuple[str, ...] = tuple(CANDIDATES)
    """Names of the candidates to try."""
    seeds: int = 3
    """Seeds 0 .. N - 1."""
    grid: int = 49
    """Points per scan."""
    trials: int = 15
    """m, behaviours per scan."""
    population: int = 60
    """M of the controllers' evolution."""
    generations: int = 10
    """Its generations."""
    random_controllers: int = 256
    """Random controllers in random simulations, to count those that diverge."""


def study(config: Config, robot: Robot, seed: int, step: Progress) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """All measurements of one candidate and seed: a row of numbers and the curves."""
    rng = np.random.default_rng([seed, 7])
    settings = SearchSettings(config.population, config.generations)
    box = robot.controller_box.with_bits(settings.bits)
    start = scan.along(robot, "bl_14", [0.4])[0]
    genomes, scores = evolve_controllers(robot, start, settings, seed=seed, progress=step)
    chosen, _ = select_transferable(genomes, scores, config.trials, maximise=True)
    row: dict[str, float] = {"gait_first": float(np.nanmax(scores[0])), "gait_last": float(np.nanmax(scores))}
    curves: dict[str, np.ndarray] = {}
    for parameter, truth, behaviours, p_m in SCANS:
        picked = chosen if behaviours == "evolved" else mutate(np.tile(chosen[0], (config.trials, 1)), p_m, rng)
        controllers = box.decode(picked)
        line = scan.along(robot, parameter, config.grid)
        f_r = evaluate(robot, scan.along(robot, parameter, [truth]), controllers, progress=step).fitness[0]
        delta = scan.delta(robot, line, controllers, f_r, progress=step)
        label = parameter if behaviours == "evolved" else f"{parameter} p_m {p_m}"
        x = line[:, robot.simulation_box.index(parameter)]
        numbers = scan.curve_statistics(x, delta.mean(axis=1), truth)
        row |= {f"{label} rho": numbers["spearman"], f"{label} roughness": numbers["roughness"]}
        curves |= {f"{label}/grid": x, f"{label}/delta": delta, f"{label}/truth": np.array(truth)}
    s = robot.simulation_box.sample(rng, config.random_controllers)
    c = robot.controller_box.sample(rng, config.random_controllers)
    wild = evaluate(robot, s, c, pairwise=True, progress=step)
    row |= {
        "finite": float(1 - wild.diverged.mean()),
        "capped_steps": float(wild.solver_capped.mean()),
        "random_speed": float(np.nanmedian(wild.fitness)),
    }
    return row, curves


def compute(config: Config) -> None:
    """Compute the measurements of every candidate and seed that are missing."""
    todo = [(name, seed) for name in config.candidates for seed in range(config.seeds)]
    pairs = config.population * config.generations + 3 * config.trials * (config.grid + 1) + config.random_controllers
    with (
        RunFolder.create(config.out, config, config.resume) as run,
        graceful_interrupt() as stop,
    ):
        checkpoint = run.load_latest()
        history = run.history("calibration.csv", checkpoint)
        left = todo[0 if checkpoint is None else checkpoint.step + 1 :]
        with progress(total=len(left) * pairs, description="calibrate", unit="pairs", show=True) as bar:
            for name, seed in left:
                bar.set_description(f"{name}, seed {seed}")
                robot = hexapod(**CANDIDATES[name])
                row, curves = study(config, robot, seed, bar.update)
                write_arrays(run.path / f"curves-{name.replace(' ', '-').replace(',', '')}-{seed}.npz", curves)
                history.append({"candidate": name, "seed": seed, **row})
                run.save_checkpoint(todo.index((name, seed)), {})
                stop.checkpoint()


def summarise(folder: Path) -> pl.DataFrame:
    """Means over seeds, one row per candidate, as calibration.md, summary.json and a frame."""
    rows = read_table(folder / "calibration.csv")
    table = rows.group_by("candidate", maintain_order=True).agg(
        pl.exclude("seed").mean(), pl.col("bl_14 rho").min().alias("bl_14 rho, worst seed")
    )
    names = table.columns
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    for values in table.iter_rows():
        shown = [value if isinstance(value, str) else f"{value:.3g}" for value in values]
        lines.append("| " + " | ".join(shown) + " |")
    with atomic_write(folder / "calibration.md") as file:
        file.write(("\n".join(lines) + "\n").encode())
    write_json(folder / "summary.json", table.to_dicts())
    return table


def draw(folder: Path) -> None:
    """Draw Delta_fitness of each candidate over the scans, with thin lines per seed, from the saved curves."""
    names = read_table(folder / "calibration.csv")["candidate"].unique(maintain_order=True).to_list()
    figure = Figure(figsize=(9, 1.6 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), len(SCANS), squeeze=False)
    for row, name in zip(axes, names, strict=True):
        for path in sorted(folder.glob(f"curves-{name.replace(' ', '-').replace(',', '')}-[0-9]*.npz")):
            curves = read_arrays(path)
            labels = [key.removesuffix("/grid") for key in curves if key.endswith("/grid")]
            for ax, label in zip(row, labels, strict=True):
                ax.plot(curves[f"{label}/grid"], curves[f"{label}/delta"].mean(axis=1), lw=0.9)
                ax.axvline(float(curves[f"{label}/truth"]), color="k", ls=":", lw=0.8)
                ax.set_title(f"{name}: {label}", fontsize=8)
    write_figure(folder / "calibration.png", figure)


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors(resume_command("experiments.calibrate_robot", sys.argv[1:], config.out)):
        unknown = [name for name in config.candidates if name not in CANDIDATES]
        if unknown:
            raise InputError(f"candidates: got {', '.join(unknown)}, expected some of: {', '.join(CANDIDATES)}")
        compute(config)
        print(summarise(config.out))
        draw(config.out)


if __name__ == "__main__":
    main()
