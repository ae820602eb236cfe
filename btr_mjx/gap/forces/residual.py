"""A last resort: a smooth table of the force that is left, chosen by recordings that were not fitted."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import Hypothesis, ResidualTable
from btr_mjx.gap.forces.filtering import Variances, filtered, smoothed
from btr_mjx.gap.forces.law_scan import JointStates, joint_states
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, again, evaluate_point
from btr_mjx.gap.forces.predictions import horizon_errors, predicts_better
from btr_mjx.models import part_names

_GRID = (4, 5, 3)
"""Radial functions over the ranges of position, velocity and load."""

_WIDTH = 0.25
"""Their width, as a part of the range."""

_RIDGES = np.logspace(-4, 3, 15)
"""Penalties of weights that are tried, in units of the information of an average weight."""

_UPDATES = 4
"""Updates of variances."""


def fit_residual(side: ForceSide, test: ForceSide, point: Point, variances: Variances) -> tuple[ResidualTable, ...]:
    """Tables of the force that is left beside a model, at the joints where held-out recordings know of it.

    Args:
      side: the recordings to fit.
      test: the recordings held out, which choose how smooth a table is and whether it is one at all.
      point: the model beside which it is fitted.
      variances: to start with.

    Returns:
      Tables; none where the model with them predicts held-out recordings no better.
    """
    model = side.stretches.data.recordings[0].model
    fits = [_fitted(of, point, variances) for of in (side, test)]
    states = [joint_states(of, fit) for of, fit in zip((side, test), fits, strict=True)]
    names, chosen = part_names(model, "joint"), list[ResidualTable]()
    for joint in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        table = _empty(names[joint], states[0], int(model.jnt_dofadr[joint]))
        grams = [_gram(fit, own, table, int(model.jnt_dofadr[joint])) for fit, own in zip(fits, states, strict=True)]
        weights = _weights(*grams)
        if weights is not None:
            chosen.append(replace(table, weights=weights))
    if not chosen:
        return ()
    before = point.hypothesis(side.library)
    makes = [before, with_tables(before, chosen, model)]
    (without, beside), steady = horizon_errors(test.stretches.data, makes, side.counter)
    return tuple(chosen) if predicts_better(without, beside, steady) is True else ()


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


def _fitted(side: ForceSide, point: Point, variances: Variances) -> Fitted:
    """A point at a side of the split, with variances of its own and all its numbers as they are."""
    fit = evaluate_point(side, point, replace(variances, weight=None))
    for _ in range(_UPDATES):
        updated = smoothed(fit.linear, np.zeros_like(fit.linear.defect), fit.variances).variances
        fit = again(side, fit, updated)
    return fit


def _empty(joint: str, states: JointStates, dof: int) -> ResidualTable:
    """A table over the recorded ranges of a joint, without weights."""
    rows = np.stack([states.q[..., dof].ravel(), states.v[..., dof].ravel(), states.load[..., dof].ravel()], -1)
    low, high = np.quantile(rows, 0.005, axis=0), np.quantile(rows, 0.995, axis=0)
    axes = [np.linspace(0, 1, count) for count in _GRID]
    centres = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], -1)
    return ResidualTable(joint, low, high, centres, _WIDTH, np.zeros(len(centres)))


def _gram(fit: Fitted, states: JointStates, table: ResidualTable, dof: int) -> np.ndarray:
    """(S, 1 + n, 1 + n) inner products of the residual and of the table's functions."""
    features = table.features(states.q[..., dof], states.v[..., dof], states.load[..., dof])
    columns = fit.linear.force[..., dof, None] * features[:, :, None, :]
    return filtered(fit.linear, columns, fit.variances).gram


def _weights(fit: np.ndarray, test: np.ndarray) -> np.ndarray | None:
    """Weights with the ridge that held-out stretches like best; None where none is better by two standard errors."""
    whole = fit.sum(0)
    inner, across = whole[1:, 1:], whole[1:, 0]
    usual = float(np.trace(inner)) / len(inner)
    best, found = np.zeros(len(test)), None
    for ridge in _RIDGES:
        weights = np.linalg.solve(inner + ridge * usual * np.eye(len(inner)), -across)
        fall = -(2 * test[:, 0, 1:] @ weights + np.einsum("i,sij,j->s", weights, test[:, 1:, 1:], weights))
        if fall.sum() > best.sum():
            best, found = fall, weights
    error = best.std(ddof=1) / np.sqrt(len(best)) if len(best) > 1 else np.inf
    return found if best.mean() > 2 * error else None
