"""Pictures of robots: rendered by MuJoCo where OpenGL works, else drawn as outlines with matplotlib.

Rendering runs in a separate process: MuJoCo selects its OpenGL backend from the variable MUJOCO_GL at import, and on a
machine without a display or with incomplete libraries a backend may hang or crash its process.
"""

import copy
import functools
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from btr_mjx.runs import note

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AZIMUTH, ELEVATION = 145.0, -28.0
"""Default view [degrees]: from the front right and above."""

TIMEOUT = 60.0
"""Time after which a rendering process counts as failed [s], beside that for its frames."""

FRAME_TIMEOUT = 2.0
"""Further time for each frame of a film [s]."""


FRAMES_AT_ONCE = 40
"""Frames of a film that one rendering process makes; progress is reported after each."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera, as MuJoCo's free camera.

    Attributes:
      lookat: (3,) the point at the centre of the picture [m].
      distance: from the camera to that point [m].
      azimuth: direction of view in the ground plane, from the x axis [degrees].
      elevation: angle of the direction of view to the ground plane, negative when looking down [degrees].
      fovy: vertical field of view [degrees].
    """

    lookat: np.ndarray
    distance: float
    azimuth: float = AZIMUTH
    elevation: float = ELEVATION
    fovy: float = 25.0

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) rows: right, up and forward in the world."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        right = [np.sin(a), -np.cos(a), 0.0]
        up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
        forward = [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
        return np.array([right, up, forward])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Picture coordinates (..., 2), with the upper edge at +1, and depths (...) [m] of points (..., 3)."""
        seen = (points - self.lookat) @ self.axes.T
        depth = seen[..., 2] + self.distance
        return seen[..., :2] / (depth[..., None] * np.tan(np.radians(self.fovy) / 2)), depth


def camera_for(
    models: Sequence[mujoco.MjModel],
    aspect: float = 4 / 3,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    margin: float = 0.06,
    poses: Sequence[np.ndarray] | None = None,
) -> Camera:
    """The nearest camera that shows all models completely, in their default posture or in all of their poses.

    Args:
      models: models to be drawn to the same scale.
      aspect: width over height of the picture.
      azimuth: see `Camera`.
      elevation: see `Camera`.
      margin: empty fraction of the picture at each side.
      poses: (n, nq) generalised positions of each model; None for the default posture.

    Returns:
      The camera.
    """
    view = Camera(np.zeros(3), 0.0, azimuth, elevation)
    shown = [[None] * len(models)] if poses is None else zip(*poses, strict=True)
    clouds = [
        cloud
        for row in shown
        for model, qpos in zip(models, row, strict=True)
        for _, cloud in point_clouds(model, qpos)
    ]
    if any(map(has_ground, models)):
        clouds += [cloud * [1, 1, 0] for cloud in clouds]  # shadows of light from above
    points = np.concatenate(clouds)
    right, up, forward = view.axes @ points.T
    slope = (1 - 2 * margin) * np.tan(np.radians(view.fovy) / 2)
    distance, centre = 0.0, []
    for across, tangent in ((right, slope * aspect), (up, slope)):
        # The least distance with |across - centre| <= tangent (distance + forward) for all points.
        top, bottom = (across - tangent * forward).max(), (across + tangent * forward).min()
        distance = max(distance, (top - bottom) / (2 * tangent))
        centre.append((top + bottom) / 2)
    return replace(view, lookat=centre[0] * view.axes[0] + centre[1] * view.axes[1], distance=distance)


def render(
    model: mujoco.MjModel,
    width: int = 800,
    height: int = 600,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    camera: Camera | None = None,
) -> np.ndarray | None:
    """Render one model in its default posture; see `render_all`.

    Args:
      model: the model.
      width: of the picture [pixels].
      height: likewise.
      azimuth: see `Camera`.
      elevation: see `Camera`.
      camera: the camera; None for one that shows the whole model.

    Returns:
      (height, width, 3) uint8, or None where nothing can be rendered.
    """
    pictures = render_all([model], width, height, camera or camera_for([model], width / height, azimuth, elevation))
    return None if pictures is None else pictures[0]


def render_all(
    models: Sequence[mujoco.MjModel], width: int = 800, height: int = 600, camera: Camera | None = None
) -> list[np.ndarray] | None:
    """Render models in their default posture.

    Args:
      models: the models.
      width: of each picture [pixels].
      height: likewise.
      camera: the common camera; None for one that shows all models.

    Returns:
      A (height, width, 3) uint8 array per model; None where this machine has no working OpenGL, which is reported once
      per process on stderr.
    """
    camera = camera or camera_for(models, width / height)
    backend = working_backend()
    pictures = None if backend is None else _render(models, width, height, camera, backend)
    return None if pictures is None else list(pictures)


def render_motion(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    width: int,
    height: int,
    camera: Camera,
    progress: Callable[[int], object] | None = None,
) -> np.ndarray | None:
    """Render the frames of a motion.

    Args:
      model: the model.
      qpos: (F, nq) generalised positions.
      width: of each frame [pixels].
      height: likewise.
      camera: the view.
      progress: called with the number of frames done since the last call.

    Returns:
      (F, height, width, 3) uint8, or None where nothing can be rendered.
    """
    backend = working_backend()
    trail = base_trail(model, qpos).tolist()
    frames = []
    for first in range(0, len(qpos), FRAMES_AT_ONCE):
        part = qpos[first : first + FRAMES_AT_ONCE]
        more = {"trail": trail, "first": first}
        made = None if backend is None else _render([model], width, height, camera, backend, part, more)
        if made is None:
            return None
        frames.append(made)
        if progress is not None:
            progress(len(part))
    return np.concatenate(frames)


@functools.cache
def working_backend() -> str | None:
    """Value of MUJOCO_GL with which rendering works, None if there is none (reported on stderr).

    Tested once per process: the value set by the user, else EGL, OSMesa and, with a display, GLFW (Linux), or the
    system's default (other systems).
    """
    given = os.environ.get("MUJOCO_GL", "").strip().lower()
    if given in ("disable", "disabled", "off", "false", "0"):
        note(f"robots are sketched, not rendered: MUJOCO_GL={given}")
        return None
    tried = [given] if given else ["egl", "osmesa"] if platform.system() == "Linux" else [""]
    if not given and os.environ.get("DISPLAY"):
        tried.append("glfw")
    ball = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
    for backend in tried:
        picture = _render([ball], 32, 32, camera_for([ball], 1.0), backend)
        if picture is not None and np.ptp(picture) > 0:
            return backend
    names = ", ".join(backend or "the default" for backend in tried)
    hint = "; on Debian: apt install libegl1" if platform.system() == "Linux" else ""
    note(f"robots are sketched, not rendered: no OpenGL (tried {names}){hint}")
    return None


def _render(
    models: Sequence[mujoco.MjModel],
    width: int,
    height: int,
    camera: Camera,
    backend: str,
    poses: np.ndarray | None = None,
    more: Mapping[str, Any] = MappingProxyType({}),
) -> np.ndarray | None:
    """Pictures (n, height, width, 3) rendered in another process, of every pose (n, nq) of one model where given.

    `more` is added to the request. None if it fails.
    """
    with tempfile.TemporaryDirectory(prefix="btr_mjx-") as name:
        folder = Path(name)
        names = [f"{i}.mjb" for i in range(len(models))]
        for file, model in zip(names, models, strict=True):
            mujoco.mj_saveModel(without_covered(model), str(folder / file))
        request: dict[str, Any] = {"models": names, "width": width, "height": height}
        request |= {"lookat": camera.lookat.tolist(), "distance": camera.distance}
        request |= {"azimuth": camera.azimuth, "elevation": camera.elevation, "fovy": camera.fovy}
        lamp = camera.axes[0] + [0.0, 0.0, 2.5]  # direction to the lamp: above and to the right of the camera
        request["lamp"] = (lamp / np.linalg.norm(lamp)).tolist()
        request |= more
        if poses is not None:
            np.save(folder / "poses.npy", poses)
        (folder / "request.json").write_text(json.dumps(request))
        worker = Path(__file__).with_name("render_worker.py")
        environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
        environment["MUJOCO_GL"] = backend
        try:
            # -P: modules beside the worker must not be imported as top-level modules. MuJoCo's log stays in the folder.
            subprocess.run(
                [sys.executable, "-P", str(worker), name],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=TIMEOUT + FRAME_TIMEOUT * (0 if poses is None else len(poses)),
                check=True,
            )
            return np.load(folder / "pictures.npy", allow_pickle=False)
        except (OSError, subprocess.SubprocessError, ValueError):
            return None


def base_trail(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Path (F, 3) on the ground of a robot with a free joint [m]; (0, 3) for a robot that stands fixed or flies."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if not len(free) or not has_ground(model):
        return np.zeros((0, 3))
    first = int(model.jnt_qposadr[free[0]])
    return np.concatenate([qpos[:, first : first + 2], np.full((len(qpos), 1), 0.005)], axis=1)


def has_ground(model: mujoco.MjModel) -> bool:
    """Whether a model has a plane."""
    return bool((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())


def point_clouds(model: mujoco.MjModel, qpos: np.ndarray | None = None) -> list[tuple[int, np.ndarray]]:
    """Points whose convex hull approximates a geom, for each visible bounded geom.

    Args:
      model: the model.
      qpos: (nq,) generalised positions; None for the default posture.

    Returns:
      (geom, (n, 3) points in the world [m]) pairs; planes, height fields and invisible geoms are left out.
    """
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    kinds, clouds = mujoco.mjtGeom, []
    steps = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rings = [(np.sin(t) * np.cos(steps), np.sin(t) * np.sin(steps), np.cos(t)) for t in np.linspace(0, np.pi, 8)]
    ball = np.concatenate([np.stack(np.broadcast_arrays(*ring), axis=1) for ring in rings])
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    for geom in range(model.ngeom):
        size, kind = model.geom_size[geom], model.geom_type[geom]
        if model.geom_rgba[geom, 3] == 0 or model.geom_group[geom] > 2:  # MuJoCo's viewers show groups 0 to 2
            continue
        if kind == kinds.mjGEOM_SPHERE:
            local = size[0] * ball
        elif kind == kinds.mjGEOM_CAPSULE:
            local = size[0] * ball + np.sign(ball[:, 2:]) * [0, 0, size[1]]
        elif kind == kinds.mjGEOM_CYLINDER:
            radial = np.stack([np.cos(steps), np.sin(steps), np.ones_like(steps)], axis=1)
            local = np.concatenate([radial, radial * [1, 1, -1]]) * [size[0], size[0], size[1]]
        elif kind == kinds.mjGEOM_ELLIPSOID:
            local = size * ball
        elif kind == kinds.mjGEOM_BOX:
            local = size * corners
        elif kind == kinds.mjGEOM_MESH:
            first = model.mesh_vertadr[model.geom_dataid[geom]]
            local = model.mesh_vert[first : first + model.mesh_vertnum[model.geom_dataid[geom]]]
        else:
            continue
        clouds.append((geom, local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]))
    return clouds


def without_covered(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy without spheres that coincide with the end of a capsule, whose surfaces would flicker."""
    shown = copy.copy(model)
    capsules = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    axis = data.geom_xmat[capsules].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[capsules, 1:2]
    ends = np.concatenate([data.geom_xpos[capsules] + axis, data.geom_xpos[capsules] - axis])
    radii = np.tile(model.geom_size[capsules, 0], 2)
    for ball in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE):
        near = np.linalg.norm(ends - data.geom_xpos[ball], axis=1) < 1e-6
        if (near & (radii > model.geom_size[ball, 0] - 1e-6)).any():
            shown.geom_rgba[ball, 3] = 0
    return shown


