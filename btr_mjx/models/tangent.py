"""Differences and sums of configurations in the tangent space, for many rows at once.

The configuration (nq,) of a free or ball joint holds a quaternion. Differences are tangent vectors (nv,), with
rotations as rotation vectors in the joint's own frame, as in MuJoCo's qvel.
"""

import mujoco
import numpy as np

_SMALL = 1e-12
"""Angle below which the limit of small rotations is used [rad]."""


def difference(model: mujoco.MjModel, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The tangent vector from one configuration to another, as `mj_differentiatePos` with dt = 1.

    Args:
      model: the model.
      start: (..., nq) configurations.
      end: (..., nq) configurations.

    Returns:
      (..., nv) vectors d with `integrate(model, start, d) == end` up to the sign of quaternions.
    """
    start, end = np.broadcast_arrays(start, end)
    q_of, v_of, balls = _layout(model)
    out = np.empty((*start.shape[:-1], model.nv))
    out[..., v_of] = end[..., q_of] - start[..., q_of]
    for q, v in balls:
        out[..., v : v + 3] = _log(_multiply(_conjugate(start[..., q : q + 4]), end[..., q : q + 4]))
    return out


def integrate(model: mujoco.MjModel, qpos: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Configurations (..., nq) moved along tangent vectors (..., nv), as `mj_integratePos` with dt = 1; normalised."""
    shape = np.broadcast_shapes(qpos.shape[:-1], tangent.shape[:-1])
    qpos = np.broadcast_to(qpos, (*shape, model.nq))
    q_of, v_of, balls = _layout(model)
    out = np.empty((*shape, model.nq))
    out[..., q_of] = qpos[..., q_of] + tangent[..., v_of]
    for q, v in balls:
        turned = _multiply(qpos[..., q : q + 4], _exp(tangent[..., v : v + 3]))
        out[..., q : q + 4] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return out


def between(
    model: mujoco.MjModel,
    states: tuple[np.ndarray, np.ndarray],
    following: tuple[np.ndarray, np.ndarray],
    fraction: np.ndarray,
    step: float | np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """States between two steps, by cubic Hermite interpolation in the tangent space of the earlier configuration.

    Args:
      model: the model.
      states: qpos (N, nq) and qvel (N, nv) at the earlier step.
      following: qpos and qvel one step later.
      fraction: (N,) elapsed fraction of the step, in [0, 1].
      step: length of the step [s], or (N, 1) of each.

    Returns:
      qpos (N, nq) and qvel (N, nv); velocities are interpolated linearly.
    """
    (q0, v0), (q1, v1) = states, following
    s = np.asarray(fraction)[:, None]
    d = difference(model, q0, q1)
    chord = s * s * (3 - 2 * s) * d + step * s * (1 - s) * ((1 - s) * v0 - s * v1)
    return integrate(model, q0, chord), v0 + s * (v1 - v0)


def _layout(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Addresses of plain coordinates in qpos and in qvel, and (qpos, qvel) addresses of quaternions."""
    plain_q: list[int] = []
    plain_v: list[int] = []
    balls = []
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    for kind, q, v in zip(model.jnt_type.tolist(), model.jnt_qposadr.tolist(), model.jnt_dofadr.tolist(), strict=True):
        if kind == free:
            plain_q += range(q, q + 3)
            plain_v += range(v, v + 3)
            balls.append((q + 3, v + 3))
        elif kind == ball:
            balls.append((q, v))
        else:
            plain_q.append(q)
            plain_v.append(v)
    return np.array(plain_q, int), np.array(plain_v, int), balls


def _conjugate(a: np.ndarray) -> np.ndarray:
    return a * np.array([1.0, -1.0, -1.0, -1.0])


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w1, x1, y1, z1 = np.moveaxis(a, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def _exp(rotation: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    scale = np.where(angle > _SMALL, np.sin(angle / 2) / np.maximum(angle, _SMALL), 0.5)
    return np.concatenate([np.cos(angle / 2), scale * rotation], axis=-1)


def _log(quaternion: np.ndarray) -> np.ndarray:
    quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    scale = np.where(sine > _SMALL, 2 * np.arctan2(sine, quaternion[..., :1]) / np.maximum(sine, _SMALL), 2.0)
    return scale * quaternion[..., 1:]


def sign_flips(quat: np.ndarray) -> np.ndarray:
    """(K,) -1 where the quaternions (K, 4) have to change their sign to be continuous, else 1."""
    return np.cumprod(np.r_[1.0, np.where(np.sum(quat[1:] * quat[:-1], axis=1) < 0, -1.0, 1.0)][: len(quat)])
