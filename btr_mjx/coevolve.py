"""Co-evolve a hexapod and its simulation: `python -m btr_mjx.coevolve`.

A hidden simulation plays reality. The run folder holds:

    config.json, environment.json   what was asked for, and with which versions and machine
    generations.parquet             one row per generation of either search
    iterations.parquet              one row per iteration of Back-to-Reality
    trials.npz                      every evaluation in reality: controllers, f_r, f_s, iteration
    controllers-001.npz, ...        all controllers of step 1 of iteration 1: parameters and fitness in simulation
    simulations-001.npz, ...        all simulations of step 3 of iteration 1: unknown parameters and Delta_fitness
    result.json                     the numbers that a script wants
    *.png                           figures, drawn from these files
"""

import dataclasses
import sys
import types
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from btr_mjx.backtoreality import (
    BTRSettings,
    Problem,
    SearchSettings,
    SimulatedReality,
    State,
    state_from_arrays,
    state_to_arrays,
    summarise,
    summary_table,
)
from btr_mjx.backtoreality import algorithm as backtoreality
from btr_mjx.errors import InputError, cli_errors, resume_command
from btr_mjx.evaluation import MARKS, EngineSettings, fitness_function
from btr_mjx.models import base_model
from btr_mjx.plotting import draw as plots
from btr_mjx.robots import Robot, robot_of
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    StopRequest,
    chosen_folder,
    graceful_interrupt,
    progress,
    write_arrays,
    write_json,
)


@dataclass(frozen=True)
class CoevolveConfig:
    """Settings of a run; every field is a flag."""

    preset: Literal["quick", "paper"] = "quick"
    """quick: two unknown lengths, about a minute. paper: the four unknown lengths of Fig. 4, m = 15."""
    out: Path | None = None
    """Run folder; by default the first unused one of runs/<preset>-<seed>, runs/<preset>-<seed>-2, ..."""
    resume: bool = False
    """Continue the run in --out."""
    seed: int = 0
    """Seed of everything random."""
    engine: Literal["auto", "lanes", "mjx", "native"] = "auto"
    """How simulations are computed; auto takes the fastest that can."""
    progress: bool = True
    """Show a progress bar (lines now and then where there is no terminal)."""
    figures: bool = True
    """Draw the figures at the end."""

    unknown: tuple[str, ...] = ("bl_5", "bl_14")
    """Parameters of the simulation that are searched, or "all"; the others are known."""
    truth: tuple[str, ...] = ("preset",)
    """Hidden reality s_r: NAME=VALUE of unknown parameters [m], or "preset" for the preset's own values (quick:
    bl_5=0.88 bl_14=1.6, paper: bl_3=0.54 bl_5=0.54 bl_6=0.74 bl_8=0.74); unknown parameters not named are drawn from
    the seed."""
    start: Literal["nominal", "random"] = "nominal"
    """s_0: the nominal lengths, or random values of the unknown ones."""

    iterations: int = 3
    """At most so many iterations of Back-to-Reality."""
    trials: int = 10
    """m, controllers tried in reality per iteration."""
    max_evaluations: int | None = None
    """Stop before exceeding so many evaluations in reality."""
    target_delta: float | None = None
    """Stop once Delta_fitness is at most this [unit of the fitness]."""
    behaviours: Literal["latest", "all"] = "all"
    """Delta_fitness over the behaviours of the latest iteration (the paper), or over all so far."""
    distance: Literal["fitness", "multiscale"] = "fitness"
    """What step 3 minimises: Delta_fitness (the paper), or the fitness at several early marks of the trial, which finds
    many unknown parameters from few trials."""
    marks: tuple[float, ...] = MARKS
    """Marks of the multiscale distance [s]."""
    optimiser: Literal["ga", "cma"] = "ga"
    """How step 3 searches: the genetic algorithm (the paper), or CMA-ES, which finds many unknown parameters far better
    and ends early once it has converged."""
    fitness: str = "distance"
    """Fitness function: distance, forward_speed or energy_per_metre."""

    controllers: int = 48
    """M, population of controllers."""
    controller_generations: int = 6
    """Generations of step 1."""
    p_m: float = 0.02
    """Probability per bit of flipping a controller's bit."""
    controller_bits: int = 8
    """Bits per controller parameter."""
    simulations: int = 24
    """L, population of simulations."""
    simulation_generations: int = 8
    """Generations of step 3."""
    simulation_p_m: float = 0.1
    """Probability per bit of flipping a simulation's bit."""
    simulation_bits: int = 10
    """Bits per unknown parameter."""

    reality_engine: Literal["same", "lanes", "mjx", "native"] = "same"
    """Engine that runs the hidden reality; native is float64 and shares no code with the others."""
    reality_timestep: float | None = None
    """Another time step of a native reality [s]."""
    reality_integrator: Literal["euler", "implicitfast", "implicit", "rk4"] | None = None
    """Another integrator of a native reality."""
    noise: float = 0.0
    """Relative standard deviation of the noise on measured fitness."""
    duration: float = 1.7
    """T_e, duration of a trial [s]."""
    template: Path | None = None
    """Another MJCF template of the hexapod, with the same parameters and motors."""


