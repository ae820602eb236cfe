"""Rendering of MuJoCo models in a separate process, started by `btr_mjx.plotting.pictures` (which has the reasons).

    python -P render_worker.py FOLDER

FOLDER holds request.json and one binary model per picture, or one model and poses.npy (n, nq). The result is
pictures.npy, (n, height, width, 3) uint8.
This file does not import the package, so that the process starts fast.
"""

import itertools
import json
import sys
from pathlib import Path

import mujoco
import numpy as np

BACKGROUND = (240, 241, 244)
"""Colour behind a model without a sky."""

TRAIL, TRAIL_WIDTH = (0.78, 0.39, 0.12, 1.0), 0.012
"""Colour and radius [m] of the path that a robot has travelled."""


def main(folder: Path) -> None:
    """Render the models of the request in a folder."""
    request = json.loads((folder / "request.json").read_text())
    camera = mujoco.MjvCamera()
    camera.lookat[:] = request["lookat"]
    camera.distance, camera.azimuth, camera.elevation = (request[key] for key in ("distance", "azimuth", "elevation"))
    width, height = request["width"], request["height"]
    towards = np.array(request["lamp"])
    poses = np.load(folder / "poses.npy") if (folder / "poses.npy").is_file() else None
    pictures: list[np.ndarray] = []
    for name in request["models"]:
        model = mujoco.MjModel.from_binary_path(str(folder / name))
        data = mujoco.MjData(model)
        model.vis.global_.fovy = request["fovy"]
        # The shadow map must extend beyond the picture: its border shows artefacts on the ground.
        model.vis.map.shadowclip, model.vis.quality.shadowsize = 2.0, 4096
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        has_sky = bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())
        with mujoco.Renderer(model, height, width) as renderer:
            for qpos in data.qpos[None].copy() if poses is None else poses:
                data.qpos[:] = qpos
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera)
                _light(renderer.scene, np.array(request["lookat"]), towards, request["distance"])
                _draw_trail(renderer.scene, request.get("trail", []), len(pictures) + request.get("first", 0))
                pictures.append(renderer.render() if has_sky else _with_background(renderer))
    np.save(folder / "pictures.npy", np.stack(pictures))


def _light(scene: mujoco.MjvScene, target: np.ndarray, towards: np.ndarray, distance: float) -> None:
    """Replace a model's lights by a weak headlight and one lamp that casts shadows."""
    head, lamp = scene.lights[0], scene.lights[1]
    scene.nlight = 2
    head.ambient[:], head.diffuse[:], head.specular[:] = 0.35, 0.4, 0.05
    head.headlight, head.castshadow, head.type = 1, 0, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.5, 0.2
    lamp.headlight, lamp.castshadow, lamp.type = 0, 1, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.pos[:], lamp.dir[:] = target + 0.5 * distance * towards, -towards


def _with_background(renderer: mujoco.Renderer) -> np.ndarray:
    """The picture of a model without a sky, which MuJoCo draws black, before a light background."""
    picture = renderer.render()
    renderer.enable_segmentation_rendering()
    picture[renderer.render()[..., 0] < 0] = BACKGROUND
    renderer.disable_segmentation_rendering()
    return picture


def _draw_trail(scene: mujoco.MjvScene, points: list[list[float]], last: int) -> None:
    """Add a line on the ground through the points (n, 3) up to one of them."""
    for start, end in itertools.pairwise(points[: last + 1]):
        if scene.ngeom < scene.maxgeom and start != end:
            geom = scene.geoms[scene.ngeom]
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(TRAIL, np.float32))
            mujoco.mjv_connector(geom, kind, TRAIL_WIDTH, np.array(start), np.array(end))
            scene.ngeom += 1


if __name__ == "__main__":
    main(Path(sys.argv[1]))
