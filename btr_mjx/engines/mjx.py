"""The `mjx` engine: `jax.vmap` of `mujoco.mjx.step`. General, differentiable, any device; the reference inside JAX.

The solver runs to convergence, with MuJoCo's own iteration limit and tolerance. Features that MJX would silently ignore
raise `UnsupportedModel`. The integral term of MuJoCo's `pid` actuator, which MJX lacks, is computed here and carried in
the state.
"""

import contextlib
import copy
import io
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from btr_mjx.engines.base import MUJOCO_4, Leaves, UnsupportedModel
from btr_mjx.engines.computed import (
    NUMBERS,
    VARYING,
    base_field,
    element_of,
    influences_motion,
    may_differ,
    not_computed,
    not_plain,
)
from btr_mjx.engines.extremes import extremes
from btr_mjx.engines.guards.pairs import HFIELD, MESH, geom_pairs

# On import MJX prints on stdout that its optional GPU backend is not installed.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

_RESIDUAL_LIMIT = 1e-3
"""Largest relative residual of the equations of motion, |M a - f| / |f| (1-norms), of a converged step."""


class MjxStepper:
    """Steps a chunk of worlds with `jax.vmap(mjx.step)`; see `btr_mjx.engines.base.Stepper`.

    The state is a dict of batch-first arrays: qpos (C, nq), qvel (C, nv), warmstart (C, nv), integral (C, nu),
    power (C,), residual (C,).
    """

    def __init__(self, model: mujoco.MjModel, varying: frozenset[str]) -> None:
        """Prepare a model, with the names of the fields that `pack` will receive.

        Raises:
          UnsupportedModel: a feature that MJX does not compute.
        """
        self._base, put = model, _put(model)
        self.nq, self.nv, self.nu = model.nq, model.nv, model.nu
        self.timestep = float(model.opt.timestep)
        self._pid = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_PID
        self._structure: Any = jax.tree.structure(put)
        self._used = tuple(sorted(name for name in varying if isinstance(_leaf(put, name), jax.Array)))
        lost = sorted(name for name in varying if name not in self._used and influences_motion(name))
        for name in lost:
            if not may_differ(name, guards_geoms=_meets_meshes(model)) or name in VARYING:
                raise UnsupportedModel(f"mjx: worlds cannot differ in the field {name!r}; use engine='native'")
        # Numpy leaves: device arrays in the closure of a sharded function would be bound to one device.
        self._model = jax.tree.map(lambda x: np.asarray(x) if isinstance(x, jax.Array) else x, put)
        self._data = jax.tree.map(lambda x: np.asarray(x) if isinstance(x, jax.Array) else x, mjx.make_data(put))
        self._integral_gain = model.actuator_gainprm[:, 0] * self._pid
        self._kp = np.where(self._pid, -model.actuator_biasprm[:, 1], 1.0)
        self._length_address = _length_address(model)
        self._gear = model.actuator_gear[:, 0]

    def pack(self, leaves: Leaves) -> dict[str, np.ndarray]:
        """See `Stepper.pack`: the fields that MJX holds, batch first, in the model's precision."""
        if self._pid.any() and ("actuator_gainprm" in leaves or "actuator_biasprm" in leaves):
            raise UnsupportedModel("mjx: gains of `pid` actuators cannot vary within a batch; use engine='lanes'")
        for extreme in extremes(self._base, leaves):
            if jax.tree.structure(_put(extreme)) != self._structure:
                raise UnsupportedModel("mjx: losses or a fluid that only some of the worlds have; use engine='native'")
        return {name: leaves[name].astype(_leaf(self._model, name).dtype, copy=False) for name in self._used}

    def initial(self, params: dict[str, jax.Array], chunk: int) -> dict[str, jax.Array]:
        """See `Stepper.initial`."""
        qpos = jnp.broadcast_to(params.get("qpos0", jnp.asarray(self._model.qpos0)), (chunk, self.nq))
        return self.state(qpos.T, jnp.zeros((self.nv, chunk)))

    def state(self, qpos: Any, qvel: Any, act: Any = None) -> dict[str, jax.Array]:
        """See `Stepper.state`; activations are those of `pid` actuators."""
        dtype = jnp.result_type(float)
        chunk = qpos.shape[-1]
        integral = jnp.zeros((chunk, self.nu), dtype)
        if act is not None and len(act):
            integral = integral.at[:, np.flatnonzero(self._pid)].set(jnp.asarray(act, dtype).T)
        return {
            "qpos": jnp.asarray(qpos, dtype).T,
            "qvel": jnp.asarray(qvel, dtype).T,
            "warmstart": jnp.zeros((chunk, self.nv), dtype),
            "integral": integral,
            "power": jnp.zeros(chunk, dtype),
            "residual": jnp.zeros(chunk, dtype),
        }

    def step(self, params: dict[str, jax.Array], state: dict[str, jax.Array], ctrl: jax.Array) -> dict[str, jax.Array]:
        """See `Stepper.step`."""
        return jax.vmap(self.step_one)(params, state, ctrl.T)

    def step_one(self, params: dict[str, jax.Array], state: dict[str, jax.Array], ctrl: jax.Array) -> dict[str, Any]:
        """One world: `mjx.step` on the model with `params` filled in, under controls (nu,)."""
        # MJX treats numpy leaves as static structure, so they are converted to JAX arrays here.
        model = jax.tree.map(jnp.asarray, self._model).tree_replace(params)
        data = jax.tree.map(jnp.asarray, self._data).replace(
            qpos=state["qpos"],
            qvel=state["qvel"],
            qacc_warmstart=state["warmstart"],
            ctrl=ctrl + (self._integral_gain / self._kp).astype(ctrl.dtype) * state["integral"],
        )
        data = mjx.step(model, data)
        smooth, constraint = data.qfrc_smooth, data.qfrc_constraint
        unbalanced = mjx.mul_m(model, data, data.qacc) - smooth - constraint
        scale = jnp.abs(smooth).sum() + jnp.abs(constraint).sum()
        length = self._gear.astype(ctrl.dtype) * state["qpos"][self._length_address]
        return {
            "qpos": data.qpos,
            "qvel": data.qvel,
            "warmstart": data.qacc_warmstart,
            # act_dot of MuJoCo's pid actuator: the error at the step's start.
            "integral": state["integral"] + self.timestep * (ctrl - length) * self._pid,
            "power": jnp.abs(data.actuator_force * data._impl.actuator_velocity).sum(),
            "residual": jnp.abs(unbalanced).sum() / jnp.maximum(scale, 1e-12),
        }

    def qpos(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.qpos`."""
        return state["qpos"].T

    def qvel(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.qvel`."""
        return state["qvel"].T

    def act(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.act`: either all actuators have an integral or none."""
        return state["integral"].T if self._pid.any() else state["integral"].T[:0]

    def power(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.power`."""
        return state["power"]

    def capped(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.capped`: MJX does not report iterations, so the residual is tested instead."""
        return state["residual"] > _RESIDUAL_LIMIT

    def tripped(self, state: dict[str, jax.Array]) -> jax.Array:
        """See `Stepper.tripped`: MJX computes all contacts of the models that it accepts."""
        return jnp.zeros(state["residual"].shape, bool)


def _put(model: mujoco.MjModel) -> mjx.Model:
    """The model on the device, `pid` actuators as servos.

    Raises:
      UnsupportedModel: a feature that MJX does not compute.
    """
    _refuse(model)
    pid = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_PID
    try:
        put = mjx.put_model(_without_pid(model, pid), impl="jax")
    except NotImplementedError as error:
        raise UnsupportedModel(f"MJX does not support this model: {error}; use engine='native'") from None
    return put.replace(na=0) if pid.any() else put


def _leaf(model: mjx.Model, name: str) -> Any:
    """The value of an mjx.Model with a field's name, or None where MJX does not hold that field."""
    value: Any = model
    for part in name.split("."):
        value = getattr(value, part, None)
    return value


def _meets_meshes(model: mujoco.MjModel) -> bool:
    """Whether meshes or height fields can collide, whose shapes MJX prepares once for all worlds."""
    shaped = {MESH, HFIELD}
    return any({int(model.geom_type[g]) for g in (pair.first, pair.second)} & shaped for pair in geom_pairs(model))


def _without_pid(model: mujoco.MjModel, pid: np.ndarray) -> mujoco.MjModel:
    """A copy whose `pid` actuators are position servos of the same kp and kv."""
    plain = copy.copy(model)
    plain.actuator_gaintype[pid] = mujoco.mjtGain.mjGAIN_FIXED
    plain.actuator_dyntype[pid] = mujoco.mjtDyn.mjDYN_NONE
    plain.actuator_gainprm[pid, 0] = -model.actuator_biasprm[pid, 1]
    plain.actuator_dynprm[pid, 0] = 1.0  # MuJoCo's default, as a <position> actuator has it
    plain.actuator_actadr[pid] = -1
    plain.actuator_actnum[pid] = 0
    return plain


def _length_address(model: mujoco.MjModel) -> np.ndarray:
    """Address in qpos of each actuator's joint; 0 for actuators that need no integral."""
    joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return np.where(joint, model.jnt_qposadr[np.where(joint, model.actuator_trnid[:, 0], 0)], 0)


_ALSO = ("tendon_armature", "tendon_actfrclimited")
"""Fields that MJX computes, beyond those that the tables of `computed` know."""

_LACKING = ("actuator_delay", "pair_adhesion")
"""Fields that these tables know, and MJX ignores where they are not zero."""

_CHECKED = ("opt.integrator", "opt.disableflags", "opt.enableflags", *NUMBERS)
"""Fields of `computed.CHOICES` that MJX itself does not check; members of the others' enums it does."""


def _refuse(model: mujoco.MjModel) -> None:
    """Raise UnsupportedModel for features that MJX ignores: those of which it is not known that MJX computes them."""

    def refuse(what: str) -> None:
        raise UnsupportedModel(f"MJX silently ignores {what}: remove it from the model or use engine='native'")

    for field in _CHECKED:
        values = np.atleast_1d(base_field(model, field)).astype(int)
        for i, value in enumerate(values.tolist()):
            if what := not_computed(field, value):
                refuse(f"{field} {what}{element_of(model, field, i)}")
    for field, i in not_plain(model):
        if field not in _ALSO:
            refuse(f"{field} other than MuJoCo's default{element_of(model, field, i)}")
    for field in _LACKING:
        if len(odd := np.flatnonzero(base_field(model, field))):
            refuse(f"{field}{element_of(model, field, int(odd[0]))}")
    turning = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)).any()
    if MUJOCO_4 and turning and model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise UnsupportedModel(
            "MJX integrates free and ball joints with RK4 as MuJoCo did before 4.0: use engine='native' or 'lanes', or "
            "another integrator"
        )
    fast = model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if MUJOCO_4 and fast and model.jnt_actfrclimited.any() and np.any(model.actuator_biasprm[:, 2]):
        raise UnsupportedModel(
            "MJX integrates actuators at the force limit of a joint (actuatorfrcrange) as MuJoCo did before 4.0: use "
            "engine='native' or 'lanes'"
        )
    pid = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_PID
    if not pid.any():
        return
    names = [model.actuator(i).name or f"actuator {i}" for i in np.flatnonzero(pid)]
    if not np.all(pid):
        raise UnsupportedModel("mjx: `pid` and other actuators in one model; make all of them `pid` or none")
    joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_biasprm[:, 1] < 0)
    position = model.actuator_ctrlspec == mujoco.mjtCtrlInput.mjINPUT_POS
    if not joint.all() or np.any(model.actuator_dynprm) or not position.all():
        raise UnsupportedModel(
            f"mjx: `pid` actuators ({', '.join(names[:3])}, ...) must act on hinges or slides, with kp > 0, "
            "input='pos' and neither imax nor slewmax; use engine='native' for others"
        )
