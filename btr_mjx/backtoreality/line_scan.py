"""Scan: Delta_fitness of simulations that differ in one parameter."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.backtoreality.controller_search import evolve_controllers, select_transferable
from btr_mjx.backtoreality.setting_checks import check_settings
from btr_mjx.backtoreality.state import Progress, SearchSettings
from btr_mjx.cluster import BlockSettings, evaluate_blocks
from btr_mjx.errors import InputError
from btr_mjx.evaluation import (
    DISTANCE,
    Engine,
    EngineSettings,
    FitnessLike,
    delta_of,
    evaluate,
    fitness_function,
    metrics,
)
from btr_mjx.models import chosen_robot
from btr_mjx.optimise import mutate
from btr_mjx.robots import PAPER_REALITIES, PAPER_STARTS, Robot


def delta(
    robot: Robot,
    simulations: ArrayLike,
    controllers: ArrayLike,
    f_real: ArrayLike,
    *,
    engine: Engine | None = None,
    fitness: FitnessLike = DISTANCE,
    settings: EngineSettings | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """delta_k = |f_sk - f_rk| (eq. 3) of every simulation and behaviour.

    Args:
      robot: the robot.
      simulations: (L, n_s).
      controllers: (m, n_c).
      f_real: (m,) fitness of the controllers in reality.
      engine: see `evaluate`.
      fitness: see `evaluate`.
      settings: see `EngineSettings`.
      progress: called with the number of pairs done since the last call.

    Returns:
      (L, m); NaN where a pair diverged.

    Raises:
      InputError: bad parameters, or f_real is not of shape (m,).
    """
    how = settings or EngineSettings()
    evaluation = evaluate(
        robot, simulations, controllers, engine=engine, fitness=fitness, settings=how, progress=progress
    )
    return delta_of(evaluation.fitness, f_real)


def delta_fitness(
    robot: Robot, simulations: ArrayLike, controllers: ArrayLike, f_real: ArrayLike, **options: Any
) -> np.ndarray:
    """Delta_fitness (eq. 4) of every simulation, (L,); NaN where a pair diverged. Arguments as of `delta`."""
    return delta(robot, simulations, controllers, f_real, **options).mean(axis=1)


def along(robot: Robot, parameter: str, grid: int | ArrayLike, base: ArrayLike | None = None) -> np.ndarray:
    """Simulations that differ in one parameter.

    Args:
      robot: the robot.
      parameter: its name.
      grid: number of points over the parameter's whole range, or (G,) its values.
      base: (n_s,) values of the other parameters; None for the nominal ones.

    Returns:
      (G, n_s).

    Raises:
      InputError: unknown parameter, values out of bounds, fewer than two points.
    """
    box = robot.simulation_box
    index = box.index(parameter)
    values = np.asarray(grid)
    if values.ndim == 0:
        if values < 2:
            raise InputError(f"grid: got {values}, expected at least 2 points")
        values = np.linspace(box.low[index], box.high[index], int(values))
    base = robot.nominal_simulation if base is None else box.validate(base, "base")
    return box.embed(base, [parameter], values[:, None])


def curve_statistics(grid: ArrayLike, curve: ArrayLike, truth: float) -> dict[str, float]:
    """Statistics of how well a distance over one parameter orders simulations by their error.

    Args:
      grid: (G,) values of the parameter.
      curve: (G,) distance, such as Delta_fitness.
      truth: the parameter's value in reality.

    Returns:
      spearman: rho between the curve and |grid - truth|; spearman_left and _right: on either side of the truth, NaN
      where it has fewer than three points; monotonicity: fraction of neighbouring pairs ordered as their errors;
      roughness: total variation over range; at_minimum: the parameter's value at the minimum of the curve.
    """
    x, y = np.asarray(grid, float), np.asarray(curve, float)
    left, right = np.moveaxis(np.asarray(metrics.side_spearman(y, x, truth)), -1, 0)
    error = np.abs(x - truth)
    return {
        "spearman": float(metrics.spearman(y, error)),
        "spearman_left": float(left),
        "spearman_right": float(right),
        "monotonicity": float(metrics.monotonicity(y, error)),
        "roughness": float(metrics.roughness(y)),
        "at_minimum": float(x[np.nanargmin(y)]) if np.isfinite(y).any() else float("nan"),
    }


@dataclass(frozen=True)
class ScanConfig:
    """Settings of a scan; every field is a flag."""

    robot: Path | None = None
    """A robot.toml that describes another robot, see docs/robot_file.md; by default the hexapod of the paper."""
    parameter: str | None = None
    """Parameter of the simulation that is scanned; by default bl_14, or the first of another robot."""
    grid: int = 49
    """Points over its whole range."""
    truth: float | None = None
    """Its value in reality; by default the paper's for bl_14 (1.6) and bl_5 (0.88), else the nominal value."""
    start: float | None = None
    """Its value in the simulation in which the controllers evolve; by default the paper's for bl_14 (0.4) and bl_5
    (0.64), else its lowest value."""
    out: Path | None = None
    """Run folder; without it the statistics are printed and nothing is saved."""
    resume: bool = False
    """Continue the scan in --out: blocks of pairs that are there are not computed again."""
    block: int = 4096
    """Pairs per block, the unit that is saved and, on a cluster, given to a worker."""
    cluster: str | None = None
    """Compute on a Dask cluster: local:N (N workers on this machine), tcp://HOST:PORT or file:SCHEDULER.json."""
    seed: int = 0
    """Seed of everything random."""
    engine: Literal["auto", "lanes", "mjx", "native"] = "auto"
    """How simulations are computed; auto takes the fastest that can."""
    progress: bool = True
    """Show a progress bar."""
    figures: bool = True
    """Draw the page and its figure at the end."""

    trials: int = 15
    """m, number of behaviours."""
    behaviours: Literal["evolved", "mutants", "random"] = "evolved"
    """evolved: the m best that evolution finds in the simulation of --start (Fig. 2); mutants: m mutants of
    the best of them, with --p-m (Fig. 3); random: drawn from the controller box."""
    p_m: float = 0.02
    """Probability per bit of flipping a controller's bit."""
    controllers: int = 60
    """M, population of controllers."""
    generations: int = 10
    """Generations of the controllers' evolution."""
    fitness: str | None = None
    """Fitness function: distance (the hexapod's), forward_speed, energy_per_metre, target_distance, or FILE.py:NAME; by
    default the robot's own."""
    duration: float | None = None
    """T_e, duration of a trial [s]; by default the robot's own (hexapod: 1.7)."""
    template: Path | None = None
    """Another MJCF template of the hexapod, with the same parameters and motors."""


