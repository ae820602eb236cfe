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

BACKGROUND = (240, 241, 244)
"""Colour behind a model without a sky."""

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
    with mujoco.Renderer(model, height, width) as renderer:
        for number, qpos in enumerate(poses):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, view, option)
            _light(renderer.scene, camera)
            _draw_trail(renderer.scene, trail[: number + 1])
            out.write((renderer.render() if has_sky else _with_background(renderer)).tobytes())
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


def _with_background(renderer: mujoco.Renderer) -> np.ndarray:
    """The picture of a model without a sky, which MuJoCo draws black, before a light background."""
    picture = renderer.render()
    renderer.enable_segmentation_rendering()
    picture[renderer.render()[..., 0] < 0] = BACKGROUND
    renderer.disable_segmentation_rendering()
    return picture


def _base_trail(model: mujoco.MjModel, poses: np.ndarray) -> np.ndarray:
    """Path (F, 3) on the ground of a robot with a free joint [m]; (0, 3) for one that stands fixed or flies."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if not len(free) or not has_ground(model):
        return np.zeros((0, 3))
    first = int(model.jnt_qposadr[free[0]])
    return np.column_stack([poses[:, first : first + 2], np.full(len(poses), 0.005)])


def _draw_trail(scene: mujoco.MjvScene, points: np.ndarray) -> None:
    """Add a line on the ground through points (n, 3)."""
    for start, end in itertools.pairwise(points):
        if scene.ngeom < scene.maxgeom and (start != end).any():
            geom = scene.geoms[scene.ngeom]
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(TRAIL, np.float32))
            mujoco.mjv_connector(geom, kind, TRAIL_WIDTH, start, end)
            first = scene.geoms[0]  # counts as a part of it, and so not as background
            geom.objtype, geom.objid, geom.segid = first.objtype, first.objid, first.segid
            scene.ngeom += 1


if __name__ == "__main__":
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as pipe:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # libraries write no words among the pictures
        motions, width, height, camera = pickle.load(sys.stdin.buffer)
        for model, poses in motions:
            write_pictures(model, poses, width, height, camera, pipe)
