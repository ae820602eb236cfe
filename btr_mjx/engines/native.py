"""The `native` engine: MuJoCo's own C code in float64 on threads, by `mujoco.batch.Batch`.

It is the reference for the engines inside JAX, and can simulate a reality that shares no code with them, at another
time step and with another integrator. Results are bit-identical for any number of threads.
"""

import copy
from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco.batch import Batch

from btr_mjx.engines.base import Leaves, Start
from btr_mjx.engines.record import Record
from btr_mjx.robots import Signal
from btr_mjx.runs import available_cores

_SEGMENT = 100
"""Number of steps per call of MuJoCo, which limits the memory for recorded arrays."""

INTEGRATORS: Mapping[str, int] = {
    "euler": int(mujoco.mjtIntegrator.mjINT_EULER),
    "implicitfast": int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
    "implicit": int(mujoco.mjtIntegrator.mjINT_IMPLICIT),
    "rk4": int(mujoco.mjtIntegrator.mjINT_RK4),
}
"""Integrators by the name of their setting."""


def rollout_native(
    model: mujoco.MjModel,
    leaves: Leaves,
    controllers: np.ndarray,
    samples: np.ndarray,
    *,
    signal: Signal,
    base_address: tuple[int, int] | None,
    record_states: bool,
    start: Start | None = None,
    timestep: float | None = None,
    integrator: str | None = None,
    threads: int | None = None,
) -> Record:
    """Simulate pairs in native MuJoCo.

    Args:
      model: the base model.
      leaves: MjModel field -> (B, *field shape).
      controllers: (B, n_c).
      samples: (K,) ascending step counts at which to record.
      signal: reference signal of the robot, sampled at the start of each step.
      base_address: addresses of the base's position in qpos and of its velocity in qvel, or None.
      record_states: whether qpos, qvel and act are recorded.
      start: state in which the rollouts start; None for the model's qpos0 at rest.
      timestep: another time step than the model's [s]; samples then count its steps.
      integrator: another integrator, a key of `INTEGRATORS`.
      threads: number of threads; None for all cores.

    Returns:
      The record, batch first. Pairs whose state became invalid have NaN positions from that time on.
    """
    model = copy.copy(model)
    if timestep is not None:
        model.opt.timestep = timestep
    if integrator is not None:
        model.opt.integrator = INTEGRATORS[integrator]
    # An invalid state must stay visible: MuJoCo's automatic reset would replace it by the initial state.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    count, dt = len(controllers), float(model.opt.timestep)
    batch = Batch(model, nsim=count, nthread=threads or available_cores())
    expand(batch, leaves)
    # With stage NONE a reset only writes qpos0; the constants of the models are already in the leaves.
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    parameters = np.ascontiguousarray(controllers.T)
    qpos, qvel, act = (batch.bind(name) for name in ("qpos", "qvel", "act"))
    if "qpos0" in leaves:
        qpos[:] = leaves["qpos0"]
    if start is not None:
        qpos[:], qvel[:], act[:] = start

    def base() -> np.ndarray:
        if base_address is None:
            return np.zeros((count, 3))
        return np.array(qpos[:, base_address[0] : base_address[0] + 3])

    origin, energy, peak = base(), np.zeros(count), np.zeros(count)
    capped, alive = np.zeros(count, np.int32), np.ones(count, bool)
    records: list[tuple] = []
    done = 0
    wanted = ("actuator_force", "actuator_velocity", "qvel", "solver_niter")
    for sample in np.asarray(samples, int):
        while done < sample:
            steps = int(min(_SEGMENT, sample - done))
            times = np.arange(done, done + steps) * dt
            control = np.stack([signal(parameters, t, np) for t in times], axis=0)  # (steps, nu, B)
            out = batch.rollout(steps, np.moveaxis(control, 2, 0), record=wanted)
            energy += dt * np.abs(out["actuator_force"] * out["actuator_velocity"]).sum((1, 2))
            if base_address is not None:
                velocity = out["qvel"][:, :, base_address[1] : base_address[1] + 3]
                peak = np.maximum(peak, np.linalg.norm(velocity, axis=-1).max(1))
            iterations = out["solver_niter"].reshape(count, steps, -1).max(-1)
            capped += (iterations >= model.opt.iterations).sum(1).astype(np.int32)
            alive &= ~(np.asarray(batch.warning).reshape(count, -1)[:, _INVALID_STATE_WARNINGS].any(1))
            done += steps
        position = np.where(alive[:, None], base(), np.nan)
        states = tuple(np.array(x if record_states else x[:, :0]) for x in (qpos, qvel, act))
        records.append((position, energy.copy(), *states))
    position, work, *recorded = (np.stack(column, axis=1) for column in zip(*records, strict=True))
    return Record(origin, position, work, peak, capped, np.zeros(count, bool), *recorded)


_INVALID_STATE_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


def expand(batch: Batch, leaves: Leaves) -> None:
    """Write the fields in which models differ, (B, *field shape), into a batch of MuJoCo, which holds no statistics."""
    for name, values in leaves.items():
        if not name.startswith("stat."):
            batch.expand(name)[...] = values
