"""Colours with which a robot stands out from its floor and from what is behind it."""

import mujoco
import numpy as np

from btr_mjx.plotting.camera import highest_group

BACKGROUNDS = (240, 241, 244), (150, 156, 168)
"""Colours behind a model without a sky: for all robots but light ones, and for these."""

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the brightness of a colour (ITU-R BT.709)."""

_DARKEST = 0.2
"""Brightness up to which a part is lifted: the sides of a darker one look the same in any light."""

_APART = 0.2
"""Least difference of brightness between a floor and all parts that stand on it."""

_FLOORS = (0.85, 0.65, 0.45, 0.3)
"""Brightness of the floors to choose from, the first as good as any."""

_LIGHT = 0.7
"""Brightness above which a robot needs the darker background."""


def set_apart(model: mujoco.MjModel) -> tuple[int, int, int]:
    """Lift dark colours of a model, and change that of a floor which is like its robot's, in place.

    Colours of textures are left alone.

    Returns:
      The colour of the background, for a model without a sky.
    """
    grounds = np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD))
    shown = (model.geom_rgba[:, 3] > 0) & (model.geom_group <= highest_group(model))
    plain = np.array([not _textured(model, int(material)) for material in model.geom_matid], bool)
    parts = np.flatnonzero(shown & ~grounds & plain)
    for table, rows in _tables(model, parts):
        dark = np.maximum(_DARKEST - table[rows, :3] @ _LUMA, 0.0)
        table[rows, :3] = np.clip(table[rows, :3] + dark[:, None], 0.0, 1.0)
    bright = _brightness(model, parts)
    for table, rows in _tables(model, np.flatnonzero(shown & grounds & plain)):
        for row in rows if len(bright) else ():
            near = lambda level: float(np.abs(bright - level).min())  # noqa: E731
            if near(float(table[row, :3] @ _LUMA)) < _APART:
                table[row, :3] = next((one for one in _FLOORS if near(one) >= 2 * _APART), max(_FLOORS, key=near))
    return BACKGROUNDS[bool(len(bright)) and bool(np.median(bright) > _LIGHT)]


def _textured(model: mujoco.MjModel, material: int) -> bool:
    return material >= 0 and bool((model.mat_texid[material] >= 0).any())


def _tables(model: mujoco.MjModel, geoms: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tables of colours, and the rows of these that geoms have: their own, or those of their materials."""
    materials = model.geom_matid[geoms]
    return [(model.geom_rgba, geoms[materials < 0]), (model.mat_rgba, np.unique(materials[materials >= 0]))]


def _brightness(model: mujoco.MjModel, geoms: np.ndarray) -> np.ndarray:
    return np.concatenate([table[rows, :3] @ _LUMA for table, rows in _tables(model, geoms)])
