"""Identification of 32 unknown parameters of several kinds: `uv run python experiments/thirty_unknowns.py`.

Unknown parameters of the hexapod: 12 lengths, 12 densities of limbs, the motor gain kp of each leg, joint
damping and ground friction. CMA-ES on `distances.multiscale_fitness` of 45 random controllers, from a start that is
off by a fifth of every parameter's range.

The run folder holds one file per seed, search-0.npz, ...: parameters (g, L, 32), values (g, L), truth and start (32,).
thirty.json holds the error of every kind of parameter as a share of its range, thirty.png the course of the searches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import Bench
from common import TINY, Config, command
from curves import interval
from drawing import figure_of, save
from identification import Search, away_from, cma_es
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx.errors import InputError
from btr_mjx.evaluation import multiscale_fitness
from btr_mjx.robots import HEXAPOD, Box, Robot, hexapod
from btr_mjx.runs import write_json

LEGS = range(6)

KINDS: dict[str, tuple[str, ...]] = {
    "lengths": tuple(f"bl_{body}" for body in range(3, 15)),
    "densities": tuple(f"density_{body}" for body in range(3, 15)),
    "motor gains": tuple(f"kp_{leg}" for leg in LEGS),
    "joint damping": ("joint_damping",),
    "friction": ("friction",),
}
"""Unknown parameters by kind."""

RANGES: dict[str, tuple[float, float]] = {
    "lengths": (0.4, 1.6),
    "densities": (100.0, 300.0),
    "motor gains": (1200.0, 2800.0),
    "joint damping": (0.0, 40.0),
    "friction": (0.4, 1.2),
}
"""Their bounds [m, kg/m^3, N m/rad, N m s/rad, 1]."""


@dataclass(frozen=True, kw_only=True)
class ThirtyConfig(Config):
    """Settings."""

    trials: int = 45
    """m, random controllers tried in reality."""
    horizon: float = 0.05
    """Last mark of the distance [s]."""
    away: float = 0.2
    """How far every parameter is off at the start, as a share of its range."""
    members: int = 48
    """L of the search."""
    search_generations: int = 400
    """Its generations."""


PRESETS = {
    "quick": ThirtyConfig(seeds=1, population=60, trials=15, search_generations=60),
    "paper": ThirtyConfig(preset="paper", seeds=5),
    "tiny": ThirtyConfig(preset="tiny", **TINY, members=6, search_generations=2),
}
"""Settings by preset."""


def detailed_hexapod() -> Robot:
    """The hexapod with `KINDS` as the parameters of its simulation.

    Raises:
      InputError: the template does not contain the numbers that become parameters here.
    """
    robot = hexapod()
    text = robot.template
    limb = '<geom name="b{{ %d + leg }}" class="limb"'
    places = {limb % first: f'{limb % first} density="{{{{ rho[leg + {first - 3}] }}}}"' for first in (3, 9)}
    for motor in ("{{ 2 + leg }}_vertical", "{{ 2 + leg }}_frontal", "{{ 8 + leg }}"):
        places[f'joint="j{motor}"/>'] = f'joint="j{motor}" kp="{{{{ gain[leg] }}}}"/>'
    for old, new in places.items():
        if text.count(old) != 1:
            raise InputError(f"assets/hexapod.xml.j2: expected {old!r} once, found it {text.count(old)} times")
        text = text.replace(old, new)
    lists = {"rho": KINDS["densities"], "gain": KINDS["motor gains"]}
    text = "".join(f"{{%- set {name} = [{', '.join(names)}] -%}}\n" for name, names in lists.items()) + text
    names = [name for group in KINDS.values() for name in group]
    low, high = ([RANGES[kind][end] for kind, group in KINDS.items() for _ in group] for end in (0, 1))
    lengths = dict(zip(robot.simulation_box.names, robot.nominal_simulation, strict=True))
    middle = {name: (a + b) / 2 for name, a, b in zip(names, low, high, strict=True)} | lengths
    return replace(
        robot,
        name="hexapod, 32 parameters",
        template=text,
        simulation_box=Box(names, low, high),
        nominal=tuple(float(middle[name]) for name in names),
        constants=tuple((name, value) for name, value in HEXAPOD.items() if name not in names),
    )


def search(config: ThirtyConfig, seed: int, step: Step, journal: Journal) -> Arrays:
    """Identify a random robot."""
    bench = Bench.of(config, step)
    bench = replace(bench, robot=replace(detailed_hexapod(), duration=config.duration))
    box, share = bench.robot.simulation_box, config.horizon / config.duration
    truth = box.low + box.span * np.random.default_rng([seed, 8]).uniform(0.1, 0.9, box.n)
    unit = Box(list(box.names), 0.0, 1.0)
    start = box.low + box.span * away_from((truth - box.low) / box.span, unit, config.away, seed)
    controllers = bench.robot.controller_box.sample(np.random.default_rng([seed, 5]), config.trials)
    measured = journal(lambda: bench.early(truth[None], controllers)[0], config.trials * share)

    def distance(simulations: np.ndarray) -> np.ndarray:
        cost = len(simulations) * config.trials * share
        return journal(lambda: multiscale_fitness(bench.early(simulations, controllers), measured), cost)

    found = cma_es(distance, box, start, config.members, config.search_generations, seed)
    return {**vars(found), "truth": truth, "start": start, "low": box.low, "span": box.span}


def units(config: ThirtyConfig) -> list[Unit]:
    """One search per seed."""
    cost = (config.members * config.search_generations + 1) * config.trials * config.horizon / config.duration
    return [Unit(f"search-{seed}", cost, partial(search, config, seed)) for seed in range(config.seeds)]


def compute(config: ThirtyConfig) -> int:
    """Compute the searches that are missing; returns how many there were."""
    return run_units(config, units(config), "thirty")


def errors(arrays: Arrays) -> np.ndarray:
    """(g, 32) error of the best member so far, as a share of each parameter's range."""
    best = Search(arrays["parameters"], arrays["values"], arrays["simulated"]).best
    return np.abs(best - arrays["truth"]) / arrays["span"]


