"""Which geoms of a model are drawn, and the camera that shows all of them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

AZIMUTH, ELEVATION = 145.0, -28.0
"""Direction of view, from the front right and above: in the ground plane from the x axis, and to that plane
[degrees]."""

FOVY = 25.0
"""Vertical field of view [degrees]."""

EMPTY_SIDE = 0.06
"""Empty fraction of a picture at each side."""


@dataclass(frozen=True, eq=False)
class Camera:
    """MuJoCo's free camera, in the direction of `AZIMUTH` and `ELEVATION`.

    Attributes:
      lookat: (3,) the point at the centre of the picture [m].
      distance: from the camera to that point [m].
    """

    lookat: np.ndarray
    distance: float


def view_axes() -> np.ndarray:
    """(3, 3) rows: right, up and forward in the world."""
    a, e = np.radians(AZIMUTH), np.radians(ELEVATION)
    right = [np.sin(a), -np.cos(a), 0.0]
    up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    return np.array([right, up, [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]])


def camera_for(
    models: Sequence[mujoco.MjModel], aspect: float = 4 / 3, poses: Sequence[np.ndarray] | None = None
) -> Camera:
    """The nearest camera that shows all models completely, in their default posture or in all of their poses (n, nq).

    `aspect` is width over height of the picture.
    """
    shown = [model.qpos0[None] for model in models] if poses is None else poses
    points = np.concatenate(
        [geom_corners(model, qpos) for model, own in zip(models, shown, strict=True) for qpos in own]
    )
    if any(map(has_ground, models)):
        points = np.concatenate([points, points * [1, 1, 0]])  # shadows of light from above
    axes = view_axes()
    right, up, forward = axes @ points.T
    slope = (1 - 2 * EMPTY_SIDE) * np.tan(np.radians(FOVY) / 2)
    distance, centre = 0.0, []
    for across, tangent in ((right, slope * aspect), (up, slope)):
        # The least distance with |across - centre| <= tangent (distance + forward) for all points.
        top, bottom = (across - tangent * forward).max(), (across + tangent * forward).min()
        distance = max(distance, (top - bottom) / (2 * tangent))
        centre.append((top + bottom) / 2)
    return Camera(centre[0] * axes[0] + centre[1] * axes[1], distance)


def highest_group(model: mujoco.MjModel) -> int:
    """Geoms of this group and of those below are drawn.

    MuJoCo's viewers show the groups 0 to 2. Where these hold no moving part of the model, as in many robots that have
    collision geoms of group 3 alone, it is the first group that does.
    """
    moving = (model.geom_rgba[:, 3] > 0) & (model.body_weldid[model.geom_bodyid] > 0)
    return int(max(2, model.geom_group[moving].min(initial=5))) if moving.any() else 2


def has_ground(model: mujoco.MjModel) -> bool:
    """Whether a model has a plane."""
    return bool((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())


def geom_corners(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Corners (n, 3) [m] of boxes around the geoms that are drawn, but planes and height fields, in a pose (nq,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    endless = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    drawn = (model.geom_rgba[:, 3] > 0) & (model.geom_group <= highest_group(model))
    drawn &= ~np.isin(model.geom_type, endless)
    middle, half = model.geom_aabb[drawn, :3], model.geom_aabb[drawn, 3:]
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    local = middle[:, None] + signs * half[:, None]
    frames = data.geom_xmat[drawn].reshape(-1, 3, 3)
    return (local @ frames.transpose(0, 2, 1) + data.geom_xpos[drawn][:, None]).reshape(-1, 3)
