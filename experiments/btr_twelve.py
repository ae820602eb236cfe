"""Back-to-Reality with all lengths unknown: `uv run python experiments/btr_twelve.py`.

Runs `python -m btr_mjx.coevolve --unknown all --distance multiscale --optimiser cma`, once per seed, for the robot of
Fig. 4 with its other eight lengths drawn from the seed. `--physics other` simulates reality by native MuJoCo in float64
with another time step and integrator, which share neither code nor numerical errors with the searches. The result is
the best controller: its fitness in reality compared with its fitness in the identified simulation.

The run folder holds a run of the command per seed, seed-0/, ...; btr_twelve.json holds the numbers, btr_twelve.png the
figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from curves import interval
from drawing import figure_of, letter, save
from fig4_identification import OTHER_PHYSICS

from btr_mjx.backtoreality import PRESETS as COEVOLVE
from btr_mjx.backtoreality import CoevolveConfig
from btr_mjx.coevolve import run_config
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.evaluation import evaluate
from btr_mjx.models import chosen_robot
from btr_mjx.runs import is_unused, read_json, write_json

BY_FITNESS = replace(
    COEVOLVE["quick"],
    unknown=("all",),
    truth=("bl_3=0.54", "bl_5=0.54", "bl_6=0.74", "bl_8=0.74"),
    iterations=3,
    trials=15,
    simulations=50,
    simulation_generations=100,
    optimiser="cma",
    figures=False,
)
"""All lengths unknown, for either distance."""

OTHER_REALITY: dict[str, Any] = {
    "reality_engine": "native",
    "reality_timestep": OTHER_PHYSICS.timestep,
    "reality_integrator": OTHER_PHYSICS.integrator,
}
"""Settings of a reality of other physics."""

SIZES: dict[str, CoevolveConfig] = {
    "quick": replace(BY_FITNESS, iterations=2, simulation_generations=30),
    "paper": BY_FITNESS,
    "tiny": replace(
        BY_FITNESS,
        engine="native",
        duration=0.06,
        iterations=1,
        trials=3,
        controllers=6,
        controller_generations=1,
        simulations=6,
        simulation_generations=2,
    ),
}
"""Settings of the runs by preset."""


@dataclass(frozen=True)
class BtrConfig:
    """Settings; every field is a flag."""

    preset: Literal["quick", "paper", "tiny"] = "quick"
    """Sizes of the runs."""
    physics: Literal["same", "other"] = "same"
    """How reality is simulated; each needs a run folder of its own."""
    seeds: int = 5
    """Seeds 0 .. N - 1."""
    out: Path | None = None
    """Run folder; by default runs/experiments-<preset>/btr_twelve, or btr_twelve_other."""
    progress: bool = True
    """Show progress bars."""
    draw_only: bool = False
    """Draw from the saved files and simulate nothing."""


def run_of(config: BtrConfig, folder: Path, seed: int) -> CoevolveConfig:
    """The command's settings of one seed."""
    out = folder / f"seed-{seed}"
    own = replace(SIZES[config.preset], distance="multiscale", seed=seed, progress=config.progress, out=out)
    if config.physics == "other":
        own = replace(own, **OTHER_REALITY)
    return replace(own, resume=not is_unused(out))


def transfer(run: CoevolveConfig, result: dict[str, Any]) -> dict[str, float]:
    """The best controller of the last iteration in reality and in the identified simulation [m/s]."""
    robot = chosen_robot(None, None, run.duration)
    simulation = robot.simulation_box.embed(
        robot.nominal_simulation, list(result["simulation"]), list(result["simulation"].values())
    )
    found = evaluate(
        robot,
        simulation[None],
        np.array(result["best_controller"])[None],
        engine=None if run.engine == "auto" else run.engine,
    )
    f_r, f_s = float(result["f_r_best"]), float(found.fitness[0, 0])
    return {"f_r": f_r, "f_s": f_s, "gap": abs(f_s - f_r) / abs(f_r)}


def draw(folder: Path) -> list[Path]:
    """btr_twelve.json and btr_twelve.png from the runs' results."""
    rows = read_json(folder / "rows.json")
    summary = {name: {**interval([row[name] for row in rows], np.median)} for name in rows[0]} | {"seeds": rows}
    write_json(folder / "btr_twelve.json", summary)
    with figure_of(6.4, 2.9) as figure:
        left, right = figure.subplots(1, 2)
        ends = [min(min(row["f_r"], row["f_s"]) for row in rows), max(max(row["f_r"], row["f_s"]) for row in rows)]
        left.plot([row["f_s"] for row in rows], [row["f_r"] for row in rows], "ko", label="controllers")
        left.plot(ends, ends, "0.5", lw=0.8, label="$f_r = f_s$")
        left.fill_between(ends, np.multiply(ends, 0.95), np.multiply(ends, 1.05), color="0.88", label="5 %")
        left.set(xlabel="fitness in the identified simulation [m/s]", ylabel="fitness in reality [m/s]")
        left.legend(fontsize=7)
        for row in rows:
            right.plot([0, 1], [row["error_first"], row["error_last"]], "k.-", lw=0.8)
        right.set(yscale="log", xticks=[0, 1], xticklabels=["start", "identified"], ylabel="mean error of lengths [m]")
        right.set_xlim(-0.2, 1.2)
        letter(left, "a", "transfer")
        letter(right, "b", "twelve lengths")
        return [folder / "btr_twelve.json", save(figure, folder / "btr_twelve.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    config = tyro.cli(BtrConfig, args=argv, description=__doc__, prog="btr_twelve")
    name = "btr_twelve" if config.physics == "same" else "btr_twelve_other"
    folder = config.out or Path("runs", f"experiments-{config.preset}", name)
    with cli_errors("the same command: what is done is kept"):
        if config.seeds < 1:
            raise InputError(f"seeds: got {config.seeds}, expected at least 1")
        if not config.draw_only:
            rows = []
            for seed in range(config.seeds):
                run = run_of(config, folder, seed)
                result = run_config(run)
                rows.append(
                    transfer(run, result)
                    | {f"error_{end}": float(result[f"parameter_error_{end}"]) for end in ("first", "last")}
                    | {"evaluations": float(result["reality_evaluations"])}
                )
            write_json(folder / "rows.json", rows)
        for path in draw(folder):
            print(path)


if __name__ == "__main__":
    main()
