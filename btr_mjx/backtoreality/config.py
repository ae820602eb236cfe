"""Settings of a co-evolution, and the `Problem` that they define."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from btr_mjx.backtoreality.given_settings import flags_of
from btr_mjx.backtoreality.kept_inputs import with_kept_files
from btr_mjx.backtoreality.reality import (
    FolderReality,
    Reality,
    Rounds,
    SimulatedReality,
    numbers_of_file,
    robot_of_file,
    variables,
)
from btr_mjx.backtoreality.run_state import Problem
from btr_mjx.backtoreality.settings import BTRSettings, Distance, RunSettings, check_settings
from btr_mjx.errors import InputError, resume_command
from btr_mjx.evaluation import EngineSettings, FitnessFunction
from btr_mjx.models import chosen_robot, load_robot
from btr_mjx.robots import PAPER_REALITIES, Robot, hexapod


@dataclass(frozen=True)
class CoevolveConfig(RunSettings, BTRSettings):
    """Settings of a run; every field is a flag."""

    preset: Literal["quick", "paper"] = "quick"
    """quick: two unknown lengths, about a minute. paper: the four unknown lengths of Fig. 4, m = 15."""
    out: Path | None = None
    """Run folder; by default the first unused one of runs/<preset>-<seed>, runs/<preset>-<seed>-2, ..."""
    resume: bool = False
    """Continue the run in --out."""
    unknown: tuple[str, ...] = ("preset",)
    """Parameters of the simulation that are searched, "all", or "preset" for the preset's own (quick: bl_5 bl_14); of
    another robot that is all. The others are known."""
    truth: tuple[str, ...] = ("preset",)
    """Hidden reality s_r: NAME=VALUE of unknown parameters, or "preset" for the preset's own values (quick:
    bl_5=0.88 bl_14=1.6, paper: bl_3=0.54 bl_5=0.54 bl_6=0.74 bl_8=0.74); unknown parameters not named are drawn from
    the seed, all of them for another robot."""
    start: Literal["nominal", "random"] = "nominal"
    """s_0: the nominal values, or random values of the unknown ones."""

    reality: Literal["simulation", "folder"] = "simulation"
    """simulation: a hidden simulation plays reality. folder: a robot is reached through files in --exchange."""
    exchange: Path | None = None
    """Folder through which trials and measurements are exchanged; by default exchange in the run folder."""
    wait: bool = False
    """Wait for measurements; otherwise the command ends where some are missing, with exit code 75, to be continued with
    --resume."""
    signal_rate: float = 200.0
    """Samples per second of the reference signals in --exchange."""
    reality_model: Path | None = None
    """Another MJCF for the hidden reality, with the same joints and motors: what the simulator lacks. Its numbers stand
    as they are; variables of a template (.j2) have the values of --truth, or are drawn."""
    reality_engine: Literal["same", "lanes", "mjx", "native"] = "same"
    """Engine that runs the hidden reality. same: that of the searches, or native for a reality with a model of its own,
    whose few trials are done before lanes has compiled. native is float64 and shares no code with the others."""
    reality_timestep: float | None = None
    """Another time step of a native reality [s]."""
    reality_integrator: Literal["euler", "implicitfast", "implicit", "rk4"] | None = None
    """Another integrator of a native reality."""
    noise: float = 0.0
    """Relative standard deviation of the noise on measured fitness."""


PRESETS: dict[str, CoevolveConfig] = {
    "quick": CoevolveConfig(),
    "paper": CoevolveConfig(
        preset="paper",
        distance="fitness",
        start="random",
        iterations=5,
        trials=15,
        behaviours="latest",
        controllers=60,
        controller_generations=10,
        first_population="mutants",
        simulations=50,
        simulation_generations=30,
        simulation_p_m=0.05,
    ),
}
"""Defaults by the value of --preset."""

_REALITY_OF_PRESET = {"quick": "fig2", "paper": "fig4"}
"""Preset -> figure of the paper whose reality is hidden."""


def minimised_distance(config: CoevolveConfig) -> Distance:
    """What step 3 minimises, see `CoevolveConfig.distance`."""
    if config.distance != "auto":
        return config.distance
    known = config.robot is None and config.template is None and config.reality == "simulation" and not config.grow
    return "multiscale" if known and (config.duration is None or config.duration > config.marks[-1]) else "fitness"


def parse_values(robot: Robot, settings: Sequence[str]) -> dict[str, float]:
    """Values of simulation parameters from NAME=VALUE settings."""
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


def setting_of_robot(robot: Robot) -> dict[str, Any]:
    """Settings by which a run folder finds a robot again.

    Returns:
      None for the hexapod, with its duration; the robot.toml beside the robot's model if it describes this robot. Of
      any other one a description, which no command can read: it is for `build_problem` with the robot.
    """
    if robot == replace(hexapod(), duration=robot.duration):
        return {"robot": None, "duration": robot.duration}
    file = Path(robot.template_path).parent / "robot.toml"
    if file.is_file() and load_robot(file) == robot:
        return {"robot": file}
    return {"robot": Path(f"a program's robot {robot.name!r}")}


def build_problem(config: CoevolveConfig, robot: Robot | None = None) -> Problem:
    """The problem that a config defines, of a robot where the config names no file; writes no files.

    A file that is gone is read from the copy in the run folder, see `with_kept_files`.

    Raises:
      InputError: a setting that is out of its range.
    """
    read = with_kept_files(config)
    if robot is None:
        robot = chosen_robot(read.robot, read.template, config.duration)
    elif config.template is not None:
        raise InputError(f"template {config.template}: the robot {robot.name} has its own")
    elif config.duration is not None:
        robot = replace(robot, duration=config.duration)
    check_settings(config, robot)
    box = robot.simulation_box
    unknown = tuple(config.unknown)
    own = PAPER_REALITIES[_REALITY_OF_PRESET[config.preset]] if config.robot is None else {}
    if unknown == ("all",) or (unknown == ("preset",) and config.robot is not None):
        unknown = box.names
    elif unknown == ("preset",):
        unknown = tuple(own)
    indices = box.indices(unknown)
    named = [setting for setting in config.truth if setting != "preset"]
    given = parse_values(robot, named)
    if "preset" in config.truth:
        given = {name: value for name, value in own.items() if name in unknown} | given
    for name in given:
        if name not in unknown:
            raise InputError(f"truth {name}={given[name]}: {name} is not among the unknown ({', '.join(unknown)})")
    real = robot if read.reality_model is None else robot_of_file(robot, read.reality_model)
    if read.reality_model is not None:
        _check_variables(read.reality_model, real, [setting.partition("=")[0] for setting in named])
    # Two random generators, so that giving some of the true values does not change the start of the search.
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
    engine, fitness = config.engine_or_none, read.fitness_of(robot)
    same = engine if config.reality_model is None else "native"
    told = None
    if real is not robot:
        free = variables(real)
        truth = np.where([name in free for name in box.names], truth, robot.nominal)
        told = numbers_of_file(robot, real, {name: float(truth[box.index(name)]) for name in free})
    reality: Reality = SimulatedReality(
        real,
        tuple(truth.tolist()),
        same if config.reality_engine == "same" else config.reality_engine,
        EngineSettings(timestep=config.reality_timestep, integrator=config.reality_integrator),
        fitness,
        config.noise,
        config.seed,
        told=told,
    )
    if config.reality == "folder":
        reality = _folder_reality(config, robot, fitness)
    return Problem(
        robot=robot,
        reality=reality,
        unknown=unknown,
        start=start,
        settings=replace(config, distance=minimised_distance(config)),
        fitness=fitness,
        engine=engine,
        seed=config.seed,
    )


def _check_variables(model: Path, real: Robot, named: Sequence[str]) -> None:
    """Raise InputError where a value is given to a number that a reality's file has itself."""
    fixed = [name for name in named if name not in variables(real)]
    if fixed:
        raise InputError(
            f"truth {fixed[0]}: the reality is {model}, whose numbers stand as they are; change it there, or leave "
            "--truth or --reality-model out"
        )


def _folder_reality(config: CoevolveConfig, robot: Robot, fitness: FitnessFunction) -> FolderReality:
    """The reality behind a folder; settings of a simulated reality are refused."""
    hidden = [
        name
        for name in ("reality_model", "reality_timestep", "reality_integrator")
        if getattr(config, name) is not None
    ]
    hidden += ["noise"] * bool(config.noise) + ["truth"] * (config.truth != ("preset",))
    if hidden:
        raise InputError(f"--{hidden[0].replace('_', '-')} is for a simulated reality, and --reality is folder")
    folder = config.exchange or (config.out and config.out / "exchange")
    if folder is None:
        raise InputError("--reality folder: needs --exchange DIR or --out DIR")
    flags = flags_of(config, PRESETS[config.preset], leave_out=("resume", "preset"))
    command = resume_command("btr_mjx.coevolve", ["--preset", config.preset, *flags])
    return FolderReality(robot, folder, fitness, config.signal_rate, Rounds(config.iterations, config.trials, command))
