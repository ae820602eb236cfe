"""Fig. 4: `uv run python experiments/fig4_identification.py`. Does a small distance imply a correct simulation?

Four unknown lengths (the paper's): bl_3 = bl_5 = 0.54 m, bl_6 = bl_8 = 0.74 m are hidden, the rest is known; 15 mutants
of an evolved controller were tried in reality. (a) Delta_fitness over 100 generations of the genetic algorithm, (b) the
parameters of all its members, (c) the error of the best member against simulated trials, with CMA-ES at as many,
(d) sensitivity: Delta_fitness around the truth, one parameter at a time, as its change per metre.

Twelve unknown lengths: (e) CMA-ES from 0.25 m away, by Delta_fitness and by `distances.multiscale_fitness` of random
controllers at eight marks within 0.05 s: with exact measurements, and with a reality that is native MuJoCo at another
time step and integrator; at marks within 0.1 s of more controllers with 5 % of noise on every number; and Adam on the
marks of the exact measurements, at as many trials.

The run folder holds one file per search and seed, NAME-0.npz, ...: parameters (g, L, n), values (g, L), simulated
(g,), truth (n,), start (n,), trials (g,) whole trials simulated so far; behaviours-0.npz: controllers (m, n_c) that
the search of four tries in reality; and sensitivity-0.npz: offsets (O,) [m], delta and multiscale (12, O). fig4.json
holds the statistics over seeds, fig4.png the figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import Bench
from common import TINY, Config, command
from curves import interval
from fig2_scans import evolve
from fig4_drawing import draw_searches
from identification import Distance, Search, adam, away_from, cma_es, genetic
from units import Arrays, Journal, Step, Unit, load, run_units

from btr_mjx.errors import InputError
from btr_mjx.evaluation import EngineSettings, delta_fitness_of, multiscale_fitness
from btr_mjx.optimise import mutate
from btr_mjx.runs import read_arrays, write_json

TRUTH = {"bl_3": 0.54, "bl_5": 0.54, "bl_6": 0.74, "bl_8": 0.74}
"""The paper's hidden lengths [m]."""

OTHER_PHYSICS = EngineSettings(timestep=2.5e-4, integrator="rk4")
"""Settings of a reality without the inverse crime: native MuJoCo in float64 with half the time step and fourth-order
Runge-Kutta instead of the first-order implicit integrator."""

OFFSETS = (-0.12, -0.06, -0.03, -0.015, 0.0, 0.015, 0.03, 0.06, 0.12)
"""Offsets from the truth at which distances are evaluated [m]."""


@dataclass(frozen=True, kw_only=True)
class Fig4Config(Config):
    """Settings of Fig. 4."""

    p_m: float = 0.2
    """Probability per bit of the mutants that are tried."""
    away: float = 0.2
    """How far every one of the four unknown lengths is off at the start [m]."""
    members: int = 50
    """L of the searches of four lengths."""
    search_generations: int = 100
    """Generations of the genetic algorithm there."""
    cma_generations: int = 30
    """Generations of CMA-ES there; it stops earlier once it has converged."""
    simulation_p_m: tuple[float, float] = (0.2, 0.02)
    """Probability per bit of the genetic algorithm, in its first and in its last generation."""
    tournament: int = 3
    """Contestants per tournament of the genetic algorithm."""
    bits: int = 10
    """Bits per length."""
    away_12: float = 0.25
    """How far every one of twelve unknown lengths is off at the start [m]."""
    members_12: int = 32
    """L of their searches."""
    generations_12: int = 120
    """Their generations."""
    horizon_12: float = 0.05
    """Last mark of their multiscale distance [s]. Later marks include contacts, which create local minima."""
    noisy_trials: int = 45
    """Behaviours where measurements are noisy."""
    horizon_noisy: float = 0.1
    """Last mark with noise [s]: the information of later marks outweighs the local minima that they create."""
    noise: float = 0.05
    """Relative standard deviation of that noise."""

    def check(self) -> None:
        """As `Config.check`."""
        super().check()
        for name in ("horizon_12", "horizon_noisy"):
            if not 0 < getattr(self, name) <= self.duration:
                raise InputError(f"{name}: got {getattr(self, name)} s, expected within the trial of {self.duration} s")
        if min(self.members, self.members_12) < 4 or self.noisy_trials < 2 or not 0 <= self.noise < 1:
            raise InputError(
                f"members {self.members} and {self.members_12}, noisy_trials {self.noisy_trials}, noise {self.noise}: "
                "expected at least 4, 4 and 2, and less than 1"
            )


