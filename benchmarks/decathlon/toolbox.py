"""The rival mujoco.sysid, MuJoCo's own toolbox for identification, on the same recordings.

It fits dry friction, damping, rotor inertia, gain and constant force of each joint, and one delay of all commands: the
positions of short stretches of the recordings to fit, simulated from measured states, by its own least squares with
finite differences. It is told bounds, a step of the differences and a limit of time.
"""

import importlib
import io
import time
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from machine import Log, Machine, Trial
from open_loop import Predictor, believed_models, commands, start_velocity
from rivals import GAINS, balance, predictor, with_numbers

sysid: Any = importlib.import_module("mujoco.sysid")
"""The toolbox; for an import statement, mypy would take its types for those of all of MuJoCo."""
LENGTH = 2.0
"""Length of a stretch [s], if predictions are not compared over a shorter time."""
TOTAL, MOST = 40.0, 40
"""Length of all stretches together [s] and number of stretches, at most and about."""
DELAY, STEP = 0.1, 1e-3
"""Longest delay [s], and step of the finite differences as a share of a parameter's unit."""
DIVERGED = 1e3
"""Difference as which a simulation that diverges counts, at most [rad or m]."""
SECONDS = 180.0
"""Processor time for a machine; the best numbers by then count."""
FIELDS = ("dof_frictionloss", "dof_damping", "dof_armature")
KINDS = (*FIELDS, "gain", "offset")
"""Numbers of each joint that are fitted, as `rivals.with_numbers` takes them."""


def fitted(machine: Machine, trial: Trial, seconds: float = SECONDS) -> tuple[dict[str, Any], Predictor | None]:
    """Fit a machine.

    Args:
      machine: gives the time over which predictions are compared.
      trial: recordings and believed models.
      seconds: limit of processor time.

    Returns:
      Numbers that are added to the believed ones, (nv,) each, delay [s], processor time [s] and whether the fit ended
      in it, or under "refused" why there is none; and the predictions of the fitted models.
    """
    models, begun = believed_models(trial), time.process_time()
    if (models[""].jnt_type <= int(mujoco.mjtJoint.mjJNT_BALL)).any():
        return {"refused": "not run: a free joint has no friction, damping, rotor inertia and gain to fit"}, None
    params, units = unknowns(trial, models)
    parts = {name: stretches_to_fit(machine, trial, name) for name in models}
    residuals = [differences(models[name], trial, own, units) for name, own in parts.items() if own]
    tried: list[tuple[float, np.ndarray]] = []

    def residual(x: np.ndarray, now: Any) -> tuple[list[np.ndarray], list[Any], list[Any]]:
        found = [one(x, now) for one in residuals]
        if x.size == params.size:  # a point, not those of the finite differences
            tried.append((sum(float(np.sum(part**2)) for part in found), x.ravel().copy()))
        if time.process_time() - begun > seconds:
            raise TimeoutError
        return found, [], []

    ended = True
    try:
        sysid.optimize(params, residual, verbose=False, output=io.StringIO(), eps=STEP, x_scale="jac")
    except TimeoutError:
        ended = False
    params.update_from_vector(min(tried, key=lambda one: one[0])[1])
    numbers, delay = as_numbers(params, units)
    row = {kind: values.tolist() for kind, values in numbers.items()} | {"delay": delay, "ended": ended}
    return row | {"cpu_seconds": time.process_time() - begun}, predictor(trial, numbers, delay)


