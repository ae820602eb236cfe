"""Open-loop predictions of recordings in plain MuJoCo, and their errors, as a user would compute them."""

import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from machine import Log, Machine, Trial

from btr_mjx.gap.results import Callback, found_effects, mend

Predictor = Callable[[Log, int, int], tuple[np.ndarray, np.ndarray]]
"""From a recording and its first and last sample to positions (n, nq) and velocities (n, nv) at the samples between."""

Stretch = tuple[Log, int, int]
"""A part of a recording: the recording, its first and its last sample."""

WINDOW, LEAST = 0.02, 4
"""Half width of the fit that gives a starting velocity [s], and its smallest number of samples to either side."""


def start_velocity(model: mujoco.MjModel, log: Log, first: int) -> np.ndarray:
    """(nv,) Velocity at a sample: as logged, else the slope of a cubic fit to the positions around it."""
    if log.qvel is not None:
        return log.qvel[first]
    half = max(LEAST, round(WINDOW / float(np.median(np.diff(log.time)))))
    rows = slice(max(0, first - half), first + half + 1)
    since = log.time[rows] - log.time[first]
    out = np.empty(model.nv)
    for j in range(model.njnt):
        q, v = model.jnt_qposadr[j], model.jnt_dofadr[j]
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE:
            out[v] = np.polyfit(since, log.qpos[rows, q], 3)[-2]
        else:
            out[v : v + 3] = np.polyfit(since, log.qpos[rows, q : q + 3], 3)[-2]
            turned = np.zeros(3)
            a, b = log.qpos[rows][[0, -1], q + 3 : q + 7]
            mujoco.mju_subQuat(turned, b, a)
            out[v + 3 : v + 6] = turned / (since[-1] - since[0])
    return out


def commands(log: Log, interpolation: str | None, at: np.ndarray) -> np.ndarray:
    """(n, nu) Commands of a recording at given times; the first and the last one are held outside of it."""
    if interpolation == "hold":
        return log.ctrl[np.clip(np.searchsorted(log.time, at + 1e-9, side="right") - 1, 0, len(log.time) - 1)]
    return np.array([np.interp(at, log.time, column) for column in log.ctrl.T]).reshape(-1, len(at)).T


