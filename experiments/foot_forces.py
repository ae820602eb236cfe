"""Contact forces at the feet, from the recorded states of a rollout.

Contact forces are a function of the state, so they need not be recorded: native MuJoCo computes them again in float64,
as readings of a touch sensor around each foot. This works for every engine and costs one forward pass per sample.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from btr_mjx.engines import expand
from btr_mjx.errors import InputError
from btr_mjx.evaluation import Outcome
from btr_mjx.models import compile_models
from btr_mjx.robots import Robot

_AROUND = 100.0
"""Radius of a touch sensor's zone [m], large enough to contain all contacts of its body."""

_ROWS = 512
"""Number of pairs that are computed at a time."""


def foot_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the bodies at the ends of the limbs: those with a joint and without child bodies."""
    parents = set(model.body_parentid[1:].tolist())
    ends = [b for b in range(1, model.nbody) if b not in parents and model.body_jntnum[b]]
    return tuple(model.body(b).name for b in ends)


def foot_forces(
    robot: Robot, simulations: ArrayLike, controllers: ArrayLike, outcome: Outcome, bodies: Sequence[str] | None = None
) -> np.ndarray:
    """Normal contact forces at the feet.

    Args:
      robot: the robot.
      simulations: (L, n_s), as evaluated.
      controllers: (M, n_c), as evaluated.
      outcome: of every simulation with every controller (L, M), with states.
      bodies: bodies with a sensor; None for the ends of the limbs.

    Returns:
      (L, M, K, feet) sums over a body's contacts [N], under the control at the sample time; NaN where the state is
      not finite.

    Raises:
      InputError: an outcome without states or of another shape; a body that the robot does not have.
    """
    s, c = np.atleast_2d(np.asarray(simulations)), np.atleast_2d(np.asarray(controllers))
    if outcome.qpos is None or outcome.qvel is None or outcome.act is None:
        raise InputError("outcome: it holds no states; call evaluate(..., states=True)")
    if outcome.qpos.shape[:2] != (len(s), len(c)):
        raise InputError(
            f"outcome: got {outcome.qpos.shape[:2]} pairs, expected {(len(s), len(c))}: every simulation with every "
            "controller"
        )
    model, models = _with_sensors(robot, bodies), compile_models(robot, s)
    out = np.empty((*outcome.qpos.shape[:3], model.nsensor))
    flat = out.reshape(len(s) * len(c), *out.shape[2:])
    states = [x.reshape(len(flat), *x.shape[2:]) for x in (outcome.qpos, outcome.qvel, outcome.act)]
    for first in range(0, len(flat), _ROWS):
        rows = np.arange(first, min(first + _ROWS, len(flat)))
        leaves = {name: values[rows // len(c)] for name, values in models.leaves.items()}
        batch = Batch(model, nsim=len(rows), nthread=0)
        expand(batch, leaves)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        fields = [batch.bind(name) for name in ("qpos", "qvel", "act")]
        ctrl, read = batch.bind("ctrl"), batch.bind("sensordata")
        parameters = np.ascontiguousarray(c[rows % len(c)].T)
        for k, time in enumerate(outcome.times):
            finite = np.all([np.isfinite(x[rows, k]).all(axis=-1) for x in states], axis=0)
            for field, x in zip(fields, states, strict=True):
                field[finite] = x[rows[finite], k]
            ctrl[:] = robot.signal(parameters, time, np).T
            batch.forward()
            flat[rows, k] = np.where(finite[:, None], read, np.nan)
    return out


def _with_sensors(robot: Robot, bodies: Sequence[str] | None) -> mujoco.MjModel:
    """The nominal model with a touch sensor on each body."""
    spec = mujoco.MjSpec.from_string(robot.render(robot.nominal_simulation))
    names = foot_bodies(spec.compile()) if bodies is None else bodies
    known = [body.name for body in spec.bodies]
    for i, name in enumerate(names):
        if name not in known:
            raise InputError(f"bodies: got {name!r}, expected one of the model's bodies: {', '.join(known)}")
        spec.body(name).add_site(name=f"touch_{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_AROUND, 0, 0])
        spec.add_sensor(
            name=f"touch_{i}",
            type=mujoco.mjtSensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"touch_{i}",
        )
    model = spec.compile()
    # An invalid state must stay visible: MuJoCo's automatic reset would replace it by the initial state.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model