def behaviours_of(config: ScanConfig, robot: Robot, simulation: np.ndarray, step: Progress | None) -> np.ndarray:
    """The m controllers (m, n_c) of a scan, see `ScanConfig.behaviours`."""
    rng = np.random.default_rng([config.seed, 2])
    if config.behaviours == "random":
        return robot.controller_box.sample(rng, config.trials)
    settings = SearchSettings(config.controllers, config.generations, config.p_m)
    box = robot.controller_box.with_bits(settings.bits)
    function = fitness_function(config.fitness or robot.fitness, robot.target)
    genomes, scores = evolve_controllers(
        robot, simulation, settings, seed=config.seed, fitness=function, engine=_engine(config), progress=step
    )
    chosen, _ = select_transferable(genomes, scores, config.trials, function.maximise)
    if not len(chosen):
        raise InputError("every controller diverged in the starting simulation; change the robot or the fitness")
    if config.behaviours == "mutants":
        chosen = mutate(np.tile(chosen[0], (config.trials, 1)), config.p_m, rng)
    return box.decode(chosen)


def run_scan(config: ScanConfig, step: Progress | None = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Compute a scan.

    Args:
      config: the settings.
      step: called with the number of pairs simulated since the last call.

    Returns:
      The arrays of scan.npz and the numbers of result.json.

    Raises:
      InputError: bad settings.
    """
    robot, truth = check_scan(config)
    function, parameter = fitness_function(config.fitness or robot.fitness, robot.target), scanned(config, robot)
    line = along(robot, parameter, config.grid)
    start = start_value(config, robot)
    controllers = behaviours_of(config, robot, along(robot, parameter, [start])[0], step)
    reality = along(robot, parameter, [truth])
    engine = _engine(config)
    f_r = evaluate(robot, reality, controllers, engine=engine, fitness=function, progress=step).fitness[0]
    table = evaluate_blocks(
        robot, line, controllers, engine=engine, fitness=function, blocks=block_settings(config), progress=step
    )
    deltas = delta_of(table.fitness, f_r)
    grid = line[:, robot.simulation_box.index(parameter)]
    arrays = {
        "parameter": np.array(parameter),
        "grid": grid,
        "truth": np.array(truth),
        "controllers": controllers,
        "fitness": table.fitness,
        "f_r": f_r,
        "delta": deltas,
        "delta_fitness": deltas.mean(axis=1),
    }
    result = {
        **curve_statistics(grid, arrays["delta_fitness"], truth),
        "pairs": int(deltas.size),
        "diverged": int(table.diverged.sum()),
        "solver_capped_steps": int(table.solver_capped.sum()),
        "engine": table.engine,
        "evolved_at": None if config.behaviours == "random" else start,
        "parameter_unit": robot.simulation_box.units[robot.simulation_box.index(parameter)],
        "fitness_unit": function.unit,
    }
    return arrays, result


def check_scan(config: ScanConfig) -> tuple[Robot, float]:
    """Check all settings that can be checked without simulating.

    Returns:
      The robot, and the parameter's value in reality.

    Raises:
      InputError: bad settings.
    """
    robot = chosen_robot(config.robot, config.template, config.duration)
    check_settings(config, robot)
    parameter = scanned(config, robot)
    index = robot.simulation_box.index(parameter)
    own = PAPER_REALITIES["fig2"] if config.robot is None else {}
    truth = own.get(parameter, robot.nominal[index]) if config.truth is None else config.truth
    along(robot, parameter, [truth])
    if config.start is not None and config.behaviours == "random":
        raise InputError(f"start {config.start:g}: controllers evolve there, and --behaviours random evolves none")
    along(robot, parameter, [start_value(config, robot)])
    if config.grid < 2 or config.trials < 1:
        raise InputError(f"grid {config.grid} and trials {config.trials}: expected at least 2 and 1")
    if config.behaviours != "random":
        settings = SearchSettings(config.controllers, config.generations, config.p_m)
        if config.trials >= settings.population and config.behaviours == "evolved":
            raise InputError(
                f"trials m = {config.trials}: expected fewer than the controller population M = {config.controllers}"
            )
    fitness_function(config.fitness or robot.fitness, robot.target)
    block_settings(config)
    return robot, float(truth)


def block_settings(config: ScanConfig) -> BlockSettings:
    """How the pairs of a scan are divided; their blocks are kept in the run folder.

    Raises:
      InputError: bad settings, or a cluster without Dask.
    """
    folder = None if config.out is None else config.out / "blocks"
    return BlockSettings(folder, config.block, config.cluster)


def scanned(config: ScanConfig, robot: Robot) -> str:
    """Name of the parameter that is scanned."""
    return config.parameter or ("bl_14" if config.robot is None else robot.simulation_box.names[0])


def start_value(config: ScanConfig, robot: Robot) -> float:
    """The parameter's value in the simulation in which the controllers evolve, see `ScanConfig.start`."""
    if config.start is not None:
        return config.start
    parameter, box = scanned(config, robot), robot.simulation_box
    own = PAPER_STARTS if config.robot is None else {}
    return float(own.get(parameter, box.low[box.index(parameter)]))


def _engine(config: ScanConfig) -> Engine | None:
    return None if config.engine == "auto" else config.engine
