"""Evaluation of pairs (s, c): simulate the behaviour and compute its fitness.

    evaluation = evaluate(robot, simulations, controllers)      # fitness (L, M)

Pairs are divided into blocks of one fixed shape, so that a single compiled program serves any number of pairs and
memory does not grow. For a fixed chunk size, the result of a pair is bit-identical at any position and beside any other
pairs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.engines import Record
from btr_mjx.errors import InputError
from btr_mjx.evaluation.engine_choice import Engine, EngineSettings, run_pairs
from btr_mjx.evaluation.fastest import fastest_engine
from btr_mjx.evaluation.fitness import FitnessFunction, FitnessLike, Outcome, fitness_of
from btr_mjx.models import base_model
from btr_mjx.robots import Robot


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Fitness of a batch of pairs, of shape (L, M), or (B,) where evaluated pairwise.

    Attributes:
      fitness: f_E of each pair; NaN where it diverged.
      diverged: pairs whose state became invalid, or whose base passed the robot's speed limit.
      solver_capped: number of steps in which the constraint solver reached its iteration limit.
      peak_speed: highest speed of the base [m/s].
      outcome: data from which the fitness was computed.
      engine: the engine that ran.
      tripped: pairs of which `engine` does not compute a contact that may have taken part, as its guards found; native
        MuJoCo has evaluated them instead.
    """

    fitness: np.ndarray
    diverged: np.ndarray
    solver_capped: np.ndarray
    peak_speed: np.ndarray
    outcome: Outcome
    engine: Engine
    tripped: np.ndarray


def evaluate(
    robot: Robot,
    simulations: ArrayLike,
    controllers: ArrayLike,
    *,
    pairwise: bool = False,
    engine: Engine | None = None,
    fitness: FitnessLike | None = None,
    times: ArrayLike | None = None,
    states: bool = False,
    settings: EngineSettings | None = None,
    progress: Callable[[int], object] | None = None,
) -> Evaluation:
    """Evaluate controllers in simulations.

    Args:
      robot: the robot.
      simulations: (L, n_s) parameters inside the robot's simulation box.
      controllers: (M, n_c) parameters inside the robot's controller box.
      pairwise: evaluate row i with row i (L = M = B) rather than every simulation with every controller.
      engine: "lanes", "mjx" or "native"; None for the one that is measured to be the fastest for this robot, see
        `choose_engine`. Pairs in which a contact may take part that "lanes" does not compute are evaluated by native
        MuJoCo, see `Evaluation.tripped`.
      fitness: a fitness function, or its name as in a robot.toml, see `fitness_function`; None for the robot's own.
      times: (K,) sample times in (0, T_e] [s] for the outcome, rounded to steps; None for the end alone. The last one
        ends the trial.
      states: whether the outcome holds qpos, qvel and act at the sample times.
      settings: how the engine runs; None for the defaults.
      progress: called with the number of pairs done since the last call.

    Returns:
      The evaluation.

    Raises:
      InputError: parameters out of bounds, of a wrong shape or not finite, unequal rows where pairwise, bad times, an
        unknown fitness.
      UnsupportedModel: the given engine does not support this robot.
    """
    Robot.expect(robot)
    fitness, settings = fitness_of(robot, fitness), settings or EngineSettings()
    s, c = checked_pairs(robot, simulations, controllers)
    if pairwise and len(s) != len(c):
        raise InputError(f"pairwise: got {len(s)} simulations and {len(c)} controllers, expected as many of each")
    shape = (len(s),) if pairwise else (len(s), len(c))
    recorded, own = states or fitness.needs_states or bool(robot.point), float(base_model(robot).opt.timestep)
    chosen = engine or fastest_engine(
        robot, samples=sample_steps(robot, times, own), states=recorded, chunk=settings.chunk
    )
    dt = settings.timestep if chosen == "native" and settings.timestep else own
    samples = sample_steps(robot, times, dt)
    record = run_pairs(
        *(robot, s, c),
        engine=chosen,
        samples=samples,
        states=recorded,
        settings=settings,
        pairwise=pairwise,
        progress=progress,
    )
    return _evaluation(robot, chosen, record, samples * dt, shape, fitness, recorded)


def checked_pairs(robot: Robot, simulations: ArrayLike, controllers: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Simulations (L, n_s) and controllers (M, n_c) as arrays.

    Raises:
      InputError: parameters out of bounds, of a wrong shape or not finite, or none.
    """
    s = np.atleast_2d(robot.simulation_box.validate(simulations, "simulations"))
    c = np.atleast_2d(robot.controller_box.validate(controllers, "controllers"))
    if s.ndim != 2 or c.ndim != 2 or not len(s) or not len(c):
        raise InputError(
            f"got simulations {s.shape} and controllers {c.shape}, expected non-empty (L, n_s) and (M, n_c)"
        )
    return s, c


def _evaluation(
    robot: Robot,
    engine: Engine,
    record: Record,
    times: np.ndarray,
    shape: tuple[int, ...],
    fitness: FitnessFunction,
    states: bool,
) -> Evaluation:
    whole = {name: np.asarray(value, np.float64) for name, value in record._asdict().items()}
    whole = {name: value.reshape(*shape, *value.shape[1:]) for name, value in whole.items()}
    outcome = Outcome(
        times,
        whole["start"],
        whole["position"],
        whole["energy"],
        *(whole[name] if states else None for name in ("qpos", "qvel", "act")),
    )
    finite = np.isfinite(outcome.position).all((-2, -1))
    if robot.simulator is None:
        finite &= np.isfinite(outcome.energy).all(-1)
    # NaN fails the comparison: an invalid speed counts as too fast.
    diverged = ~(finite & (whole["peak_speed"] <= robot.speed_limit))
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.where(diverged, np.nan, fitness(outcome))
    counts, tripped = whole["capped"].astype(int), whole["tripped"].astype(bool)
    return Evaluation(values, diverged, counts, whole["peak_speed"], outcome, engine, tripped)


def sample_steps(robot: Robot, times: ArrayLike | None, timestep: float) -> np.ndarray:
    """Step counts (K,) of sample times [s], or of the end of the trial."""
    wanted = np.atleast_1d(np.asarray(robot.duration if times is None else times, np.float64))
    steps = np.round(wanted / timestep)
    if wanted.ndim != 1 or not wanted.size or not np.all(np.isfinite(steps)) or np.any(np.diff(steps, prepend=0) < 1):
        raise InputError(
            f"times: got {wanted.tolist()}, expected ascending times at least one step of {timestep} s apart"
        )
    if wanted[-1] > robot.duration * (1 + 1e-9):
        raise InputError(f"times: got {wanted[-1]} s, expected at most the trial's duration of {robot.duration} s")
    return steps.astype(int)
