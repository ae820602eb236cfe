"""Models without the surfaces of their meshes, which only pictures need: a search copies a model thousands of times.

MuJoCo collides the convex hull of a mesh. A mesh is replaced by the corners of its hull, or of its box where no geom of
it collides; bodies keep the masses and inertias that followed from the whole mesh. Number, names and order of all parts
stay the same.
"""

from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.models.model_checks import COMPILE_ERRORS

_HEAVY = 4_000_000
"""Bytes of a model from which on its meshes are replaced."""


def with_light_meshes(path: Path, model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with light meshes, where it takes much memory.

    Args:
      path: MJCF file.
      model: compiled from it.

    Returns:
      A model that moves like the given one and collides with the same hulls, though number and depth of contact points
      may differ by fractions of a millimetre; or the given one, where its meshes are few or MuJoCo does not take their
      hulls (of flat meshes, for example).
    """
    if not model.nmesh or mujoco.mj_sizeModel(model) < _HEAVY:
        return model
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compile()
    meshes, bodies = [mesh.id for mesh in spec.meshes], [body.id for body in spec.bodies]
    spec = mujoco.MjSpec.from_file(str(path))  # a compiled one keeps what it made of the files
    for number, mesh in zip(meshes, spec.meshes, strict=True):
        mesh.uservert = _corners(model, number).ravel().tolist()
        mesh.userface, mesh.usernormal, mesh.usertexcoord, mesh.userfacetexcoord = [], [], [], []
        mesh.file, mesh.content_type = "", ""
        mesh.scale, mesh.refpos, mesh.refquat = np.ones(3), np.zeros(3), np.array([1.0, 0, 0, 0])
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    for number, body in zip(bodies, spec.bodies, strict=True):
        body.simple = 0
        if number == 0:
            continue
        body.explicitinertial = True
        body.mass, body.ipos, body.iquat = model.body_mass[number], model.body_ipos[number], model.body_iquat[number]
        body.inertia, body.fullinertia = model.body_inertia[number], np.full(6, np.nan)
    try:
        light = spec.compile()
    except COMPILE_ERRORS:
        return model
    same = all(getattr(light, name) == getattr(model, name) for name in ("nq", "nv", "nu", "nbody", "ngeom", "nsite"))
    same = same and all(
        np.allclose(getattr(light, name), getattr(model, name), rtol=1e-9, atol=1e-12)
        for name in ("body_mass", "body_inertia", "body_ipos", "dof_M0")
        if hasattr(model, name)
    )
    return light if same else model


def _corners(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Corners (N, 3) of a mesh's hull, in the coordinates of the mesh's file."""
    first = int(model.mesh_vertadr[mesh])
    points = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], float)
    graph = int(model.mesh_graphadr[mesh])
    if graph >= 0:
        count = int(model.mesh_graph[graph])
        points = points[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
    else:
        low, high = points.min(axis=0), points.max(axis=0)
        points = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])
    return points @ turn.reshape(3, 3).T + model.mesh_pos[mesh]
