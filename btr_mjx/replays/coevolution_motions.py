"""Motions of a co-evolution: simulation and reality, before and after."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality import (
    CoevolveConfig,
    FolderReality,
    Problem,
    SimulatedReality,
    build_problem,
    grown,
    inputs_of,
    with_kept_files,
)
from btr_mjx.errors import InputError
from btr_mjx.evaluation import Engine, EngineSettings, FitnessFunction, evaluate
from btr_mjx.gap.data import Recording
from btr_mjx.models import base_model, compile_models, start_of
from btr_mjx.plotting import highlight
from btr_mjx.replays.replay_records import Replay, ReplayedMotion, frame_times, hold_last_valid
from btr_mjx.robots import Robot
from btr_mjx.runs import check_inputs, read_arrays, read_config, read_json


def coevolution_replay(folder: Path, frames: int) -> Replay:
    """What the simulation promised at first and what became of it: two controllers, in simulation and in reality.

    Before: the controller of iteration 1 with the best predicted fitness, in the simulation of the start. After: the
    controller of the last iteration with the best measured fitness, in the identified simulation. The trials are
    simulated again in native MuJoCo. Of a reality behind a folder those trials are shown of which it holds a recording;
    where there is none, the two simulations are shown in one row.
    """
    problem = build_problem(with_kept_files(replace(read_config(folder, CoevolveConfig), out=folder), gone_only=False))
    check_inputs(folder, inputs_of(problem))
    result, trials = read_json(folder / "result.json"), read_arrays(folder / "trials.npz")
    final = grown(problem, result["effects"])
    identified = final.robot.nominal_simulation
    identified[final.robot.simulation_box.indices(result["simulation"])] = list(result["simulation"].values())
    best, promised = _best_trial(result, trials), _promised_trial(trials, problem.fitness.maximise)
    last = int(trials["iteration"].max())
    start = "nominal" if np.array_equal(problem.start, problem.robot.nominal_simulation) else "initial"
    times = frame_times(problem.robot.duration, frames, float(base_model(problem.robot).opt.timestep))
    rows: list[list[ReplayedMotion]] = []
    for when, which, robot, simulation, words, trial in (
        ("before", ("best predicted", 1), problem.robot, problem.start, f"{start} parameters", promised),
        ("after", ("best measured", last), final.robot, identified, "identified parameters", best),
    ):
        controller = trials["controllers"][trial]
        simulated = _simulated(robot, simulation, controller, problem, times)
        row = [replace(simulated, title=f"{when}: simulation", detail=f"{words}, iteration {which[1]}")]
        real = _real(problem, controller, trial, times, float(trials["f_r"][trial]))
        if real is not None:
            detail = f"{which[0]}, iteration {which[1]}"
            row.append(replace(real, title=f"{when}: reality", detail=detail, measured=True))
        rows.append(row)
    shown = np.concatenate([[0.0], times])
    return Replay(shown, rows if any(len(row) > 1 for row in rows) else [[row[0] for row in rows]])


def _promised_trial(trials: dict[str, np.ndarray], maximise: bool) -> int:
    """Index of the trial of iteration 1 whose predicted fitness is best."""
    f_s = np.where(trials["iteration"] == 1, trials["f_s"], np.nan)
    return int(np.nanargmax(f_s) if maximise else np.nanargmin(f_s))


def _best_trial(result: dict[str, Any], trials: dict[str, np.ndarray]) -> int:
    """Index of the trial of the best controller of the last iteration."""
    best = np.array(result["best_controller"])
    own = (trials["controllers"] == best).all(axis=1) & (trials["iteration"] == trials["iteration"].max())
    if not own.any():
        raise InputError("trials.npz does not hold the best controller of result.json: files of different runs")
    return int(np.flatnonzero(own)[0])


def _simulated(
    robot: Robot,
    simulation: np.ndarray,
    controller: np.ndarray,
    problem: Problem,
    times: np.ndarray,
    settings: EngineSettings | None = None,
) -> ReplayedMotion:
    """A trial of a robot, simulated again in native MuJoCo or its own simulator."""
    engine: Engine | None = None if robot.simulator is not None else "native"
    found = evaluate(
        robot, [simulation], [controller], engine=engine, fitness=problem.fitness, times=times, states=True,
        settings=settings,
    )  # fmt: skip
    assert found.outcome.qpos is not None
    model = compile_models(robot, simulation).row(0)
    own = [name for name in problem.unknown if name in robot.simulation_box.names]
    highlight(robot, [model], robot.simulation_box.indices(own))
    start = start_of(robot)
    first = model.qpos0 if start is None else start[0]
    number = _with_unit(float(found.fitness[0, 0]), problem.fitness)
    return ReplayedMotion(
        "", "", number, model, hold_last_valid(np.concatenate([first[None], found.outcome.qpos[0, 0]]))
    )


def _real(problem: Problem, controller: np.ndarray, trial: int, times: np.ndarray, f_r: float) -> ReplayedMotion | None:
    """A trial in reality; None where nothing of it can be shown."""
    reality = problem.reality
    if isinstance(reality, SimulatedReality):
        settings = reality.settings if reality.engine == "native" else None
        return _simulated(reality.robot, np.array(reality.truth), controller, problem, times, settings)
    recordings: Sequence[Recording] = []
    if isinstance(reality, FolderReality):
        recordings = reality.record(controller[None], [trial])
    if not recordings:
        return None
    qpos = sampled(recordings[0], np.concatenate([[0.0], times]))
    return ReplayedMotion("", "", _with_unit(f_r, problem.fitness), recordings[0].model, qpos)


def sampled(recording: Recording, times: np.ndarray) -> np.ndarray:
    """Measured positions (F, nq) nearest to times (F,) after the first sample [s]."""
    since = recording.time - recording.time[0]
    right = np.clip(np.searchsorted(since, times), 1, len(since) - 1)
    return recording.qpos[right - (times - since[right - 1] < since[right] - times)]


def _with_unit(value: float, fitness: FitnessFunction) -> str:
    return f"{value:.3g} {fitness.unit}".rstrip() if np.isfinite(value) else "diverged"