def draw(folder: Path) -> list[Path]:
    """thirty.json and thirty.png from the saved searches."""
    found = load(folder, "search")
    bounds = np.cumsum([0, *(len(group) for group in KINDS.values())])
    slices = {kind: slice(a, b) for kind, a, b in zip(KINDS, bounds[:-1], bounds[1:], strict=True)}
    summary: dict[str, Any] = {
        kind: {
            "start": interval([float((np.abs(a["start"] - a["truth"]) / a["span"])[part].mean()) for a in found]),
            **interval([float(errors(a)[-1, part].mean()) for a in found], np.median),
            "values": [float(errors(a)[-1, part].mean()) for a in found],
        }
        for kind, part in slices.items()
    }
    summary["distance"] = interval([float(np.nanmin(a["values"])) for a in found])
    write_json(folder / "thirty.json", summary)
    with figure_of(5.2, 3.2) as figure:
        axes = figure.subplots()
        lines = ["-", "--", "-.", ":", (0, (5, 1))]
        for (kind, part), line in zip(slices.items(), lines, strict=True):
            for arrays in found:
                axes.plot(errors(arrays)[:, part].mean(axis=1), "k", linestyle=line, lw=0.8, label=kind)
        handles, labels = axes.get_legend_handles_labels()
        shown = dict(zip(labels, handles, strict=True))
        axes.legend(shown.values(), shown.keys(), fontsize=7)
        axes.set(yscale="log", xlabel="generation", ylabel="mean error / range")
        return [folder / "thirty.json", save(figure, folder / "thirty.png")]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "thirty_unknowns", argv, compute, draw)


if __name__ == "__main__":
    main()