PRESETS = {
    "quick": Fig4Config(
        seeds=2, trials=8, members=24, search_generations=12, cma_generations=12, generations_12=60, noisy_trials=20
    ),
    "paper": Fig4Config(preset="paper", seeds=5),
    "tiny": Fig4Config(
        preset="tiny",
        **TINY,
        members=6,
        search_generations=3,
        cma_generations=3,
        members_12=6,
        generations_12=2,
        noisy_trials=4,
        horizon_12=0.02,
        horizon_noisy=0.04,
    ),
}
"""Settings by preset."""

SEARCHES_12 = {"delta-12": 20, "multiscale-12": None, "noisy-12": None, "native-12": None, "adam-12": None}
"""Searches of twelve lengths -> maximum number of generations (None for the setting)."""


def hidden(bench: Bench) -> np.ndarray:
    """Reality (n_s,): the paper's four lengths, the others nominal."""
    box = bench.robot.simulation_box
    return box.embed(bench.robot.nominal_simulation, list(TRUTH), list(TRUTH.values()))


def mutants_of_best(config: Fig4Config, bench: Bench, start: np.ndarray, seed: int, journal: Journal) -> np.ndarray:
    """The behaviours tried in reality (m, n_c): mutants of the best controller evolved in s_0."""
    count = config.population * config.generations
    best = journal(lambda: evolve(bench, config, start, seed)[0][0], count)
    rng = np.random.default_rng([seed, 4])
    mutants = mutate(np.tile(best, (config.trials, 1)), config.p_m, rng)
    return bench.robot.controller_box.with_bits(config.search.bits).decode(mutants)


def recorded(search: Search, truth: np.ndarray, start: np.ndarray, per_member: float) -> Arrays:
    """The arrays of a search; `per_member` is what one member costs, in whole trials."""
    cost = per_member * np.cumsum(search.simulated)
    return {**vars(search), "truth": truth, "start": start, "trials": cost}


def start_of_four(config: Fig4Config, bench: Bench, seed: int) -> np.ndarray:
    """Where the search of four lengths starts (4,)."""
    inner = bench.robot.simulation_box.subspace(list(TRUTH))
    return away_from(np.array(list(TRUTH.values())), inner, config.away, seed)


def behaviours(config: Fig4Config, seed: int, step: Step, journal: Journal) -> Arrays:
    """Unit of the behaviours tried in reality when four lengths are unknown: the same for all searches of a seed."""
    bench = Bench.of(config, step)
    start = bench.robot.simulation_box.embed(hidden(bench), list(TRUTH), start_of_four(config, bench, seed))
    return {"controllers": mutants_of_best(config, bench, start, seed, journal)}


def behaviours_of(config: Fig4Config, seed: int) -> np.ndarray:
    """The behaviours (m, n_c) that `behaviours` left in the run folder."""
    return read_arrays(config.folder / f"behaviours-{seed}.npz")["controllers"]


def four(config: Fig4Config, method: str, seed: int, step: Step, journal: Journal) -> Arrays:
    """The paper's search, by the genetic algorithm or by CMA-ES."""
    bench = Bench.of(config, step)
    names, reality = list(TRUTH), hidden(bench)
    box = bench.robot.simulation_box.subspace(names).with_bits(config.bits)
    truth = np.array(list(TRUTH.values()))
    start = start_of_four(config, bench, seed)
    embed = partial(bench.robot.simulation_box.embed, reality, names)
    controllers = behaviours_of(config, seed)
    f_r = journal(lambda: bench.whole(reality[None], controllers)[0, :, -1], config.trials)

    def distance(values: np.ndarray) -> np.ndarray:
        cost = len(values) * config.trials
        return journal(lambda: delta_fitness_of(bench.whole(embed(values), controllers)[..., -1], f_r), cost)

    if method == "ga":
        schedule = config.members, config.search_generations, config.simulation_p_m
        search = genetic(distance, box, start, *schedule, seed, config.tournament)
    else:
        search = cma_es(distance, box, start, config.members, config.cma_generations, seed)
    return recorded(search, truth, start, config.trials)