def simulated(
    model_of: Callable[[Log], tuple[mujoco.MjModel, Sequence[Any]]], interpolation: str | None, delay: float = 0.0
) -> Predictor:
    """Predictions of a model.

    Args:
      model_of: gives the model of a recording and the terms of its mended.json that need a callback.
      interpolation: of the commands.
      delay: by which commands act late [s].
    """

    def predict(log: Log, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        model, terms = model_of(log)
        model = copy.copy(model)  # a callback writes into it
        data, at = mujoco.MjData(model), log.time[first : last + 1]
        grid = at[0] + model.opt.timestep * np.arange(int(np.ceil((at[-1] - at[0]) / model.opt.timestep)) + 1)
        ctrl = commands(log, interpolation, grid - delay)
        data.qpos[:], data.qvel[:] = log.qpos[first], start_velocity(model, log, first)
        _fill_history(model, data, log, interpolation, grid[0])
        for a in np.flatnonzero(model.actuator_actadr >= 0):
            data.act[model.actuator_actadr[a]] = ctrl[0, a]
        missing = Callback(model, terms) if terms else None
        states = np.empty((len(grid), model.nq + model.nv))
        for k, command in enumerate(ctrl):
            states[k, : model.nq], states[k, model.nq :] = data.qpos, data.qvel
            data.ctrl[:] = command
            if missing:
                missing(model, data)
            mujoco.mj_step(model, data)
        found = np.column_stack([np.interp(at, grid, column) for column in states.T])
        return found[:, : model.nq], found[:, model.nq :]

    return predict


def steady(model: mujoco.MjModel) -> Predictor:
    """Predictions of constant velocity."""

    def predict(log: Log, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        velocity, since = start_velocity(model, log, first), log.time[first : last + 1] - log.time[first]
        qpos = np.tile(log.qpos[first], (len(since), 1))
        for row, passed in zip(qpos, since, strict=True):
            mujoco.mj_integratePos(model, row, velocity, passed)
        return qpos, np.tile(velocity, (len(since), 1))

    return predict


def stretches(machine: Machine, trial: Trial) -> list[Stretch]:
    """Parts of the held-out recordings over which predictions are compared, one after another."""
    out = []
    for log in (log for log in trial.logs if log.split == "test"):
        whole = len(log.time) - 1
        step = whole if machine.horizon is None else round(machine.horizon / float(np.median(np.diff(log.time))))
        out += [(log, first, first + step) for first in range(0, whole - step + 1, step)]
    return out


def misses(machine: Machine, trial: Trial, model: mujoco.MjModel, predict: Predictor) -> list[np.ndarray]:
    """Sizes of the errors that count in each stretch: (n,) of all samples and coordinates, or of its end."""
    out = []
    for log, first, last in stretches(machine, trial):
        qpos, qvel = predict(log, first, last)
        if machine.measure == "spin":
            assert log.qvel is not None
            out.append(np.linalg.norm(qvel[-1:, 3:6] - log.qvel[last, 3:6], axis=1))
            continue
        away = np.empty((last - first + 1, model.nv))
        for row, measured, found in zip(away, log.qpos[first : last + 1], qpos, strict=True):
            mujoco.mj_differentiatePos(model, row, 1.0, measured, found)
        out.append(np.abs(away[machine.skip :, list(machine.dofs) or slice(None)]).ravel())
    return out


def stretch_errors(machine: Machine, missed: Sequence[np.ndarray]) -> np.ndarray:
    """(S,) Error of each stretch; infinite where a simulation diverges."""
    power = 2 if machine.measure == "rms" else 1
    errors = np.array([np.mean(own**power) ** (1 / power) for own in missed])
    return np.where(np.isfinite(errors), errors, np.inf)


def total_error(machine: Machine, missed: Sequence[np.ndarray]) -> float:
    """Error of all stretches: see `Machine`. Infinite where a simulation diverges."""
    power = 2 if machine.measure == "rms" else 1
    if machine.share < 1:  # a prediction that diverged comes last
        means = np.sort(stretch_errors(machine, missed)) ** power
        error = np.mean(means[: int(machine.share * len(means))])
    else:
        error = np.mean(np.concatenate(missed) ** power)
    return float(error ** (1 / power)) if np.isfinite(error) else float("inf")


def held_out_error(machine: Machine, trial: Trial, model: mujoco.MjModel, predict: Predictor) -> float:
    """Error of predictions of the held-out recordings."""
    return total_error(machine, misses(machine, trial, model, predict))


def believed_models(trial: Trial) -> dict[str, mujoco.MjModel]:
    """Models of the recordings by the name of their own MJCF; "" is that of the others."""
    return {name: mujoco.MjModel.from_xml_string(xml) for name, xml in {"": trial.xml, **trial.models}.items()}


def mended_models(
    trial: Trial, run: Path, result: Mapping[str, Any], terms: Sequence[Any]
) -> dict[str, tuple[mujoco.MjModel, Sequence[Any]]]:
    """Mended models and the terms for callbacks; of a recording's own model by `mend`, else from the run folder.

    Args:
      trial: believed models.
      run: run folder of the diagnosis.
      result: content of its result.json.
      terms: of its mended.json.
    """
    found = found_effects(result)
    out = {"": (mujoco.MjModel.from_xml_path(str(run / "mended.xml")), terms)}
    for name, xml in trial.models.items():
        own = mend(xml, found)
        out[name] = (mujoco.MjModel.from_xml_string(own.xml), own.terms)
    return out


def _fill_history(
    model: mujoco.MjModel, data: mujoco.MjData, log: Log, interpolation: str | None, start: float
) -> None:
    """Put the commands before the start into the memory of delayed actuators."""
    for a in range(model.nu):
        count = int(model.actuator_history[a][0])
        if count:
            past = -model.opt.timestep * np.arange(count, 0, -1)
            mujoco.mj_initCtrlHistory(model, data, a, past, commands(log, interpolation, start + past)[:, a])
