"""Does a simulator that grows come nearer to reality? Hidden effects, with and without `--grow`.

    uv run python benchmarks/growth.py --robot thrower --seeds 5 --json growth.json

Every case is a co-evolution of an example robot whose reality has an effect that no value of the believed parameters
explains, or none; these parameters are unknown as well, and drawn from the seed. It runs with growth and without.
A case is kept when it is done: the same command continues a killed benchmark.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.backtoreality import CoevolveConfig, SimulatedReality, build_problem, summarise
from btr_mjx.backtoreality.algorithm import run_in_memory
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, progress, read_json, write_json

EXAMPLES = Path(__file__).parents[1] / "examples"
HIDDEN: dict[str, dict[str, tuple[str, str, str, str]]] = {
    "thrower": {
        "dry friction": (
            "dry_friction",
            "shoulder",
            '"shoulder" damping="0.3"',
            '"shoulder" damping="0.3" frictionloss="1"',
        ),
        "damping": ("viscous_damping", "shoulder", '"shoulder" damping="0.3"', '"shoulder" damping="0.8"'),
        "rotor": ("armature", "shoulder", '"shoulder" damping="0.3"', '"shoulder" damping="0.3" armature="0.05"'),
        "spring": ("joint_stiffness", "elbow", '"elbow" damping="0.2"', '"elbow" damping="0.2" stiffness="1.5"'),
        "weak motor": ("actuator_gain", "shoulder", 'joint="shoulder"/>', 'joint="shoulder" kp="30" kv="1.5"/>'),
        "nothing": ("", "", "<worldbody>", "<worldbody>"),
    },
    "quadruped": {
        "slippery ground": ("ground_friction", "world", 'friction="0.9 ', 'friction="0.45 '),
        "slope": (
            "ground_slope",
            "world",
            'integrator="implicitfast"',
            'integrator="implicitfast" gravity="0.6 0 -9.79"',
        ),
        "damping": (
            "viscous_damping",
            "",
            '<joint type="hinge" axis="0 1 0" damping="0.4"',
            '<joint type="hinge" axis="0 1 0" damping="1"',
        ),
        "nothing": ("", "", "<worldbody>", "<worldbody>"),
    },
}
"""Robot -> case -> effect, part of its place ("" for any), and what is replaced in the MJCF by what."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    robot: Literal["thrower", "quadruped"] = "thrower"
    """Example robot."""
    seeds: int = 3
    """Seeds of every case."""
    first_seed: int = 0
    """The first of them."""
    iterations: int = 2
    """Iterations of Back-to-Reality."""
    out: Path = Path("runs/growth")
    """Folder of the cases."""
    json: Path | None = None
    """Write all numbers here."""


def case(config: Config, name: str, seed: int, grow: bool) -> dict[str, Any]:
    """One co-evolution: what was added, Delta_fitness, and the final controller in simulation and reality."""
    _, _, old, new = HIDDEN[config.robot][name]
    settings = CoevolveConfig(
        robot=EXAMPLES / config.robot,
        engine="native",
        reality_engine="native",
        optimiser="cma",
        iterations=config.iterations,
        grow=grow,
        seed=seed,
    )
    problem = build_problem(settings)
    text = problem.robot.template
    if old not in text:
        raise InputError(f"{config.robot}: its MJCF has no {old!r}")
    assert isinstance(problem.reality, SimulatedReality)
    reality = replace(problem.reality, robot=replace(problem.robot, template=text.replace(old, new)))
    state = run_in_memory(replace(problem, reality=reality))
    result = summarise(replace(problem, reality=reality), state)
    return {
        "case": name,
        "seed": seed,
        "grow": grow,
        "added": [f"{entry['effect']}@{entry['location']}" for entry in result["effects"]],
        "events": result["growth"],
        "delta_last": result["delta_fitness_last"],
        "final_gap": abs(result["f_s_best"] - result["f_r_best"]),
        "f_r_best": result["f_r_best"],
    }


def is_right(config: Config, row: dict[str, Any]) -> bool:
    """Whether the hidden effect was added, alone or with a number for each member of a group that holds its place."""
    effect, place, _, _ = HIDDEN[config.robot][row["case"]]
    return any(own.split("@")[0] == effect and (place in own or "all" in own) for own in row["added"])


def summary(config: Config, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Shares and medians over all cases."""
    grown = [row for row in rows if row["grow"] and row["case"] != "nothing"]
    nulls = [row for row in rows if row["grow"] and row["case"] == "nothing"]
    plain = {(row["case"], row["seed"]): row for row in rows if not row["grow"]}
    falls = [1 - row["delta_last"] / plain[row["case"], row["seed"]]["delta_last"] for row in grown]
    return {
        "cases": len(grown),
        "right": sum(is_right(config, row) for row in grown),
        "added_anything": sum(bool(row["added"]) for row in grown),
        "nulls": len(nulls),
        "nulls_untouched": sum(not row["added"] for row in nulls),
        "fall_of_delta_median": float(np.median(falls)) if falls else None,
    }


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        wanted = [
            (name, seed, grow)
            for seed in range(config.first_seed, config.first_seed + config.seeds)
            for name in HIDDEN[config.robot]
            for grow in (True, False)
            if grow or name != "nothing"
        ]
        rows = []
        with progress(total=len(wanted), description=config.robot, unit="runs", show=True) as bar:
            for name, seed, grow in wanted:
                file = (
                    config.out / f"{config.robot}-{name.replace(' ', '_')}-{seed}-{'grown' if grow else 'plain'}.json"
                )
                if not file.is_file():
                    write_json(file, case(config, name, seed, grow))
                rows.append(read_json(file))
                bar.update(1)
        numbers = summary(config, rows)
        if config.json is not None:
            write_json(config.json, {"environment": describe_environment(), "summary": numbers, "rows": rows})
    print(f"{'hidden':18}{'seed':>5}  {'Delta_fitness':>14}{'without growth':>16}  added")
    plain = {(row["case"], row["seed"]): row["delta_last"] for row in rows if not row["grow"]}
    for row in rows:
        if row["grow"]:
            before = plain.get((row["case"], row["seed"]), float("nan"))
            added = ", ".join(row["added"]) or row["events"][-1]["verdict"]
            print(f"{row['case']:18}{row['seed']:5}  {row['delta_last']:14.4f}{before:16.4f}  {added}")
    for name, value in numbers.items():
        print(f"{name:24} {value}")


if __name__ == "__main__":
    main()