def squares(f_s: np.ndarray, f_r: np.ndarray) -> np.ndarray:
    """The multiscale distance with squares instead of clipped absolute values, which has a gradient everywhere."""
    return (((f_s - f_r) / f_r.std(axis=0)) ** 2).mean(axis=(-2, -1))


def adam_steps(config: Fig4Config, unknown: int) -> int:
    """Steps that simulate as many members as CMA-ES does."""
    return max(1, config.members_12 * config.generations_12 // (2 * unknown + 1))


def twelve(config: Fig4Config, name: str, seed: int, step: Step, journal: Journal) -> Arrays:
    """All lengths unknown: CMA-ES by one of the distances."""
    bench = Bench.of(config, step)
    box, reality = bench.robot.simulation_box, hidden(bench)
    start = away_from(reality, box, config.away_12, seed)
    if name == "delta-12":
        controllers = mutants_of_best(config, bench, start, seed, journal)
        share = 1.0
        f_r = journal(lambda: bench.whole(reality[None], controllers)[0, :, -1], config.trials)
        measure = lambda s: delta_fitness_of(bench.whole(s, controllers)[..., -1], f_r)  # noqa: E731
    else:
        count = config.noisy_trials if name == "noisy-12" else config.trials
        controllers = bench.robot.controller_box.sample(np.random.default_rng([seed, 5]), count)
        horizon = config.horizon_noisy if name == "noisy-12" else config.horizon_12
        bench = bench.with_marks_until(horizon)
        share = horizon / config.duration
        other = OTHER_PHYSICS if name == "native-12" else None
        marks = journal(lambda: bench.early(reality[None], controllers, other)[0], count * share)
        if name == "noisy-12":
            marks = marks * (1 + config.noise * np.random.default_rng([seed, 6]).standard_normal(marks.shape))
        measure = lambda s: multiscale_fitness(bench.early(s, controllers), marks)  # noqa: E731
    cost = len(controllers) * share
    distance: Distance = lambda s: journal(lambda: measure(s), len(s) * cost)  # noqa: E731
    generations = min(config.generations_12, SEARCHES_12[name] or config.generations_12)
    if name == "adam-12":
        smooth: Distance = lambda s: journal(lambda: squares(bench.early(s, controllers), marks), len(s) * cost)  # noqa: E731
        search = adam(smooth, box, start, adam_steps(config, box.n))
    else:
        search = cma_es(distance, box, start, config.members_12, generations, seed)
    return recorded(search, reality, start, cost)


def sensitivity(config: Fig4Config, seed: int, step: Step, journal: Journal) -> Arrays:
    """Both distances around the truth, one parameter at a time, with the behaviours of the search of four."""
    bench = Bench.of(config, step)
    box, reality = bench.robot.simulation_box, hidden(bench)
    controllers = behaviours_of(config, seed)
    real = journal(lambda: bench.whole(reality[None], controllers)[0], config.trials)
    line = reality + np.array(OFFSETS)[None, :, None] * np.eye(box.n)[:, None, :]
    fitness = journal(lambda: bench.whole(line.reshape(-1, box.n), controllers), line.size / box.n * config.trials)
    fitness = fitness.reshape(*line.shape[:2], *fitness.shape[1:])
    return {
        "offsets": np.array(OFFSETS),
        "delta": delta_fitness_of(fitness[..., -1], real[:, -1]),
        "multiscale": multiscale_fitness(fitness[..., :-1], real[:, :-1]),
    }


def units(config: Fig4Config) -> list[Unit]:
    """One unit per search and seed, all searches of one seed before the next seed."""
    evolved = config.population * config.generations
    found = []
    for seed in range(config.seeds):
        found.append(Unit(f"behaviours-{seed}", evolved, partial(behaviours, config, seed)))
        for method, generations in (("ga", config.search_generations), ("cma", config.cma_generations)):
            cost = config.trials * (1 + config.members * generations)
            found.append(Unit(f"{method}-{seed}", cost, partial(four, config, method, seed)))
        cost = (12 * len(OFFSETS) + 1) * config.trials
        found.append(Unit(f"sensitivity-{seed}", cost, partial(sensitivity, config, seed)))
        for name, most in SEARCHES_12.items():
            members = config.members_12 * min(config.generations_12, most or config.generations_12)
            if name == "adam-12":
                members = adam_steps(config, 12) * 25
            noisy = name == "noisy-12"
            share = (config.horizon_noisy if noisy else config.horizon_12) / config.duration
            searched = (members + 1) * (config.noisy_trials if noisy else config.trials)
            trials = evolved + searched if name == "delta-12" else searched * share
            found.append(Unit(f"{name}-{seed}", trials, partial(twelve, config, name, seed)))
    return found


def compute(config: Fig4Config) -> int:
    """Compute the searches that are missing; returns how many there were."""
    return run_units(config, units(config), "fig4")


def search_of(arrays: Arrays) -> Search:
    """A search from its file."""
    return Search(arrays["parameters"], arrays["values"], arrays["simulated"])


def at_equal_cost(first: Arrays, second: Arrays) -> tuple[float, float]:
    """Errors of two searches of one seed at the last generations that both could afford [m]."""
    cost = min(first["trials"][-1], second["trials"][-1])
    pairs = (
        (search_of(a).error(a["truth"]), np.searchsorted(a["trials"], cost, side="right")) for a in (first, second)
    )
    one, other = (float(error[max(count - 1, 0)]) for error, count in pairs)
    return one, other


def summarise(folder: Path) -> dict[str, Any]:
    """Errors [m], distances and sensitivities of every seed, with intervals.

    Returns:
      searches: per search its final error and distance, those of its first generation and the error at the start;
      equal_cost: errors of CMA-ES and of the genetic algorithm at the same number of trials;
      felt: per length the change of either distance per metre at the truth (mean of both sides, 0.03 m away).
    """
    result: dict[str, Any] = {"searches": {}}
    for name in ("ga", "cma", *SEARCHES_12):
        rows = []
        for arrays in load(folder, name):
            search, truth = search_of(arrays), arrays["truth"]
            errors = np.abs(search.best - truth)
            rows.append(
                {
                    "error": float(errors[-1].mean()),
                    "worst": float(errors[-1].max()),
                    "start": float(np.abs(arrays["start"] - truth).mean()),
                    "first": float(errors[0].mean()),
                    "distance": float(np.nanmin(search.values)),
                    "distance_first": float(np.nanmin(search.values[0])),
                    "trials": float(arrays["trials"][-1]),
                    **{f"error_{i}": float(value) for i, value in enumerate(errors[-1])},
                }
            )
        keys = list(rows[0])
        result["searches"][name] = {
            key: {**interval([row[key] for row in rows]), "values": [row[key] for row in rows]} for key in keys
        }
    both = zip(load(folder, "cma"), load(folder, "ga"), strict=True)
    result["equal_cost"] = [at_equal_cost(cma, ga) for cma, ga in both]
    found = load(folder, "sensitivity")
    offsets = found[0]["offsets"]
    near = np.isclose(np.abs(offsets), 0.03)
    result["felt"] = {
        kind: [
            {"name": f"bl_{i + 3}", **interval([float(a[kind][i, near].mean() / 0.03) for a in found])}
            for i in range(len(found[0][kind]))
        ]
        for kind in ("delta", "multiscale")
    }
    result["at_truth"] = float(max(a["delta"][:, offsets == 0].max() for a in found))
    return result


def draw(folder: Path) -> list[Path]:
    """fig4.json and fig4.png from the saved searches; (a) and (b) show seed 0."""
    summary = summarise(folder)
    write_json(folder / "fig4.json", summary)
    searches = {name: load(folder, name) for name in ("ga", "cma", *SEARCHES_12)}
    return [folder / "fig4.json", draw_searches(folder / "fig4.png", list(TRUTH), searches, summary)]


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    command(PRESETS, __doc__, "fig4_identification", argv, compute, draw)


if __name__ == "__main__":
    main()
