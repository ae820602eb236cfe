"""Scan: Delta_fitness of simulations that differ in one parameter."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.backtoreality.controller_search import evolve_controllers, select_transferable
from btr_mjx.backtoreality.kept_inputs import with_kept_files
from btr_mjx.backtoreality.run_state import Progress
from btr_mjx.backtoreality.settings import RunSettings, SearchSettings, check_settings
from btr_mjx.cluster import BlockSettings, evaluate_blocks
from btr_mjx.errors import InputError
from btr_mjx.evaluation import FitnessFunction, delta_of, evaluate, metrics
from btr_mjx.models import chosen_robot
from btr_mjx.optimise import mutate
from btr_mjx.robots import PAPER_REALITIES, PAPER_STARTS, Robot


def delta(
    robot: Robot, simulations: ArrayLike, controllers: ArrayLike, f_real: ArrayLike, **options: Any
) -> np.ndarray:
    """delta_k = |f_sk - f_rk| (eq. 3) of every simulation and behaviour.

    Args:
      robot: the robot.
      simulations: (L, n_s).
      controllers: (m, n_c).
      f_real: (m,) fitness of the controllers in reality.
      **options: engine, fitness, settings and progress of `evaluate`.

    Returns:
      (L, m); NaN where a pair diverged.

    Raises:
      InputError: bad parameters, or f_real is not of shape (m,).
    """
    return delta_of(evaluate(robot, simulations, controllers, **options).fitness, f_real)


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
    Robot.expect(robot)
    box = robot.simulation_box
    index = box.index(parameter)
    values = np.asarray(grid)
    if values.ndim == 0:
        if values < 2:
            raise InputError(f"grid: got {values}, expected at least 2 points, or a list of values")
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
class ScanConfig(RunSettings):
    """Settings of a scan; every field is a flag."""

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


@dataclass(frozen=True, eq=False)
class Scan:
    """What the settings of a scan define.

    Attributes:
      robot, fitness, parameter: what is scanned.
      start, truth: the parameter's value where controllers evolve, and in reality.
      evolution: of the controllers; None for random ones.
      blocks: how pairs are divided; their blocks are kept in the run folder.
    """

    robot: Robot
    fitness: FitnessFunction
    parameter: str
    start: float
    truth: float
    evolution: SearchSettings | None
    blocks: BlockSettings


def build_scan(config: ScanConfig) -> Scan:
    """The scan that a config defines, with all checks that need no simulation.

    Raises:
      InputError: bad settings, or a cluster without Dask.
    """
    read = with_kept_files(config)
    robot = chosen_robot(read.robot, read.template, config.duration)
    check_settings(config, robot)
    box, paper = robot.simulation_box, config.robot is None
    parameter = config.parameter or ("bl_14" if paper else box.names[0])
    index, evolved = box.index(parameter), config.behaviours != "random"
    truths, starts = (PAPER_REALITIES["fig2"], PAPER_STARTS) if paper else ({}, {})
    truth = truths.get(parameter, robot.nominal[index]) if config.truth is None else config.truth
    start = starts.get(parameter, float(box.low[index])) if config.start is None else config.start
    if config.start is not None and not evolved:
        raise InputError(f"start {config.start:g}: controllers evolve there, and --behaviours random evolves none")
    along(robot, parameter, [truth, start])
    evolution = SearchSettings(config.controllers, config.generations, config.p_m) if evolved else None
    if config.behaviours == "evolved" and config.trials >= config.controllers:
        raise InputError(
            f"trials m = {config.trials}: expected fewer than the controller population M = {config.controllers}"
        )
    folder = None if config.out is None else config.out / "blocks"
    blocks = BlockSettings(folder, config.block, config.cluster)
    return Scan(robot, read.fitness_of(robot), parameter, start, float(truth), evolution, blocks)


def _behaviours(config: ScanConfig, scan: Scan, step: Progress | None) -> np.ndarray:
    """The m controllers (m, n_c) of a scan, see `ScanConfig.behaviours`."""
    robot = scan.robot
    rng = np.random.default_rng([config.seed, 2])
    if scan.evolution is None:
        return robot.controller_box.sample(rng, config.trials)
    how: dict[str, Any] = {"fitness": scan.fitness, "engine": config.engine_or_none, "progress": step}
    simulation = along(robot, scan.parameter, [scan.start])[0]
    genomes, scores = evolve_controllers(robot, simulation, scan.evolution, seed=config.seed, **how)
    chosen, _ = select_transferable(genomes, scores, config.trials, scan.fitness.maximise)
    if not len(chosen):
        raise InputError("every controller diverged in the starting simulation; change the robot or the fitness")
    if config.behaviours == "mutants":
        chosen = mutate(np.tile(chosen[0], (config.trials, 1)), config.p_m, rng)
    return robot.controller_box.with_bits(scan.evolution.bits).decode(chosen)


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
    scan = build_scan(config)
    robot, parameter, controllers = scan.robot, scan.parameter, _behaviours(config, scan, step)
    how: dict[str, Any] = {"engine": config.engine_or_none, "fitness": scan.fitness, "progress": step}
    f_r = evaluate(robot, along(robot, parameter, [scan.truth]), controllers, **how).fitness[0]
    line = along(robot, parameter, config.grid)
    table = evaluate_blocks(robot, line, controllers, blocks=scan.blocks, **how)
    deltas, index = delta_of(table.fitness, f_r), robot.simulation_box.index(parameter)
    arrays = {
        "parameter": np.array(parameter),
        "grid": line[:, index],
        "truth": np.array(scan.truth),
        "controllers": controllers,
        "fitness": table.fitness,
        "f_r": f_r,
        "delta": deltas,
        "delta_fitness": deltas.mean(axis=1),
    }
    result = {
        **curve_statistics(line[:, index], arrays["delta_fitness"], scan.truth),
        "pairs": int(deltas.size),
        "diverged": int(table.diverged.sum()),
        "solver_capped_steps": int(table.solver_capped.sum()),
        "engine": table.engine,
        "evolved_at": None if scan.evolution is None else scan.start,
        "parameter_unit": robot.simulation_box.units[index],
        "fitness_unit": scan.fitness.unit,
    }
    return arrays, result