def sketch(
    axes: "Axes", model: mujoco.MjModel, camera: Camera, aspect: float = 4 / 3, qpos: np.ndarray | None = None
) -> None:
    """Draw a model as outlines with a shadow on the ground, without OpenGL.

    Args:
      axes: the axes to draw in.
      model: the model.
      camera: the view.
      aspect: width over height of the picture.
      qpos: (nq,) generalised positions; None for the default posture.
    """
    from matplotlib.collections import PolyCollection
    from scipy.spatial import ConvexHull

    def outline(points: np.ndarray) -> tuple[np.ndarray, float]:
        flat, depth = camera.project(points)
        return flat[ConvexHull(flat).vertices], float(depth.mean())

    clouds = point_clouds(without_covered(model), qpos)
    shadows = [outline(cloud * [1, 1, 0])[0] for _, cloud in clouds] if has_ground(model) else []
    axes.add_collection(PolyCollection(shadows, facecolor="0.88", edgecolor="none", zorder=1))
    shapes = [(*outline(cloud), tuple(0.35 + 0.65 * model.geom_rgba[geom, :3])) for geom, cloud in clouds]
    shapes.sort(key=lambda shape: -shape[1])
    outlines, colours = [shape[0] for shape in shapes], [shape[2] for shape in shapes]
    axes.add_collection(PolyCollection(outlines, facecolor=colours, edgecolor="black", linewidth=0.6, zorder=2))
    axes.set(xlim=(-aspect, aspect), ylim=(-1, 1), aspect="equal")
    axes.set_axis_off()
