"""Points at which a robot may touch what does not move: distance and velocity, from joint encoders and a pose."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np


@dataclass(frozen=True, eq=False)
class Touching:
    """Points of possible contact, N over all samples, seen from some poses of the base.

    Attributes:
      sample: (N,) sample of each point.
      geom: (N,) geom of the robot.
      distance: (N,) from the surface of the other geom [m]; negative inside it.
      normal: (N, 3) away from the other geom, in the world.
      world: (N, 3) the point in the world [m].
      place: (N, 3) from the inertial unit to the point, in the frame of the base [m].
      velocity: (N, 3) of the point relative to the base by the joints, in its frame [m/s].
      distance_variance: (N,) by the noise of the encoders [m^2].
      velocity_covariance: (N, 3, 3) by the noise of the joints' velocities [(m/s)^2].
    """

    sample: np.ndarray
    geom: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    world: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    distance_variance: np.ndarray
    velocity_covariance: np.ndarray

    def distances(self, moved: np.ndarray) -> np.ndarray:
        """Distances (N,) [m] of points (N, 3) that moved in the world."""
        return self.distance + np.einsum("ni,ni->n", self.normal, moved - self.world)


def touching_points(
    model: mujoco.MjModel,
    base: int,
    unit: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    sigma: np.ndarray,
    margin: float,
) -> Touching:
    """Points of a robot that are near what does not move.

    Args:
      model: the believed model.
      base: its body with the free joint.
      unit: (3,) place of the inertial unit in the frame of the base [m].
      qpos: (K, nq) configurations.
      qvel: (K, nv) velocities of the joints; those of the base are not used.
      sigma: (2 nv,) noise of positions and velocities.
      margin: largest distance [m].
    """
    model = copy.copy(model)
    model.geom_margin[:], model.body_margin[:] = margin, margin
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    free = int(model.jnt_dofadr[model.body_jntadr[base]])
    joints = np.delete(np.arange(model.nv), np.arange(free, free + 6))
    variance_q, variance_v = sigma[joints] ** 2, sigma[model.nv + joints] ** 2
    fixed = model.body_weldid[model.geom_bodyid] == 0
    rows: list[tuple[float, ...]] = []
    jacobians, turns = list[np.ndarray](), list[np.ndarray]()
    for k in range(len(qpos)):
        data.qpos[:] = qpos[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        turn = data.xmat[base].reshape(3, 3).copy()
        at = data.xpos[base] + turn @ unit
        contact = data.contact
        sides = fixed[contact.geom]
        for i in np.flatnonzero(sides[:, 0] != sides[:, 1]).tolist():
            sign, own = (1.0, 1) if sides[i, 0] else (-1.0, 0)
            geom, away = int(contact.geom[i, own]), sign * contact.frame[i, :3]
            point = contact.pos[i] + 0.5 * contact.dist[i] * away  # on the robot; MuJoCo's is half way between both
            mujoco.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[geom])
            rows.append((k, geom, contact.dist[i], *away, *point, *at))
            jacobians.append(jacobian[:, joints])
            turns.append(turn)
    table, count = np.array(rows).reshape(-1, 12), len(rows)
    sample, normal, world = table[:, 0].astype(int), table[:, 3:6], table[:, 6:9]
    turn = np.array(turns).reshape(count, 3, 3)
    into = np.swapaxes(turn, 1, 2)  # the frame of the base
    by_joints = into @ np.array(jacobians).reshape(count, 3, len(joints))
    along = (into @ normal[..., None])[..., 0]
    return Touching(
        sample,
        table[:, 1].astype(int),
        table[:, 2],
        normal,
        world,
        (into @ (world - table[:, 9:])[..., None])[..., 0],
        (by_joints @ qvel[sample][:, joints, None])[..., 0],
        np.einsum("ni,nij->nj", along, by_joints) ** 2 @ variance_q,
        (by_joints * variance_v) @ np.swapaxes(by_joints, 1, 2),
    )
