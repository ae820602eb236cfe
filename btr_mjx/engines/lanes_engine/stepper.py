"""The `Stepper` of the lanes engine: one MuJoCo step for a chunk of worlds, with the batch in the SIMD lanes."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from btr_mjx.engines.base import Leaves
from btr_mjx.engines.computed import VARYING, base_field, may_differ
from btr_mjx.engines.guards.hulls import near_meshes
from btr_mjx.engines.guards.pairs import group_by_condim, group_by_kinds
from btr_mjx.engines.guards.placed_geoms import PlacedGeoms, Pose
from btr_mjx.engines.guards.watch import crossed
from btr_mjx.engines.lanes_engine import support
from btr_mjx.engines.lanes_engine.actuation import actuate, springs, tendon_forces
from btr_mjx.engines.lanes_engine.constraints.body_contacts import body_contacts, columns
from btr_mjx.engines.lanes_engine.constraints.closures import closures
from btr_mjx.engines.lanes_engine.constraints.contacts import contact_points
from btr_mjx.engines.lanes_engine.constraints.dof_constraints import dof_constraints
from btr_mjx.engines.lanes_engine.constraints.path_rows import path_rows
from btr_mjx.engines.lanes_engine.constraints.points import side_by_side
from btr_mjx.engines.lanes_engine.constraints.solver import (
    Constraint,
    ConstraintProblem,
    RowNumbers,
    constrained_acceleration,
    row_shapes,
)
from btr_mjx.engines.lanes_engine.dynamics import (
    ball_rates,
    bias_wrenches,
    dof_system,
    drag,
    inertia_system,
    opposing_forces,
    world_rates,
)
from btr_mjx.engines.lanes_engine.field_access import Fields, rigid_root
from btr_mjx.engines.lanes_engine.integrate import Forward, integrate_step, runge_kutta
from btr_mjx.engines.lanes_engine.kinematics import Motion, motions
from btr_mjx.engines.lanes_engine.lanes_state import (
    LanesState,
    activations_in_order,
    dofs_in_order,
    positions_in_order,
    split_rows,
)
from btr_mjx.engines.lanes_engine.parameters import Parameters, derive, split_constants
from btr_mjx.engines.lanes_engine.tree_builder import has_constraints, make_plan
from btr_mjx.engines.lanes_engine.worlds import require_same_structure
from btr_mjx.engines.rewriting import retrace
from btr_mjx.engines.scalars import add, array, vadd, vsub


class LanesStepper:
    """MuJoCo steps for chunks of worlds whose models differ only in the values of some fields.

    Supports trees of free, ball, hinge and slide joints in contact with planes and with each other; see
    `support.require_supported`. The solver runs to convergence, independent of the model's iteration limits and
    tolerances.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        varying: Iterable[str] | Mapping[str, np.ndarray] = (),
        *,
        dtype: Any = None,
        guards: bool = False,
    ):
        """Prepare the engine for one model structure.

        Args:
          model: the base model; fields that are not in `varying` are compiled in.
          varying: fields that differ between worlds, by MjModel's names ("opt.gravity" for options). As a mapping, the
            values are bool arrays of the field's shape: the elements that may differ. Fields without influence on the
            motion (colours, bounding boxes, ...) are ignored.
          dtype: float32 or float64; None for JAX's default.
          guards: whether a model with contacts that may not be computed is accepted: other geoms' are guarded, those of
            spheres and capsules with each other have few slots. The states of `tripped` worlds are not MuJoCo's.

        Raises:
          UnsupportedModel: the model, or a field that differs between worlds, is not what this engine computes.
          ValueError: a mask of `varying` has the wrong shape.
        """
        self._model, self._dtype = model, np.dtype(dtype or jnp.result_type(float))
        self.nq, self.nv, self.nu = int(model.nq), int(model.nv), int(model.nu)
        self._elliptic = bool(model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC)
        self.timestep = float(model.opt.timestep)
        contacts = support.require_supported(model, guards)
        guarded = [guarded.pair for guarded in contacts.guarded]
        self.geoms = tuple(sorted({g for pair in (*guarded, *contacts.between) for g in (pair.first, pair.second)}))
        self.meshes, rest = near_meshes(model, guarded, self.geoms)
        self.guards = group_by_kinds(model, rest, self.geoms)
        self.between = group_by_condim(model, contacts.between, self.geoms)
        self._masks = self._read_masks(varying)
        enabled = has_constraints(model, "FRICTIONLOSS")
        friction = (
            enabled & ((base_field(model, name) != 0) | self._masks.get(name, False))
            for name in ("dof_frictionloss", "tendon_frictionloss")
        )
        self.plan = make_plan(model, contacts.computed, *friction)
        twice = {name: np.stack([base_field(model, name)] * 2)[None] for name in self._masks}
        self._owners = [rigid_root(model, int(model.geom_bodyid[geom])) for geom in self.geoms]
        self._columns = columns(model, self.plan)
        table = derive(model, self.plan, Fields(model, self._masks, twice), self.geoms, self.between)
        self._constants, arrays = split_constants(table)
        self._zone_layout: list[tuple[int, tuple[int, ...]]] = []
        sample = {key: [np.asarray(column[0], self._dtype) for column in columns] for key, columns in arrays.items()}
        jax.eval_shape(self._record_zone_layout, sample)

    def _read_masks(self, varying: Iterable[str] | Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Field name -> bool array of the field's shape."""
        masks = {}
        for name in sorted(varying):
            if not may_differ(name, guards_geoms=bool(self.geoms)):
                raise support.refuse(f"a field {name!r} that differs between worlds")
            if name not in VARYING:
                continue
            shape = base_field(self._model, name).shape
            mask = np.asarray(varying[name], bool) if isinstance(varying, Mapping) else np.ones(shape, bool)
            if mask.shape != shape:
                raise ValueError(f"mask of field {name!r} has shape {mask.shape}, expected {shape}")
            masks[name] = mask
        return masks

    def pack(self, leaves: Leaves) -> dict[str, list[np.ndarray]]:
        """See `Stepper.pack`.

        Raises:
          UnsupportedModel: the model of a world is not what this engine computes, or has another structure than the
            base model.
          ValueError: a field of `varying` is missing, a field is given that does not vary, or a shape is wrong.
        """
        if {name for name in leaves if name in VARYING} != set(self._masks):
            raise ValueError(f"got the fields {sorted(leaves)}, expected those that vary: {sorted(self._masks)}")
        for name, mask in self._masks.items():
            if leaves[name].shape[2:] != mask.shape:
                raise ValueError(f"field {name!r} has shape {leaves[name].shape}, expected (N, C, *{mask.shape})")
        require_same_structure(self._model, leaves)
        _, arrays = split_constants(
            derive(self._model, self.plan, Fields(self._model, self._masks, leaves), self.geoms, self.between)
        )
        return {key: [column.astype(self._dtype) for column in columns] for key, columns in arrays.items()}

    def _shape(self, size: int, chunk: int) -> tuple[int, ...]:
        return (chunk,) if size == 1 else (size, chunk)

    def _record_zone_layout(self, params: Mapping[str, list[jax.Array]]) -> None:
        """Record, while traced, the number of rows of each constraint and the shape of its group."""
        parameters = Parameters(self._constants, params)
        q, v, _ = self._rest(parameters, 2)
        moving = motions(self.plan, parameters, q, v)
        found, _ = self._constraints(parameters, q, v, moving, self._placed(parameters, moving, 2))
        self._zone_layout += [(count, shape[:-1]) for count, shape in row_shapes(self.plan, found, 2)]

    def _no_zones(self, chunk: int) -> RowNumbers:
        return [[jnp.zeros((*shape, chunk), self._dtype) for _ in range(count)] for count, shape in self._zone_layout]

    def _no_history(self, chunk: int) -> list[list[jax.Array]]:
        """Controls before the first step: zero."""
        return [
            [jnp.zeros(self._shape(size, chunk), self._dtype) for _ in range(samples)]
            for samples, size in self.plan.histories
        ]

    def _constraints(
        self,
        parameters: Parameters,
        q: list[list[jax.Array]],
        v: list[jax.Array],
        moving: Sequence[Motion],
        placed: PlacedGeoms,
    ) -> tuple[list[Constraint], jax.Array]:
        """All constraints, and worlds with contacts between bodies that are not computed, bool (C,)."""
        speeds, lanes = world_rates(self.plan, moving, v), placed.lanes
        between, doubtful = body_contacts(
            self.between, self._owners, self._columns, parameters, placed, moving, speeds, self._elliptic, self._dtype
        )
        over_planes = contact_points(self.plan, parameters, moving, self._elliptic, self._dtype)
        found: list[Constraint] = [
            *dof_constraints(self.plan, parameters, q, speeds),
            *side_by_side(over_planes, lanes, self._dtype),
            *between,
            *path_rows(self.plan, self._columns, parameters, q, v, self._dtype),
            *closures(self.plan, self._columns, parameters, moving, speeds, self._dtype),
        ]
        return found, doubtful

    def initial(self, params: Mapping[str, list[jax.Array]], chunk: int) -> LanesState:
        """See `Stepper.initial`."""
        return self._fresh(*self._rest(Parameters(self._constants, params), chunk), chunk)

    def _fresh(self, q: list[list[jax.Array]], v: list[jax.Array], act: list[jax.Array], chunk: int) -> LanesState:
        """A state without a past."""
        lanes = jnp.zeros(chunk, self._dtype)
        still, zones = [jnp.zeros_like(x) for x in v], self._no_zones(chunk)
        return LanesState(q, v, act, self._no_history(chunk), still, zones, lanes, lanes > 0, lanes > 0)

    def _rest(
        self, parameters: Parameters, chunk: int
    ) -> tuple[list[list[jax.Array]], list[jax.Array], list[jax.Array]]:
        q: list[list[jax.Array]] = []
        v: list[jax.Array] = []
        act: dict[int, jax.Array] = {}
        for link in self.plan.links:
            shape = self._shape(link.size, chunk)
            for n, joint in enumerate(link.joints):
                q.append([array(x, shape, self._dtype) for x in parameters[f"{link.index}/joint{n}/ref"]])
                v += [jnp.zeros(shape, self._dtype) for _ in joint.dofs]
        for a in self.plan.actuators:
            act |= {a.state: jnp.zeros(self._shape(len(a.ids), chunk), self._dtype)} if a.state >= 0 else {}
        return q, v, [act[i] for i in range(self.plan.states)]

    def state(self, qpos: Any, qvel: Any, act: Any = None) -> LanesState:
        """See `Stepper.state`; history buffers of controls are zero."""
        qpos, qvel = jnp.asarray(qpos, self._dtype), jnp.asarray(qvel, self._dtype)
        act = None if act is None else jnp.asarray(act, self._dtype)
        return self._fresh(*split_rows(self._model, self.plan, qpos, qvel, act), qpos.shape[-1])

    def step(self, params: Mapping[str, list[jax.Array]], state: LanesState, ctrl: jax.Array) -> LanesState:
        """See `Stepper.step`."""
        in_parts = jax.default_backend() == "cpu"  # other compilers do not put loops into single functions
        return retrace(self._step, threshold=16, in_parts=in_parts)(params, state, ctrl)

    def _step(self, params: Mapping[str, list[jax.Array]], state: LanesState, ctrl: jax.Array) -> LanesState:
        parameters = Parameters(self._constants, params)
        forward = partial(self._forward, parameters, ctrl)
        if self._model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            return runge_kutta(self.plan, self.timestep, state, forward)
        return integrate_step(self._model, self.plan, state, forward(state))

    def _forward(self, parameters: Parameters, ctrl: jax.Array, state: LanesState) -> Forward:
        """Accelerations at a state (mj_forward)."""
        model, plan = self._model, self.plan
        q, v = state.q, state.v
        moving = motions(plan, parameters, q, v)
        bodies = inertia_system(plan, parameters, moving)
        damping = dof_system(plan, parameters, moving, "damping")
        actuation = actuate(model, plan, parameters, q, v, state.act, state.history, ctrl)
        moves = [(m.velocity, m.angular_velocity) for m in moving]
        wrenches, tau = opposing_forces(damping, moves, ball_rates(plan, moving, v))
        bias = bias_wrenches(plan, parameters, moving)
        wrenches = [(vsub(f, g), vsub(n, o)) for (f, n), (g, o) in zip(wrenches, bias, strict=True)]
        medium = drag(plan, parameters, moving)
        if medium is not None:
            wrenches = [(vadd(f, g), vadd(n, o)) for (f, n), (g, o) in zip(wrenches, medium[0], strict=True)]
        passive = tendon_forces(model, plan, q, v) if plan.tendons else {}
        for force in (actuation.force, springs(plan, parameters, q, moving), passive):
            tau = {k: add(tau.get(k, 0.0), force.get(k, 0.0)) for k in sorted(tau.keys() | force.keys())}
        placed = self._placed(parameters, moving, state.tripped.shape[-1])
        constraints, doubtful = self._constraints(parameters, q, v, moving, placed)
        guess = world_rates(plan, moving, state.acceleration)
        found, capped, zones = constrained_acceleration(
            ConstraintProblem(plan, moving, constraints, bodies, wrenches, tau), guess, state.zones
        )
        tripped = crossed(self.guards, self.meshes, placed, state.tripped | doubtful, self._dtype)
        return Forward(moving, bodies, damping, actuation, medium and medium[1], found, capped, zones, tripped)

    def _placed(self, parameters: Parameters, moving: Sequence[Motion], lanes: int) -> PlacedGeoms:
        """The geoms that may meet others than planes, in the world."""
        poses: list[Pose | None] = []
        for owner in self._owners:
            place = self.plan.place(owner)
            m = moving[place[0]] if place else None
            poses.append((m.rotation, m.position, place[1]) if place and m else None)
        return PlacedGeoms(parameters, poses, lanes, self._dtype)

    def qpos(self, state: LanesState) -> jax.Array:
        """See `Stepper.qpos`."""
        return positions_in_order(self._model, self.plan, state)

    def qvel(self, state: LanesState) -> jax.Array:
        """See `Stepper.qvel`."""
        return dofs_in_order(self._model, self.plan, state.v)

    def qacc(self, state: LanesState) -> jax.Array:
        """Accelerations of the last step before implicit damping (nv, C): MuJoCo's qacc."""
        return dofs_in_order(self._model, self.plan, state.acceleration)

    def act(self, state: LanesState) -> jax.Array:
        """See `Stepper.act`."""
        return activations_in_order(self._model, self.plan, state)

    def power(self, state: LanesState) -> jax.Array:
        """See `Stepper.power`."""
        return state.power

    def capped(self, state: LanesState) -> jax.Array:
        """See `Stepper.capped`."""
        return state.capped

    def tripped(self, state: LanesState) -> jax.Array:
        """See `Stepper.tripped`."""
        return state.tripped