def unknowns(trial: Trial, models: Mapping[str, mujoco.MjModel]) -> tuple[Any, dict[str, Any]]:
    """Parameters of the toolbox and their units: what the forces along the recordings to fit allow."""
    model = models[""]
    rows = [np.stack(balance(models[log.own_model], log)) for log in trial.logs if log.split == "fit"]
    inverse, driven, speed, acceleration = np.sqrt(np.mean(np.concatenate(rows, axis=1) ** 2, axis=1))
    force, one = np.maximum(inverse, driven), np.ones(model.nv)
    sizes = (force, force / speed, force / acceleration, one, force)
    # Commands that are held move by whole steps of the simulation, so that one of them is the smallest difference.
    units = dict(zip(KINDS, sizes, strict=True)) | {"delay": model.opt.timestep / STEP}
    params = sysid.ParameterDict()
    for field in FIELDS:
        params.add(sysid.Parameter(field, 0 * one, -getattr(model, field) / units[field], 2 * one))
    params.add(sysid.Parameter("gain", one, GAINS[0] * one, GAINS[1] * one))
    params.add(sysid.Parameter("offset", 0 * one, -one, one))
    params.add(sysid.Parameter("delay", 0.0, 0.0, DELAY / units["delay"]))
    return params.move_off_bounds(), units


def as_numbers(params: Any, units: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], float]:
    """Numbers of the joints by kind, (nv,) each, and the delay [s]."""
    return {kind: params[kind].value * units[kind] for kind in KINDS}, float(params["delay"].value[0] * units["delay"])


def stretches_to_fit(machine: Machine, trial: Trial, name: str) -> list[tuple[Log, int, float]]:
    """Recording, first sample and length [s] of stretches, evenly spread, of the recordings with a given model."""
    length = min(LENGTH, machine.horizon or LENGTH)
    rooms = [(log, log.time[-1] - log.time[0] - length) for log in trial.logs if log.split == "fit"]
    count, total, out = min(MOST, TOTAL / length), sum(room for _, room in rooms if room > 0), []
    for log, room in ((log, room) for log, room in rooms if log.own_model == name and room > 0):
        starts = log.time[0] + np.linspace(0, room, 2 + round(count * room / total))[:-1]
        out += [(log, int(first), length) for first in np.searchsorted(log.time, starts, side="right") - 1]
    return out


def differences(
    model: mujoco.MjModel, trial: Trial, parts: list[tuple[Log, int, float]], units: Mapping[str, Any]
) -> Callable[[np.ndarray, Any], np.ndarray]:
    """Differences of positions over the stretches of one model, as a function of the toolbox's parameters."""
    grid = model.opt.timestep * np.arange(round(parts[0][2] / model.opt.timestep) + 1)
    trajectories = []
    for log, first, _ in parts:
        at = log.time[first] + grid
        measured = np.column_stack([np.interp(at, log.time, column) for column in log.qpos.T])
        state = sysid.create_initial_state(model, log.qpos[first], start_velocity(model, log, first))
        series = [sysid.TimeSeries(grid, values) for values in (commands(log, trial.interpolation, at), measured)]
        trajectories.append(sysid.SystemTrajectory(model, *series, state, None))

    def build(params: Any) -> mujoco.MjModel:
        return with_numbers(model, as_numbers(params, units)[0])

    def rolled(*, control_signal: Any, param_dicts: Any, **rest: Any) -> Any:
        late = [grid - as_numbers(params, units)[1] for params in param_dicts]
        moved = [commands(log, trial.interpolation, log.time[k] + at) for at in late for log, k, _ in parts]
        return sysid.sysid_rollout(control_signal=[sysid.TimeSeries(grid, ctrl) for ctrl in moved], **rest)

    def differ(_: Any, predicted: Any, measured: Any, *rest: Any, state: np.ndarray) -> Any:
        away = np.nan_to_num(state[:, 1 : 1 + model.nq] - measured.data[1:], nan=DIVERGED)
        return np.clip(away, -DIVERGED, DIVERGED), measured, measured

    def residual(x: np.ndarray, params: Any) -> np.ndarray:
        found, *_ = sysid.model_residual(
            x, params, build, trajectories, differ, rolled, n_threads=1, resample_true=False
        )
        # A column for each stretch of each point; the optimiser wants one for each point.
        return found if x.ndim == 1 else found.T.reshape(x.shape[1], -1).T

    return residual
