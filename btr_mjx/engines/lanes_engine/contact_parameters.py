"""Parameters of contacts and other constraint rows, derived from MjModel fields in float64 on the host.

Source: google-deepmind/mujoco, mj_contactParam, mj_makeImpedance, getsolparam.
"""

import mujoco
import numpy as np

from btr_mjx.engines.guards.pairs import explicit_pairs
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.field_access import Fields, apply_matrix, rigid_pose, rotation_matrices
from btr_mjx.engines.lanes_engine.tree import Touch

MINVAL = 1e-15
"""MuJoCo's mjMINVAL."""
_MINMU, _MINIMP, _MAXIMP = 1e-5, 1e-4, 0.9999  # MuJoCo's constants of these names


def _reference(solref: np.ndarray, dmax: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """Stiffness K [1/s^2] and damping B [1/s] of a constraint from its solref, (..., 2)."""
    mixed = (solref[..., 0] > 0) != (solref[..., 1] > 0)
    solref = np.where(mixed[..., None], [0.02, 1.0], solref)
    time, ratio = solref[..., 0], solref[..., 1]
    if not support.disabled(model, "REFSAFE"):
        time = np.where(time > 0, np.maximum(time, 2 * model.opt.timestep), time)
    positive = np.where(time > 0, time, 1.0), np.where(ratio > 0, ratio, 1.0)
    k = np.where(
        time > 0, 1 / np.maximum(MINVAL, (dmax * positive[0] * positive[1]) ** 2), -time / np.maximum(MINVAL, dmax**2)
    )
    b = np.where(ratio > 0, 2 / np.maximum(MINVAL, dmax * positive[0]), -ratio / np.maximum(MINVAL, dmax))
    return np.stack([k, b], -1)


def _impedance(solimp: np.ndarray) -> np.ndarray:
    """Clamped (dmin, dmax, width, midpoint, power); a constant impedance has dmin = dmax."""
    low, high, mid = (np.clip(solimp[..., i], _MINIMP, _MAXIMP) for i in (0, 1, 3))
    width, power = solimp[..., 2], np.maximum(1, solimp[..., 4])
    flat = (low == high) | (width <= MINVAL)
    mean = 0.5 * (low + high)
    return np.stack([np.where(flat, mean, low), np.where(flat, mean, high), np.where(flat, 1.0, width), mid, power], -1)


def constraint_row(solref: np.ndarray, solimp: np.ndarray, model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Reference and impedance of a constraint row from its solref (..., 2) and solimp (..., 5), as in MJCF.

    "reference" (..., 2) is stiffness [1/s^2] and damping [1/s], "impedance" (..., 5) dmin, dmax, width, midpoint and
    power. The model's time step limits the time constant.
    """
    dmax = np.clip(solimp[..., 1], _MINIMP, _MAXIMP)
    return {"reference": _reference(solref, dmax, model), "impedance": _impedance(solimp)}


def plane_frame(model: mujoco.MjModel, fields: Fields, geom: int) -> dict[str, np.ndarray]:
    """Contact frame (normal and two tangents, as mju_makeFrame) and offset of a plane along its normal."""
    position, matrix = rigid_pose(model, fields, int(model.geom_bodyid[geom]), 0)
    position = position + apply_matrix(matrix, fields("geom_pos", geom))
    normal = (matrix @ rotation_matrices(fields("geom_quat", geom)))[..., 2]
    guess = np.where(np.abs(normal[..., 1:2]) < 0.5, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    tangent = guess - (guess * normal).sum(-1, keepdims=True) * normal
    tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    frame = np.concatenate([normal, tangent, np.cross(normal, tangent)], -1)
    return {"frame": frame, "offset": (normal * position).sum(-1, keepdims=True)}


def touch_parameters(
    model: mujoco.MjModel, fields: Fields, body: int, touch: Touch, geom: int
) -> dict[str, np.ndarray]:
    """Geometry and mixed contact parameters of one geom against one plane."""
    plane = touch.plane
    owner = int(model.geom_bodyid[geom])
    position, matrix = rigid_pose(model, fields, owner, body)
    result = {"centre": position + apply_matrix(matrix, fields("geom_pos", geom))}
    size = fields("geom_size", geom)
    if touch.kind != support.SPHERE:
        matrix = matrix @ rotation_matrices(fields("geom_quat", geom))
    if touch.kind in (support.CAPSULE, support.CYLINDER):
        result["axis"] = matrix[..., 2]
        result["half"] = size[..., 1:2]
    if touch.kind == support.CYLINDER:
        result |= {"side": matrix[..., 0], "rim": size[..., 0:1]}
    if touch.kind in (support.BOX, support.ELLIPSOID):
        edges = matrix * size[..., None, :]
        result["edges"] = np.swapaxes(edges, -1, -2).reshape(*edges.shape[:2], 9)
    rounded = touch.kind in (support.SPHERE, support.CAPSULE)
    result["radius"] = size[..., 0:1] if rounded else np.zeros((1, 1, 1))
    return result | contact_parameters(model, fields, plane, geom, touch.condim)


def contact_parameters(
    model: mujoco.MjModel, fields: Fields, first: int, second: int, condim: int
) -> dict[str, np.ndarray]:
    """Mixed parameters of the contact of two geoms (mj_contactParam, mj_makeImpedance)."""
    explicit = explicit_pairs(model, first, second)
    rank = model.geom_priority[first], model.geom_priority[second]
    both = {
        key: (fields(f"geom_{key}", first), fields(f"geom_{key}", second)) for key in ("solref", "solimp", "friction")
    }
    if explicit:
        chosen = {key: fields(f"pair_{key}", explicit[0]) for key in ("solref", "solimp")}
        chosen["friction"] = fields("pair_friction", explicit[0])[..., [0, 2, 3]]
    elif rank[0] != rank[1]:
        chosen = {key: value[0 if rank[0] > rank[1] else 1] for key, value in both.items()}
    else:
        chosen = _mix(fields("geom_solmix", first)[..., None], fields("geom_solmix", second)[..., None], both)
    friction = np.maximum(_MINMU, chosen["friction"][..., : max(1, condim // 2)])  # sliding, spinning, rolling
    owners = [int(model.geom_bodyid[geom]) for geom in (first, second)]
    weight = fields("body_invweight0", owners[0])[..., 0:1] + fields("body_invweight0", owners[1])[..., 0:1]
    if condim >= 3 and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        mu = friction[..., :1]
        weight = weight * 2 * mu**2 * (1 + mu**2) / np.maximum(MINVAL, fields("opt.impratio")[..., None])
    result = {"friction": friction, "scale": 1 / np.maximum(MINVAL, weight)}
    result |= constraint_row(chosen["solref"], chosen["solimp"], model)
    if explicit:
        return result | {"margin": fields("pair_margin", slice(explicit[0], explicit[0] + 1))}
    return result | {"margin": (fields("geom_margin", first) + fields("geom_margin", second))[..., None]}


def _mix(
    first: np.ndarray, second: np.ndarray, both: dict[str, tuple[np.ndarray, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Contact parameters of two geoms of equal priority, from their solmix weights (..., 1)."""
    small1, small2 = first < MINVAL, second < MINVAL
    share = np.where(small1 | small2, 1.0, first / np.where(small1 | small2, 1.0, first + second))
    share = np.where(small1 & small2, 0.5, np.where(small1, 0.0, np.where(small2, 1.0, share)))
    ref1, ref2 = both["solref"]
    standard = (ref1[..., 0:1] > 0) & (ref2[..., 0:1] > 0)
    return {
        "solref": np.where(standard, share * ref1 + (1 - share) * ref2, np.minimum(ref1, ref2)),
        "solimp": share * both["solimp"][0] + (1 - share) * both["solimp"][1],
        "friction": np.maximum(*both["friction"]),
    }
