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

TILES = 24
"""Tiles along each side of the pattern on a bare floor."""

TILE_SHADE, TILE_HEIGHT = 0.8, 1e-3
"""Brightness of the dark tiles over that of the floor, and their height over the width of a tile."""


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
                _tile_bare_floors(renderer.scene, model, np.array(request["lookat"]), request["distance"])
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


def _tile_bare_floors(scene: mujoco.MjvScene, model: mujoco.MjModel, target: np.ndarray, distance: float) -> None:
    """Add dark tiles to planes without a material, on which motion would not be seen."""
    width = 2.0 ** round(np.log2(distance / 10))
    for floor in list(scene.geoms[: scene.ngeom]):
        if floor.type != mujoco.mjtGeom.mjGEOM_PLANE or floor.objtype != mujoco.mjtObj.mjOBJ_GEOM:
            continue
        if model.geom_matid[floor.objid] >= 0:
            continue
        frame, extent = np.array(floor.mat).reshape(3, 3), model.geom_size[floor.objid, :2]
        middle = np.round((target - floor.pos) @ frame / width).astype(int)
        colour = np.append(TILE_SHADE * np.array(floor.rgba[:3]), 1.0).astype(np.float32)
        for i, j in itertools.product(range(-TILES // 2, TILES // 2), repeat=2):
            place = width * (np.array([middle[0] + i, middle[1] + j, 0]) + 0.5) * [1, 1, 0]
            outside = (extent > 0) & (np.abs(place[:2]) + width / 2 > extent)
            if (i + j + middle[0] + middle[1]) % 2 or outside.any() or scene.ngeom >= scene.maxgeom:
                continue
            geom, size = scene.geoms[scene.ngeom], width / 2 * np.array([1, 1, TILE_HEIGHT])
            at = np.array(floor.pos) + frame @ place
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, at, frame.ravel(), colour)
            geom.objtype, geom.objid, geom.segid = floor.objtype, floor.objid, floor.segid  # part of the floor
            scene.ngeom += 1


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
