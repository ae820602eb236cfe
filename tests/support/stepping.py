"""Steps of native MuJoCo in one call: a loop over `mj_step` in Python takes longer than the steps."""

import mujoco
import mujoco.rollout
import numpy as np


def stepped(
    model: mujoco.MjModel, ctrl: np.ndarray, start: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T + 1, nq) and velocities (T + 1, nv) before each of T steps and after the last one.

    Args:
      model: the model.
      ctrl: (T, nu) controls of the steps.
      start: (qpos, qvel); None for those of the model.
    """
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    if start is not None:
        data.qpos[:], data.qvel[:] = start
    first = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, first, kind)
    states = mujoco.rollout.rollout(model, data, first, ctrl if model.nu else None, nstep=len(ctrl))[0][0]
    rows = np.concatenate([first[None], states])[:, 1:]  # without the time
    return rows[:, : model.nq], rows[:, model.nq : model.nq + model.nv]
