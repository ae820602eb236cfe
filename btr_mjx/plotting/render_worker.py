"""Rendering of MuJoCo models in the child process of `btr_mjx.plotting.rendering`.

Reads from stdin the pickled arguments of `render`, and writes to stdout (height, width, 3) bytes of each picture.
"""

import itertools
import os
import pickle
import sys
from typing import BinaryIO

import mujoco
import numpy as np

from btr_mjx.plotting.camera import AZIMUTH, ELEVATION, FOVY, Camera, has_ground, highest_group, view_axes
from btr_mjx.plotting.contrast import set_apart

GRID, GRID_WIDTH, LINES = (0.35, 0.35, 0.35, 0.3), 1.0, 4
"""Colour and width [pixels] of the lines of a floor without a material, and about how many of them are in a picture."""

TRAIL, TRAIL_WIDTH = (0.78, 0.39, 0.12, 1.0), 0.012
"""Colour and radius [m] of the path that a robot has travelled."""


def write_pictures(
    model: mujoco.MjModel, poses: np.ndarray, width: int, height: int, camera: Camera, out: BinaryIO
) -> None:
    """Render a motion (F, nq) of a model."""
    data, option, view = mujoco.MjData(model), mujoco.MjvOption(), mujoco.MjvCamera()
    option.geomgroup[:] = np.arange(6) <= highest_group(model)
    view.lookat[:], view.distance, view.azimuth, view.elevation = camera.lookat, camera.distance, AZIMUTH, ELEVATION
    model.vis.global_.fovy = FOVY
    # The shadow map must extend beyond the picture: its border shows artefacts on the ground.
    model.vis.map.shadowclip, model.vis.quality.shadowsize = 2.0, 4096
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    has_sky = bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())
    trail = _base_trail(model, poses)
    hide_covered_spheres(model)
    background, grid = set_apart(model), _grid(model, camera)
    with mujoco.Renderer(model, height, width) as renderer:
        for number, qpos in enumerate(poses):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, view, option)
            _light(renderer.scene, camera)
            _draw_grid(renderer.scene, grid)
            _draw_trail(renderer.scene, trail[: number + 1])
            out.write((renderer.render() if has_sky else _with_background(renderer, background)).tobytes())
            out.flush()


def hide_covered_spheres(model: mujoco.MjModel) -> None:
    """Make spheres invisible that coincide with the end of a capsule, whose surfaces would flicker."""
    data, capsules = mujoco.MjData(model), np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
    mujoco.mj_kinematics(model, data)
    axes = data.geom_xmat[capsules].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[capsules, 1:2]
    ends = np.concatenate([data.geom_xpos[capsules] + axes, data.geom_xpos[capsules] - axes])
    radii = np.tile(model.geom_size[capsules, 0], 2)
    for ball in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE):
        near = np.linalg.norm(ends - data.geom_xpos[ball], axis=1) < 1e-6
        if (near & (radii > model.geom_size[ball, 0] - 1e-6)).any():
            model.geom_rgba[ball, 3] = 0


def _light(scene: mujoco.MjvScene, camera: Camera) -> None:
    """Replace a model's lights by a weak headlight and one lamp above and to the right that casts shadows."""
    towards = view_axes()[0] + [0.0, 0.0, 2.5]
    towards /= np.linalg.norm(towards)
    head, lamp = scene.lights[0], scene.lights[1]
    scene.nlight = 2
    head.ambient[:], head.diffuse[:], head.specular[:] = 0.35, 0.4, 0.05
    head.headlight, head.castshadow, head.type = 1, 0, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.5, 0.2
    lamp.headlight, lamp.castshadow, lamp.type = 0, 1, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.pos[:], lamp.dir[:] = camera.lookat + 0.5 * camera.distance * towards, -towards


def _with_background(renderer: mujoco.Renderer, background: tuple[int, int, int]) -> np.ndarray:
    """The picture of a model without a sky, which MuJoCo draws black, before a background."""
    picture = renderer.render()
    renderer.enable_segmentation_rendering()
    picture[renderer.render()[..., 0] < 0] = background
    renderer.disable_segmentation_rendering()
    return picture


def _base_trail(model: mujoco.MjModel, poses: np.ndarray) -> np.ndarray:
    """Path (F, 3) on the ground of a robot with a free joint [m]; (0, 3) for one that stands fixed or flies."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if not len(free) or not has_ground(model):
        return np.zeros((0, 3))
    first = int(model.jnt_qposadr[free[0]])
    return np.column_stack([poses[:, first : first + 2], np.full(len(poses), 0.005)])


def _grid(model: mujoco.MjModel, camera: Camera) -> np.ndarray:
    """Ends (n, 2, 3) of the lines of a level floor without a material, on which motion is not seen otherwise [m]."""
    for geom in np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_matid < 0)):
        level = np.allclose(model.geom_quat[geom], [1, 0, 0, 0]) and model.geom_bodyid[geom] == 0
        if not level or model.geom_rgba[geom, 3] == 0 or model.geom_group[geom] > highest_group(model):
            continue
        wanted = 2 * camera.distance * np.tan(np.radians(FOVY) / 2) / LINES
        power = 10.0 ** np.floor(np.log10(wanted))
        step = power * max(factor for factor in (1, 2, 5) if factor * power <= wanted)
        middle, reach = np.round(camera.lookat[:2] / step), 5 * LINES
        x, y = (step * (place + np.arange(-reach, reach + 1)) for place in middle)
        along = [[(one, end) for end in (y[0], y[-1])] for one in x] + [
            [(end, one) for end in (x[0], x[-1])] for one in y
        ]
        height = np.full((len(along), 2, 1), model.geom_pos[geom, 2] + 1e-3 * camera.distance)
        return np.concatenate([np.array(along), height], axis=2)
    return np.zeros((0, 2, 3))


def _draw_grid(scene: mujoco.MjvScene, lines: np.ndarray) -> None:
    """Add lines (n, 2, 3) to a scene."""
    for start, end in lines:
        _connect(scene, mujoco.mjtGeom.mjGEOM_LINE, GRID, GRID_WIDTH, start, end)


def _draw_trail(scene: mujoco.MjvScene, points: np.ndarray) -> None:
    """Add a line on the ground through points (n, 3)."""
    for start, end in itertools.pairwise(points):
        if (start != end).any():
            _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, TRAIL, TRAIL_WIDTH, start, end)


def _connect(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    colour: tuple[float, ...],
    width: float,
    start: np.ndarray,
    end: np.ndarray,
) -> None:
    """Add a line or a capsule between two points (3,)."""
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, np.float32))
    mujoco.mjv_connector(geom, kind, width, start, end)
    first = scene.geoms[0]  # counts as a part of it, and so not as background
    geom.objtype, geom.objid, geom.segid = first.objtype, first.objid, first.segid
    scene.ngeom += 1


if __name__ == "__main__":
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as pipe:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # libraries write no words among the pictures
        motions, width, height, camera = pickle.load(sys.stdin.buffer)
        for model, poses in motions:
            write_pictures(model, poses, width, height, camera, pipe)
