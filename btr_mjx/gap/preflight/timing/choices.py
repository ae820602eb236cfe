"""What is chosen by prediction: the command between its samples, and a finer time step of the model.

Between samples, a held command is half an interval later than a smooth one. Where short predictions ask for about that
delay, beside errors of calibration, commands were held; where they ask for none, or for another one, they were not, and
a delay is the robot's.
"""

import copy
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, listed
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Predictor
from btr_mjx.gap.preflight.timing.command_clock import late_commands
from btr_mjx.gap.preflight.timing.estimates import DIVISOR, PredictionErrors, command_interval

_SURE = 2.0
"""Standard errors by which an estimate has to be nearer to one of two values."""

_ODDS = float(np.log(100))
"""Logarithm of the odds by which commands have been held, or not."""

_RATIO = 3.0
"""Ratio of variances by which a finer step has to predict better, as conventions of positions and commands have to."""

_SEEN = 3.0
"""Change by a finer time step, in units of the noise, that a single sample shows."""

_STRETCHES = 48
"""Stretches that are predicted."""

_FEWEST = 8
"""Fewest stretches that can decide."""


def timed(dataset: Dataset, noise: Noise) -> tuple[Dataset, list[Finding]]:
    """The dataset with what short predictions choose, and findings about time that they show.

    Args:
      dataset: in sound conventions.
      noise: of its sensors.
    """
    if all(np.ptp(one.ctrl, axis=0).max(initial=0) == 0 for one in dataset.recordings):
        return dataset, []
    predictor = Predictor(dataset, noise, _STRETCHES)
    if len(predictor) < _FEWEST:
        return dataset, []
    predictions = PredictionErrors.of(predictor, dataset.recordings, noise.qpos)
    if late := late_commands(dataset, noise, predictor, predictions):
        return dataset, late
    dataset, found = with_finer_step(dataset, predictions)
    dataset, more = with_held_commands(dataset, predictions)
    return dataset, found + more


def with_finer_step(dataset: Dataset, predictions: PredictionErrors) -> tuple[Dataset, list[Finding]]:
    """The dataset with a finer time step of its models, where that predicts better, and a warning then.

    Args:
      dataset: in sound conventions.
      predictions: of it.

    Returns:
      The dataset and the findings.
    """
    share, error = predictions.estimate().step
    model, (before, after) = dataset.model, predictions.errors()
    # Twice the change would be as far as none: what asks for that is something else, such as damping.
    better = 0.5 + _SURE * error < share < 2.0 and predictions.gain_of_step > _RATIO
    if not better or predictions.seen_by_step < _SEEN:
        return dataset, []
    step, finer = model.opt.timestep, model.opt.timestep / DIVISOR
    turning = np.isin(model.jnt_type[model.dof_jntid], (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL))
    worst = int(np.argmax(np.where(turning, before, 0.0) if turning.any() else before))
    unit, scale = ("degrees", 180 / np.pi) if turning.any() else ("mm", 1e3)
    was, now = scale * before[worst], scale * after[worst]
    remedy = f'set timestep="{finer:g}" in <option> of the model'
    message = (
        f"the time step of the model is too coarse: predictions {predictions.seconds:.2g} s ahead are off by "
        f"{was:.3g} {unit} with steps of {1e3 * step:g} ms, by {now:.3g} with {1e3 * finer:g} ms; {remedy}; a search "
        "uses it"
    )
    evidence = {"timestep": step, "finer": finer, "error_now": was, "error_with_remedy": now, "share": share}
    models: dict[int, mujoco.MjModel] = {}

    def finer_one(own: mujoco.MjModel) -> mujoco.MjModel:
        if id(own) not in models:
            models[id(own)] = copy.copy(own)
            models[id(own)].opt.timestep /= DIVISOR
        return models[id(own)]

    recordings = tuple(replace(one, model=finer_one(one.model)) for one in dataset.recordings)
    mended = replace(dataset, model=finer_one(model), recordings=recordings, coarse_step=step)
    return mended, [Finding("warning", "time step", message, remedy, evidence)]


def with_held_commands(dataset: Dataset, predictions: PredictionErrors) -> tuple[Dataset, list[Finding]]:
    """The dataset with commands held, where short predictions say so and its dataset.toml says nothing.

    Recordings whose commands are stairs, or came at a rate of their own, are held already.

    Args:
      dataset: in sound conventions.
      predictions: of it, with its interpolations.

    Returns:
      The dataset, and a note where commands are held now.
    """
    smooth = [
        i
        for i, one in enumerate(dataset.recordings)
        if one.interpolation != "hold" and dataset.control.interpolation_of(one.log) is None
    ]
    if dataset.forces or not smooth:
        return dataset, []
    left = predictions.estimate(smooth)
    share, error = (2 * x / command_interval([dataset.recordings[i] for i in smooth]) for x in left.delay)
    # Log-likelihood of half an interval of delay against none; more than that is neither.
    if left.stretches < _FEWEST or (share - 0.5) / error**2 < _ODDS or share > 1.5:
        return dataset, []
    recordings = [
        replace(one, interpolation="hold") if i in smooth else one for i, one in enumerate(dataset.recordings)
    ]
    names = list(dict.fromkeys(dataset.recordings[i].log for i in smooth))
    of = "" if len(smooth) == len(recordings) else f" of {listed(names)}"
    value, error = left.delay
    message = (
        f"commands{of} are held between samples, as predictions {predictions.seconds:.2g} s ahead say: otherwise the "
        f"response comes {1e3 * value:.2g} +- {1e3 * error:.1g} ms late, which is half an interval; "
        'interpolation = "hold" in [control] says so'
    )
    finding = Finding("note", "interpolation", message, "", {"delay": value, "standard_error": error})
    return replace(dataset, recordings=tuple(recordings)), [finding]
