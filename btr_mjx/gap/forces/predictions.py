"""Predictions over a horizon, by which hypotheses are compared where noise does not hide the difference."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.forces.horizons import FOLLOWS, SAMPLES, cut_horizons, motion_size, position_errors, steady_errors
from btr_mjx.gap.results import JointError
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import PreparedData, track_of
from btr_mjx.models import integrate, part_names

HORIZON = 0.25
"""Time over which predictions are compared and told [s]."""

_LONGER = 1.0
"""Time over which they are compared first, where a hypothesis follows so long [s]: a servo takes its time, and what
holds it still predicts a quarter of a second well."""

RELATIVE_ERROR = 0.1
"""Part by which simulations err: smaller differences tell nothing, and a further effect has to explain more than its
square of what the others do."""

_SEED = 0
"""Of the noise that is added."""


def predicts_better(before: np.ndarray, after: np.ndarray, steady: np.ndarray) -> bool | None:
    """Whether predictions over a horizon are better or worse; None where one cannot tell.

    They have to differ by more than two standard errors, and by more than the part by which simulations err. Errors are
    counted up to a bound, since on a few stretches of real recordings everything fails, and a mean would see nothing
    else; and not by their logarithms, since where a robot stands still a model that holds it errs by nothing.

    Args:
      before: (W, nv) mean square errors of one hypothesis.
      after: the same of another one.
      steady: those of constant velocity, whose largest is the bound.
    """
    bound = steady.max(0) + 1e-300
    first, last = (np.minimum(own / bound, 1.0) for own in (before, after))
    fall = (first - last).mean(1)
    error = fall.std(ddof=1) / np.sqrt(len(fall)) if len(fall) > 1 else np.inf
    least = RELATIVE_ERROR * max(float(first.mean()), float(last.mean()))
    return bool(fall.mean() > 0) if abs(fall.mean()) > max(2 * error, least) else None


def compared_predictions(data: PreparedData, makes: Sequence[Hypothesis], counter: Counter | None = None) -> np.ndarray:
    """Which hypotheses predict better than which others, by the longest horizon that can tell.

    Args:
      data: recordings.
      makes: hypotheses.
      counter: adds up the simulated steps.

    Returns:
      (n, n) sign: 1 where the hypothesis of the column is better than that of the row, -1 where it is worse, 0 where
      one cannot tell.
    """
    out = np.zeros((len(makes), len(makes)), int)
    for horizon in (_LONGER, HORIZON):
        errors, steady = horizon_errors(data, makes, counter, horizon)
        if horizon > HORIZON and not any(np.all(np.median(e, 0) < (FOLLOWS * motion_size(data)) ** 2) for e in errors):
            continue
        for i, j in np.argwhere(out == 0):
            told = predicts_better(errors[i], errors[j], steady)
            out[i, j] = 0 if told is None else 1 if told else -1
    return out


def predicts_worse(data: PreparedData, before: Hypothesis, after: Hypothesis, counter: Counter | None = None) -> bool:
    """Whether a hypothesis predicts recordings worse than the one before, over a short horizon or as a whole.

    Over a short horizon as `compared_predictions` has it. Whole recordings are too few for a standard error: there it
    is the error of all together, of those that the hypothesis before follows. Those that it does not follow, since
    motion diverges or much is missing, say nothing.

    Args:
      data: recordings.
      before: a hypothesis.
      after: the other one.
      counter: adds up the simulated steps.
    """
    if compared_predictions(data, [before, after], counter)[0, 1] < 0:
        return True
    trial = cut_horizons(data, np.inf)
    # (recordings, nv) mean square errors
    first, last = (
        np.concatenate([(e**2).mean(1) for e in row]) for row in position_errors(trial, [before, after], counter)
    )
    moving = np.maximum(motion_size(data) ** 2, 1e-300)
    followed = np.all(first < FOLLOWS**2 * moving, axis=1)
    was, now = (np.minimum(own[followed] / moving, 1.0).sum() for own in (first, last))
    return bool(now > (1 + RELATIVE_ERROR) ** 2 * was)


def horizon_errors(
    data: PreparedData, makes: Sequence[Hypothesis], counter: Counter | None = None, horizon: float = HORIZON
) -> tuple[list[np.ndarray], np.ndarray]:
    """Mean square errors of positions over a horizon from smoothed states.

    Args:
      data: recordings.
      makes: hypotheses.
      counter: adds up the simulated steps.
      horizon: [s].

    Returns:
      For each hypothesis (W, nv), and the same of constant velocity.
    """
    trial = cut_horizons(data, horizon, SAMPLES)
    every = [*position_errors(trial, makes, counter), steady_errors(trial)]
    *found, steady = (np.concatenate([(e**2).mean(1) for e in row]) for row in every)
    return found, steady


def noise_errors(data: PreparedData, make: Hypothesis, counter: Counter | None = None) -> np.ndarray:
    """Mean square errors (W, nv) that the sensors' noise alone makes in the same predictions.

    It is by how much they change where noise of the sensors' size is added once more: to the measured states in which
    they start, and to those with which they are compared.

    Args:
      data: recordings.
      make: a hypothesis that follows them.
      counter: adds up the simulated steps.

    Returns:
      The mean squares; NaN for what is not measured.
    """
    rng, nv = np.random.default_rng(_SEED), data.recordings[0].model.nv
    size = np.nan_to_num(data.sigma)
    noisy = []
    for recording in data.recordings:
        error = size * rng.normal(size=(len(recording.time), 2 * nv))
        qpos = integrate(recording.model, recording.qpos, error[:, :nv])
        noisy.append(replace(recording, qpos=qpos, qvel=recording.qvel + error[:, nv:]))
    again = replace(data, recordings=tuple(noisy), tracks=tuple(map(track_of, noisy)))
    first, second = (position_errors(cut_horizons(own, HORIZON, SAMPLES), [make], counter)[0] for own in (data, again))
    change = np.concatenate([((b - a) ** 2).mean(1) for a, b in zip(first, second, strict=True)])
    return np.where(np.isfinite(data.sigma[:nv]), change, np.nan)


def step_errors(data: PreparedData, make: Hypothesis, counter: Counter | None = None) -> np.ndarray:
    """Mean square errors (W, nv) that the time step of the model alone makes in the same predictions.

    It is twice the difference to half the time step, as for an integrator of first order.

    Args:
      data: recordings.
      make: a hypothesis that follows them.
      counter: adds up the simulated steps.
    """
    trial = cut_horizons(data, HORIZON, SAMPLES)
    whole, half = (position_errors(trial, [make], counter, factor)[0] for factor in (1.0, 0.5))
    return np.concatenate([((2 * (b - a)) ** 2).mean(1) for a, b in zip(whole, half, strict=True)])


def joint_errors(
    model: mujoco.MjModel,
    before: np.ndarray,
    after: np.ndarray | None,
    floor: tuple[np.ndarray, np.ndarray],
    steady: np.ndarray,
) -> tuple[JointError, ...]:
    """Errors of predictions by joint, each in its own unit; nothing of joints that are not measured.

    Args:
      model: the model.
      before: (W, nv) mean square errors of the believed model.
      after: of the mended one; None where there is none.
      floor: what noise alone and the time step alone make, see `noise_errors` and `step_errors`.
      steady: of constant velocity.
    """
    joints, bodies = part_names(model, "joint"), part_names(model, "body")
    dofs: dict[tuple[str, str], list[int]] = {}
    for dof, joint in enumerate(model.dof_jntid):
        kind, body = model.jnt_type[joint], bodies[model.jnt_bodyid[joint]]
        is_shift = dof - model.jnt_dofadr[joint] < 3
        name, unit = f"joint {joints[joint]}", "m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            name, unit = (f"position of body {body}", "m") if is_shift else (f"orientation of body {body}", "rad")
        dofs.setdefault((name, unit), []).append(dof)
    every = [None if own is None else own.mean(0) for own in (before, after, *floor, steady)]
    out = []
    for (name, unit), at in dofs.items():
        row = [None if own is None else float(np.sqrt(own[at].mean())) for own in every]
        if all(value is None or np.isfinite(value) for value in row):
            first, *rest = row
            assert first is not None
            out.append(JointError(name, unit, HORIZON, first, *rest))
    return tuple(out)


def predicts_well(believed: np.ndarray, mended: np.ndarray, steady: np.ndarray) -> bool:
    """Whether predictions (W, nv) of held-out recordings are better than those of two simple predictors.

    Args:
      believed: mean square errors of the believed model.
      mended: those of the mended one.
      steady: those of constant velocity.
    """
    return all(predicts_better(rival, mended, steady) is True for rival in (believed, steady))
