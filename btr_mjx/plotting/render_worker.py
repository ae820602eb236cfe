"""Rendering of MuJoCo models in a separate process, started by `btr_mjx.plotting.pictures` (which has the reasons).

    python -P render_worker.py FOLDER

FOLDER holds request.json and one binary model per picture. The result is pictures.npy, (n, height, width, 3) uint8.
This file does not import the package, so that the process starts fast.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np


def main(folder: Path) -> None:
    """Render the models of the request in a folder."""
    request = json.loads((folder / "request.json").read_text())
    camera = mujoco.MjvCamera()
    camera.lookat[:] = request["lookat"]
    camera.distance, camera.azimuth, camera.elevation = (request[key] for key in ("distance", "azimuth", "elevation"))
    width, height = request["width"], request["height"]
    towards = np.array(request["lamp"])
    pictures = []
    for name in request["models"]:
        model = mujoco.MjModel.from_binary_path(str(folder / name))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        model.vis.global_.fovy = request["fovy"]
        # The shadow map must extend beyond the picture: its border shows artefacts on the ground.
        model.vis.map.shadowclip, model.vis.quality.shadowsize = 2.0, 4096
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        with mujoco.Renderer(model, height, width) as renderer:
            renderer.update_scene(data, camera)
            _light(renderer.scene, np.array(request["lookat"]), towards, request["distance"])
            pictures.append(renderer.render())
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


if __name__ == "__main__":
    main(Path(sys.argv[1]))
