"""Statistics of models (`MjModel.stat`) for many simulations, from their kinematics in qpos0.

Source: google-deepmind/mujoco, src/engine/engine_setconst.c (setStat). `mujoco.batch.Batch` holds no statistics per
simulation. Arithmetic is elementwise and in MuJoCo's order.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

KINEMATICS = ("xpos", "xipos", "xanchor", "geom_xpos", "site_xpos", "M")
"""Fields of MjData that `model_statistics` needs, in qpos0."""

_SMALL = 1e-5
"""Smallest extent and body length of MuJoCo's statistics [m]."""


def unsupported_statistics(model: mujoco.MjModel) -> str:
    """A feature of a model whose statistics are not computed here; empty if there is none."""
    if model.nflex:
        return "a flex"
    return "a height field" if model.nhfield else ""


def model_statistics(
    model: mujoco.MjModel, data: Mapping[str, np.ndarray], radius: np.ndarray, mass: np.ndarray, size: np.ndarray
) -> dict[str, np.ndarray]:
    """Centre, extent and mean size, mass and inertia of models.

    Args:
      model: the base model, for the structure.
      data: the fields `KINEMATICS`, (L, *field shape).
      radius: geom_rbound (L, ngeom) [m].
      mass: body_mass (L, nbody) [kg].
      size: geom_size (L, ngeom, 3) [m].

    Returns:
      "stat.<name>" -> (L,), or (L, 3) for the centre.
    """
    count = len(mass)
    # The batch is the last axis from here on: numpy is fastest on long rows.
    place = {name: np.ascontiguousarray(data[name].transpose(1, 2, 0)) for name in KINEMATICS if name != "M"}
    radius = np.ascontiguousarray(radius.T)
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    reach = np.maximum(radius, 0.0)
    for g in np.flatnonzero(plane):
        wide = np.maximum(size[:, g, 0], size[:, g, 1])
        reach[g] = np.where(radius[g] > 0, radius[g], np.where(wide > 0, wide * 0.1, 0.01))
    points = [place["xpos"][1:], place["xipos"][1:], place["xanchor"], place["site_xpos"]]
    low = np.minimum.reduce([x.min(0) for x in [*points, place["geom_xpos"] - reach[:, None]] if len(x)])
    high = np.maximum.reduce([x.max(0) for x in [*points, place["geom_xpos"] + reach[:, None]] if len(x)])
    extent = np.maximum(_SMALL, (high - low).max(0))

    # Length of a body: distance to its farthest joint (its own or a child's) or geom, with the geom's radius.
    length = np.zeros((model.nbody, count))
    for owner in (model.jnt_bodyid, model.body_parentid[model.jnt_bodyid]):
        for body, distance in zip(owner, _distances(place["xipos"][owner], place["xanchor"]), strict=True):
            np.maximum(length[body], distance, out=length[body])
    spans = _distances(place["xipos"][model.geom_bodyid], place["geom_xpos"]) + radius
    for body, span, bounded in zip(model.geom_bodyid, spans, radius > 0, strict=True):
        np.maximum(length[body], span, out=length[body], where=bounded)
    mean_length = _sum(np.maximum(length[1:], _SMALL) / max(1, model.nbody - 1))
    return {
        "stat.center": ((low + high) * 0.5).T,
        "stat.extent": np.maximum(extent, 2 * mean_length),
        "stat.meansize": mean_length,
        "stat.meanmass": _sum(mass.T[1:]) / max(1, model.nbody - 1),
        "stat.meaninertia": _sum(data["M"].T[model.M_rowadr + model.M_rownnz - 1]) / max(1, model.nv),
    }


def _sum(rows: np.ndarray) -> np.ndarray:
    """Sum (L,) of rows (n, L) from the first to the last; numpy's own sum has another order."""
    total = np.zeros(rows.shape[1])
    for row in rows:
        total += row
    return total


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances (n, L) of points (n, 3, L)."""
    d = a - b
    d *= d
    return np.sqrt(d[:, 0] + d[:, 1] + d[:, 2])
