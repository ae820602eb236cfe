"""Access to MjModel fields for one model or a batch of models: their elements, and poses of bodies."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from btr_mjx.engines.computed import base_field


class Fields:
    """Reads elements of MjModel fields with two batch axes in front: (N, C) where they may differ, else (1, 1)."""

    def __init__(self, model: mujoco.MjModel, masks: Mapping[str, np.ndarray], leaves: Mapping[str, np.ndarray]):
        """Make a view of fields with leaves (N, C, *field shape) of a base model.

        Masks are bool arrays of the field's shape: elements that may differ between worlds.
        """
        self._model, self._masks, self._leaves = model, masks, leaves

    def __call__(self, field: str, index: Any = ()) -> np.ndarray:
        """The element or block field[index], shape (N, C, ...) or (1, 1, ...)."""
        index = index if isinstance(index, tuple) else (index,)
        mask = self._masks.get(field)
        if mask is not None and mask[index].any():
            return self._leaves[field][(slice(None), slice(None), *index)].astype(np.float64, copy=False)
        return base_field(self._model, field)[index][None, None]


def rotation_matrices(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4); entries within rounding of 0, 1 and -1 are made exact."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    matrix = np.stack([np.stack(row, -1) for row in rows], -2)
    nearest = np.round(matrix)
    return np.where(np.abs(matrix - nearest) < 1e-15, nearest, matrix)


def apply_matrix(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Products (..., 3) of matrices (..., 3, 3) and vectors (..., 3)."""
    return (matrix @ vector[..., None])[..., 0]


def rigid_pose(model: mujoco.MjModel, fields: Fields, body: int, root: int) -> tuple[np.ndarray, np.ndarray]:
    """Position (..., 3) and rotation (..., 3, 3) of a body in the frame of an ancestor that it is welded to."""
    if body == root:
        return np.zeros((1, 1, 3)), np.eye(3)[None, None]
    position, matrix = rigid_pose(model, fields, int(model.body_parentid[body]), root)
    position = position + apply_matrix(matrix, fields("body_pos", body))
    return position, matrix @ rotation_matrices(fields("body_quat", body))


def rigid_root(model: mujoco.MjModel, body: int) -> int:
    """The body with joints, or the world, that a body is welded to."""
    while body and model.body_jntnum[body] == 0:
        body = int(model.body_parentid[body])
    return body
