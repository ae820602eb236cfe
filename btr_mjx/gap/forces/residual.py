"""A last resort: a smooth table of the force that is left.

Recordings that were fitted choose how smooth it is, each predicted from the others; those held out whether it stays.
"""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import Hypothesis, ResidualTable
from btr_mjx.gap.forces.kalman_filter import Variances, filtered, smoothed
from btr_mjx.gap.forces.law_scan import JointStates, joint_states
from btr_mjx.gap.forces.motion import Linearised, linearise_motion
from btr_mjx.gap.forces.points import ForceSide, Point
from btr_mjx.gap.forces.predictions import horizon_errors, predicts_better
from btr_mjx.models import part_names

_GRIDS = ((20, 0, 0), (0, 14, 0), (0, 0, 8), (4, 5, 0))
"""Bumps over position, velocity and load, and over position and velocity together."""

_RIDGES = np.logspace(-4, 3, 15)
"""Penalties of weights that are tried, in units of the information of an average weight."""

_UPDATES = 4
"""Updates of variances."""

_FOLDS = 4
"""Parts of a recording that is alone, each predicted from the others."""


def fit_residual(side: ForceSide, test: ForceSide, point: Point, variances: Variances) -> tuple[ResidualTable, ...]:
    """Tables of the force that is left beside a model, at the joints where held-out recordings know of it.

    Args:
      side: the recordings to fit.
      test: the recordings held out, which have to be predicted better with a table than without it.
      point: the model beside which it is fitted.
      variances: to start with.

    Returns:
      Tables; none where the model with them predicts held-out recordings no better.
    """
    model, before = side.stretches.data.recordings[0].model, point.hypothesis(side.library)
    fit, states = _linear(side, before, variances), joint_states(side.stretches, before)
    group = side.stretches.recording
    if len(np.unique(group)) == 1:
        group = np.arange(len(group)) * _FOLDS // len(group)
    names, chosen = part_names(model, "joint"), before
    tables: list[ResidualTable] = []
    for joint in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        dof = int(model.jnt_dofadr[joint])
        table = _empty(names[joint], states, dof)
        table = replace(table, weights=_weights(_gram(*fit, states, table, dof), group))
        beside = with_tables(chosen, [table], model)
        (without, found), steady = horizon_errors(test.stretches.data, [chosen, beside], side.counter)
        if predicts_better(without, found, steady):
            tables, chosen = [*tables, table], beside
    return tuple(tables)


def with_tables(hypothesis: Hypothesis, tables: Sequence[ResidualTable], model: mujoco.MjModel) -> Hypothesis:
    """A hypothesis with tables.

    Args:
      hypothesis: without them.
      tables: of joints.
      model: the believed model.
    """
    for table in tables:
        hypothesis = hypothesis.with_effect(table.candidate(model), ())
    return hypothesis


def _linear(side: ForceSide, hypothesis: Hypothesis, variances: Variances) -> tuple[Linearised, Variances]:
    """The linearised motion of a hypothesis at a side of the split, with variances of its own."""
    linear = linearise_motion(side.stretches, hypothesis, side.counter)
    known = replace(variances, weight=None)
    for _ in range(_UPDATES):
        known = smoothed(linear, np.zeros_like(linear.defect), known).variances
    return linear, known


def _empty(joint: str, states: JointStates, dof: int) -> ResidualTable:
    """A table over the recorded ranges of a joint, without weights."""
    rows = np.stack([states.q[..., dof].ravel(), states.v[..., dof].ravel(), states.load[..., dof].ravel()], -1)
    low, high = np.quantile(rows, 0.005, axis=0), np.quantile(rows, 0.995, axis=0)
    centres, widths = [], []
    for grid in _GRIDS:
        axes = [np.linspace(0, 1, count) if count else np.array([np.nan]) for count in grid]
        own = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], -1)
        centres.append(own)
        widths.append(np.full(len(own), 1 / (max(grid) - 1)))
    every = np.concatenate(centres)
    return ResidualTable(joint, low, high, every, np.concatenate(widths), np.zeros(len(every)))


def _gram(linear: Linearised, variances: Variances, states: JointStates, table: ResidualTable, dof: int) -> np.ndarray:
    """(S, 1 + n, 1 + n) inner products of the residual and of the table's functions."""
    features = table.features(states.q[..., dof], states.v[..., dof], states.load[..., dof])
    columns = linear.force[..., dof, None] * features[:, :, None, :]
    return filtered(linear, columns, variances).gram


def _weights(fit: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Weights (n,) with the ridge that predicts each group of stretches (S,) best from the others."""
    whole, folds = fit.sum(0), [fit[group == own].sum(0) for own in np.unique(group)]
    usual = float(np.trace(whole[1:, 1:])) / (len(whole) - 1)

    def solved(gram: np.ndarray, ridge: float) -> np.ndarray:
        return np.linalg.solve(gram[1:, 1:] + ridge * usual * np.eye(len(gram) - 1), -gram[1:, 0])

    def left(ridge: float) -> float:
        weights = [np.r_[1.0, solved(whole - own, ridge)] for own in folds]
        return sum(float(w @ own @ w) for w, own in zip(weights, folds, strict=True))

    return solved(whole, min(_RIDGES, key=left))