PRESETS: dict[str, CoevolveConfig] = {
    "quick": CoevolveConfig(),
    "paper": CoevolveConfig(
        preset="paper",
        unknown=("bl_3", "bl_5", "bl_6", "bl_8"),
        start="random",
        iterations=5,
        trials=15,
        behaviours="latest",
        controllers=60,
        controller_generations=10,
        simulations=50,
        simulation_generations=30,
        simulation_p_m=0.05,
    ),
}
"""Defaults by the value of --preset."""

PRESET_TRUTH: dict[str, dict[str, float]] = {
    "quick": {"bl_5": 0.88, "bl_14": 1.6},
    "paper": {"bl_3": 0.54, "bl_5": 0.54, "bl_6": 0.74, "bl_8": 0.74},
}
"""Realities of the paper's Fig. 2 and Fig. 4 [m]."""


def parse_values(robot: Robot, settings: Sequence[str]) -> dict[str, float]:
    """Read NAME=VALUE settings of simulation parameters.

    Raises:
      InputError: another form, an unknown name, a value that is no number or outside its bounds.
    """
    box, values = robot.simulation_box, {}
    for setting in settings:
        name, separator, text = setting.partition("=")
        index = box.index(name)
        try:
            value = float(text)
        except ValueError:
            value = None
        if not separator or value is None:
            raise InputError(f"got {setting!r}, expected NAME=NUMBER such as {box.names[index]}={box.high[index]}")
        box.subspace([name]).validate([value], setting)
        values[name] = value
    return values


def build_problem(config: CoevolveConfig) -> Problem:
    """Turn a config into the problem that `algorithm` solves.

    Raises:
      InputError: any setting that is out of its range; nothing has been written by then.
    """
    robot = robot_of(config.template, config.duration)
    box = robot.simulation_box
    unknown = box.names if config.unknown == ("all",) else tuple(config.unknown)
    indices = box.indices(unknown)
    named = [setting for setting in config.truth if setting != "preset"]
    given = parse_values(robot, named)
    if "preset" in config.truth:
        own = PRESET_TRUTH[config.preset]
        given = {name: value for name, value in own.items() if name in unknown} | given
    for name in given:
        if name not in unknown:
            raise InputError(f"truth {name}={given[name]}: {name} is not among the unknown ({', '.join(unknown)})")
    # Two streams, so that naming some of the true values does not change where the search starts.
    drawn = box.sample(np.random.default_rng([config.seed, 101]))
    truth, start = robot.nominal_simulation, robot.nominal_simulation
    truth[indices] = [given.get(name, drawn[i]) for name, i in zip(unknown, indices, strict=True)]
    if config.start == "random":
        start[indices] = box.sample(np.random.default_rng([config.seed, 102]))[indices]
    native = config.reality_engine == "native"
    if not native and (config.reality_timestep or config.reality_integrator):
        raise InputError("reality_timestep and reality_integrator need --reality-engine native")
    if config.reality_timestep is not None and not 0 < config.reality_timestep <= 0.01:
        raise InputError(f"reality_timestep: got {config.reality_timestep}, expected a step within (0, 0.01] s")
    engine = None if config.engine == "auto" else config.engine
    fitness = fitness_function(config.fitness)
    return Problem(
        robot=robot,
        reality=SimulatedReality(
            robot,
            tuple(truth.tolist()),
            engine if config.reality_engine == "same" else config.reality_engine,
            EngineSettings(timestep=config.reality_timestep, integrator=config.reality_integrator),
            fitness,
            config.noise,
            config.seed,
        ),
        unknown=unknown,
        start=start,
        settings=BTRSettings(
            controllers=SearchSettings(
                config.controllers, config.controller_generations, config.p_m, config.controller_bits
            ),
            trials=config.trials,
            simulations=SearchSettings(
                config.simulations, config.simulation_generations, config.simulation_p_m, config.simulation_bits
            ),
            iterations=config.iterations,
            max_evaluations=config.max_evaluations,
            target_delta=config.target_delta,
            behaviours=config.behaviours,
            distance=config.distance,
            marks=config.marks,
            optimiser=config.optimiser,
        ),
        fitness=fitness,
        engine=engine,
        seed=config.seed,
    )


