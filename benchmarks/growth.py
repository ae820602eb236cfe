"""Does a simulator that grows come nearer to reality? Hidden effects, with and without `--grow`.

    uv run python benchmarks/growth.py --robot thrower --seeds 5 --json growth.json

Every case is a co-evolution of an example robot whose reality has an effect that no value of the believed parameters
explains, or none; these parameters are unknown as well, and drawn from the seed. Every reality has small errors of
calibration everywhere and shorter time steps. It runs with growth and without.
A case is kept when it is done: the same command continues a killed benchmark.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.backtoreality import CoevolveConfig, SimulatedReality, build_problem, summarise
from btr_mjx.backtoreality.algorithm import advance, begin
from btr_mjx.backtoreality.growth import Calibration
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import describe_environment, progress, read_json, write_json

EXAMPLES = Path(__file__).parents[1] / "examples"
_SHOULDER, _LEG = '"shoulder" damping="0.3"', '<joint type="hinge" axis="0 1 0" damping="0.4"'
_LOAD = '<geom type="sphere" size="0.03" mass="2" pos="0.15 0 0.1" contype="0" conaffinity="0"/>'
_TRUNK = 'size="0.22 0.1 0.05" density="700"/>'
HIDDEN: dict[str, dict[str, tuple[tuple[str, ...], str, str, str]]] = {
    "thrower": {
        "dry friction": (("dry_friction",), "shoulder", _SHOULDER, f'{_SHOULDER} frictionloss="1"'),
        "damping": (("viscous_damping",), "shoulder", _SHOULDER, '"shoulder" damping="0.8"'),
        "rotor": (("armature",), "shoulder", _SHOULDER, f'{_SHOULDER} armature="0.05"'),
        "spring": (("joint_stiffness",), "elbow", '"elbow" damping="0.2"', '"elbow" damping="0.2" stiffness="1.5"'),
        "weak motor": (("actuator_gain",), "shoulder", 'joint="shoulder"/>', 'joint="shoulder" kp="30" kv="1.5"/>'),
        "nothing": ((), "", "<worldbody>", "<worldbody>"),
    },
    "quadruped": {
        "slippery ground": (("ground_friction",), "world", 'friction="0.9 ', 'friction="0.45 '),
        "payload": (("payload", "com_shift"), "trunk", _TRUNK, _TRUNK + _LOAD),
        "weak motors": (("torque_limit",), "", 'forcerange="-25 25"', 'forcerange="-4 4"'),
        "damping": (("viscous_damping",), "", _LEG, _LEG.replace("0.4", "1")),
        "slope": (
            ("ground_slope",),
            "world",
            'integrator="implicitfast"',
            'integrator="implicitfast" gravity="0.6 0 -9.79"',
        ),
        "nothing": ((), "", "<worldbody>", "<worldbody>"),
    },
}
"""Robot -> case -> effects that count as right, part of their place ("" for any), what replaces what in the MJCF."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    robot: Literal["thrower", "quadruped"] = "thrower"
    """Example robot."""
    seeds: int = 3
    """Seeds of every case."""
    first_seed: int = 0
    """The first of them."""
    grow_from: Literal["recordings", "fitness"] = "recordings"
    """Data in which the missing effect is sought."""
    iterations: int = 2
    """Iterations of Back-to-Reality."""
    first_population: Literal["random", "mutants"] = "random"
    """Controllers with which the search of iteration 1 begins."""
    out: Path = Path("runs/growth")
    """Folder of the cases."""
    json: Path | None = None
    """Write all numbers here."""


def case(config: Config, name: str, seed: int, grow: bool) -> dict[str, Any]:
    """One co-evolution: what was added, Delta_fitness, and the final controller in simulation and reality."""
    *_, old, new = HIDDEN[config.robot][name]
    settings = CoevolveConfig(
        robot=EXAMPLES / config.robot,
        engine="native",
        reality_engine="native",
        reality_timestep=0.0005,
        optimiser="cma",
        iterations=config.iterations,
        grow=grow,
        grow_from=config.grow_from,
        first_population=config.first_population,
        seed=seed,
    )
    problem = build_problem(settings)
    text = problem.robot.template
    if old not in text:
        raise InputError(f"{config.robot}: its MJCF has no {old!r}")
    assert isinstance(problem.reality, SimulatedReality)
    errors = Calibration(100 + seed)
    real = replace(problem.robot, template=text.replace(old, new), edits=(*problem.robot.edits, errors))
    reality = replace(problem.reality, robot=real)
    problem = replace(problem, reality=reality)
    state, searches = begin(problem), list[float]()
    while state.phase != "done":
        begun, searching = time.process_time(), state.phase == "growth"
        state = advance(problem, state)
        searches += [time.process_time() - begun] if searching else []
    result = summarise(problem, state)
    return {
        "case": name,
        "seed": seed,
        "grow": grow,
        "added": [f"{entry['effect']}@{entry['location']}" for entry in result["effects"]],
        "events": result["growth"],
        "delta_last": result["delta_fitness_last"],
        "final_gap": abs(result["f_s_best"] - result["f_r_best"]),
        "f_r_best": result["f_r_best"],
        "cpu_seconds_of_searches": searches,
    }


def is_right(config: Config, row: dict[str, Any]) -> bool:
    """Whether the hidden effect was added, alone or with a number for each member of a group that holds its place."""
    effects, place, _, _ = HIDDEN[config.robot][row["case"]]
    return any(own.split("@")[0] in effects and (place in own or "all" in own) for own in row["added"])


def is_near(config: Config, row: dict[str, Any]) -> bool:
    """Whether the hidden effect is among the first three of any search."""
    effects = HIDDEN[config.robot][row["case"]][0]
    ranked = [event.get("ranking", [])[:3] for event in row["events"]]
    return any(own.split("@")[0] in effects for first in ranked for own in first)


def summary(config: Config, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Shares and medians over all cases.

    `right_or_first_three` are cases whose effect was added or is among the first three of a search.
    """
    grown = [row for row in rows if row["grow"] and row["case"] != "nothing"]
    nulls = [row for row in rows if row["grow"] and row["case"] == "nothing"]
    plain = {(row["case"], row["seed"]): row for row in rows if not row["grow"]}
    searches = [seconds for row in grown for seconds in row["cpu_seconds_of_searches"]]
    falls = {
        name: [1 - row[name] / plain[row["case"], row["seed"]][name] for row in grown]
        for name in ("delta_last", "final_gap")
    }
    return {
        "cases": len(grown),
        "right": sum(is_right(config, row) for row in grown),
        "right_or_first_three": sum(is_right(config, row) or is_near(config, row) for row in grown),
        "added_anything": sum(bool(row["added"]) for row in grown),
        "nulls": len(nulls),
        "nulls_untouched": sum(not row["added"] for row in nulls),
        "cpu_seconds_of_a_search_median": float(np.median(searches)) if searches else None,
        "cpu_seconds_of_a_search_most": max(searches, default=None),
        **{f"fall_of_{name}_median": float(np.median(own)) if own else None for name, own in falls.items()},
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
                how = f"{config.first_population}-{config.iterations}-{config.grow_from if grow else 'plain'}"
                file = config.out / f"{config.robot}-{name.replace(' ', '_')}-{seed}-{how}.json"
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