def coevolve(config: CoevolveConfig | None = None, **changes: Any) -> dict[str, Any]:
    """Run Back-to-Reality in a run folder.

    Args:
      config: the settings; None for the quick preset.
      **changes: fields of the config to replace.

    Returns:
      What result.json holds.

    Raises:
      InputError: bad settings, or a folder that cannot take this run.
      Interrupted: a signal asked to stop; everything up to the last generation is saved.
    """
    config = resolve_folder(dataclasses.replace(config or PRESETS[changes.get("preset", "quick")], **changes))
    problem = build_problem(config)
    # Whatever can be found wrong is found before anything is written.
    backtoreality.begin(problem)
    base_model(problem.robot)
    assert config.out is not None
    ignore = (*IGNORED_FIELDS, "figures")
    with RunFolder.create(config.out, config, config.resume, ignore=ignore) as run, graceful_interrupt() as stop:
        state = _run(problem, run, stop, config.progress)
        result = summarise(problem, state)
        _write_trials(run.path, state)
        write_json(run.path / "result.json", result)
        if config.figures:
            plots.draw_run(run.path)
    return result


def resolve_folder(config: CoevolveConfig) -> CoevolveConfig:
    """Choose a run folder where none is named.

    Raises:
      InputError: a resume that does not say of what.
    """
    out = chosen_folder(config.out, config.resume, f"{config.preset}-{config.seed}")
    return dataclasses.replace(config, out=out)


def _run(problem: Problem, run: RunFolder, stop: StopRequest, show: bool) -> State:
    checkpoint = run.load_latest()
    tables = {name: run.history(f"{name}s.parquet", checkpoint) for name in ("generation", "iteration")}
    if checkpoint is None:
        state, step = backtoreality.begin(problem), 0
    else:
        state, step = state_from_arrays(checkpoint.arrays, checkpoint.meta), checkpoint.step + 1

    def report(kind: str, row: dict[str, Any]) -> None:
        if kind == "archive":
            _write_archive(run.path, problem, row)
        else:
            tables[kind].append(row)

    with progress(total=_pairs_left(problem, state), description="pairs", unit="pairs", show=show or False) as bar:
        problem = dataclasses.replace(problem, progress=bar.update)
        while state.phase != "done":
            bar.set_description(f"iteration {state.iteration}: {_DOING[state.phase]}")
            phase = state.phase
            state = backtoreality.advance(problem, state, report)
            if phase == "simulations" != state.phase:  # the search may have ended early
                bar.total = bar.n + _pairs_left(problem, state)
            run.save_checkpoint(step, *state_to_arrays(state))
            step += 1
            stop.checkpoint()
    return state


_DOING = {
    "baseline": "first controller",
    "controllers": "evolving controllers",
    "transfer": "trying controllers in reality",
    "simulations": "evolving simulations",
}


def _pairs_left(problem: Problem, state: State) -> int:
    """Pairs that remain to be simulated if no stop criterion is met early (an estimate after a resume)."""
    settings = problem.settings
    left = 0 if state.phase != "baseline" else 1
    for iteration in range(state.iteration, settings.iterations + 1):
        behaviours = settings.trials * (iteration if settings.behaviours == "all" else 1)
        done = len(state.scores) if iteration == state.iteration else 0
        if iteration > state.iteration or state.phase in ("baseline", "controllers"):
            left += settings.controllers.population * (settings.controllers.generations - done) + behaviours
            done = 0
        left += settings.simulations.population * behaviours * (settings.simulations.generations - done)
    return left


def _write_archive(folder: Path, problem: Problem, row: dict[str, Any]) -> None:
    """All members of one search; the same bytes whenever it is written again after a resume."""
    box = problem.controller_box if row["phase"] == "controllers" else problem.simulation_box
    name = "fitness" if row["phase"] == "controllers" else "delta_fitness"
    arrays = {"parameters": box.decode(row["genomes"]), name: row["scores"], "names": np.array(box.names)}
    write_arrays(folder / f"{row['phase']}-{row['iteration']:03d}.npz", arrays, compress=True)


def _write_trials(folder: Path, state: State) -> None:
    write_arrays(folder / "trials.npz", vars(state.trials))


def parse(argv: Sequence[str]) -> CoevolveConfig:
    """Read the command line; --preset chooses the defaults of all other flags."""
    chosen = "quick"
    for position, word in enumerate(argv):
        if word == "--preset" and position + 1 < len(argv):
            chosen = argv[position + 1]
        elif word.startswith("--preset="):
            chosen = word.removeprefix("--preset=")
    default = PRESETS.get(chosen, PRESETS["quick"])  # tyro names the valid ones if it is neither
    return tyro.cli(CoevolveConfig, args=list(argv), default=default, description=__doc__, prog="btr_mjx.coevolve")


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    argv = sys.argv[1:] if argv is None else list(argv)
    config = parse(argv)
    with cli_errors():
        config = resolve_folder(config)
        with cli_errors(resume_command("btr_mjx.coevolve", argv, config.out)):
            result = coevolve(config)
        assert config.out is not None
        print(summary_table(result, config.out))


class _CallableModule(types.ModuleType):
    """Lets `btr_mjx.coevolve(...)` run although `btr_mjx.coevolve` is also this module's name."""

    def __call__(self, config: CoevolveConfig | None = None, **changes: Any) -> dict[str, Any]:
        return coevolve(config, **changes)


if __name__ == "__main__":
    main()
else:
    sys.modules[__name__].__class__ = _CallableModule
