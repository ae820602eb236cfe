"""Rollouts of any MuJoCo model from many states, as `mujoco.rollout`: by lanes where it can, else by native MuJoCo.

Worlds in which a contact may take part that lanes does not compute are found by guards and evaluated by native MuJoCo
instead, so that every answer is MuJoCo's to the tolerance of the engine's precision.
"""

import copy
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from btr_mjx.engines import (
    UnsupportedModel,
    base_field,
    expand,
    possible_contacts,
    require_same_structure,
    require_supported,
)
from btr_mjx.errors import InputError
from btr_mjx.lanes.coverage import as_model
from btr_mjx.models import write_field
from btr_mjx.runs import available_cores, content_digest

if TYPE_CHECKING:
    from btr_mjx.engines import ControlledProgram

_LOG = logging.getLogger(__name__)

_MAX_TRIPPED = 0.25
"""Part of the first worlds that guards may hand to native MuJoCo before it evaluates everything."""

_SAMPLE = 8
"""Worlds that native MuJoCo tries first, where contacts are guarded."""

_SEGMENT = 100
"""Steps of one call of the compiled program."""

_CAPACITY = 16
"""Chunks per device and block, on CPUs; on GPUs, whose chunks are larger, one."""

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_PARTS = {
    "time": mujoco.mjtState.mjSTATE_TIME,
    "qpos": mujoco.mjtState.mjSTATE_QPOS,
    "qvel": mujoco.mjtState.mjSTATE_QVEL,
    "act": mujoco.mjtState.mjSTATE_ACT,
    "history": mujoco.mjtState.mjSTATE_HISTORY,
    "plugin_state": mujoco.mjtState.mjSTATE_PLUGIN,
}
"""Parts of mjSTATE_FULLPHYSICS, in order."""


@dataclass(frozen=True, eq=False)
class LanesRollout:
    """Result of `rollout` for B worlds and T steps.

    Attributes:
      state: (B, T, n) states after each step, mjSTATE_FULLPHYSICS as `mujoco.rollout` returns them.
      engine: (B,) the engine that computed each world, "lanes" or "native".
      note: why native MuJoCo computed everything; empty if it did not.
    """

    state: np.ndarray
    engine: np.ndarray
    note: str

    @property
    def native_share(self) -> float:
        """Part of the worlds that native MuJoCo computed."""
        return float(np.mean(self.engine == "native"))


def rollout(
    model: mujoco.MjModel | str | Path,
    initial_states: ArrayLike,
    controls: ArrayLike | None = None,
    *,
    steps: int | None = None,
    varying: Mapping[str, ArrayLike] | None = None,
    chunk: int | None = None,
) -> LanesRollout:
    """Simulate a model from many states under given controls.

    Args:
      model: an MjModel, the path of an MJCF file or MJCF text.
      initial_states: (B, n) or (1, n) states, mjSTATE_FULLPHYSICS: time, qpos, qvel, act, ...
      controls: (B, T, nu), each of B and T may be 1; None for zeros.
      steps: number T of steps; None for that of the controls.
      varying: MjModel field -> (B, *field shape), fields in which the worlds differ ("opt.gravity" for options).
        Constants that MuJoCo derives from them (such as body_invweight0) follow, unless they are given as well.
      chunk: worlds that lanes steps together, by default 64, and 16,384 on a GPU; results are bit-identical for a
        fixed chunk size only.

    Returns:
      The states after every step. Worlds of lanes have JAX's default precision, those of native double precision.
      Where lanes refuses the model, or its guards hand more than a quarter of the first chunks to native MuJoCo, that
      computes all worlds; `LanesRollout.note` and a warning of the log say why.

    Raises:
      InputError: MuJoCo cannot read the model, or a shape is wrong.
    """
    m = as_model(model)
    start, control, leaves = _checked(m, initial_states, controls, steps, varying or {})
    count = len(start)
    note, program = "", None
    if mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_HISTORY):
        note = "states with history buffers (delays)"
    else:
        try:
            leaves = _with_constants(m, count, leaves)
            require_same_structure(m, leaves)
            few = np.unique(np.linspace(0, count - 1, _SAMPLE).astype(int))
            sample = _Sample(start[few], control[few], {name: x[few] for name, x in leaves.items()})
            program = _program(_Structure(content_digest(m), tuple(sorted(leaves)), m, sample), chunk)
        except UnsupportedModel as error:
            note = str(error).split(";")[0]
    if program is None:
        return _all_native(m, start, control, leaves, note)
    parts, size = _split(m, start), program.layout.pairs
    state, engine = np.zeros((count, control.shape[1], start.shape[1])), np.full(count, "lanes", dtype="U6")
    state[:, :, :1] = parts["time"][:, None] + m.opt.timestep * np.arange(1, control.shape[1] + 1)[:, None]
    # A chunk for each device comes first: what it takes is lost where its guards trip.
    trial = program.layout.devices * program.layout.chunk
    for first, last in pairwise([0, *range(trial, count, size), count]):
        rows = slice(first, last)
        marked = program(
            {name: x[rows] for name, x in leaves.items()},
            (parts["qpos"][rows], parts["qvel"][rows], parts["act"][rows]),
            control[rows],
            state[rows, :, 1:],
        )
        tripped = first + np.flatnonzero(marked)
        if not first and len(tripped) > _MAX_TRIPPED * len(marked):
            text = (
                f"guards found possible contacts that lanes does not compute in {len(tripped)} of {len(marked)} worlds"
            )
            return _all_native(m, start, control, leaves, text)
        if len(tripped):
            some = {name: x[tripped] for name, x in leaves.items()}
            state[tripped] = _native(m, start[tripped], control[tripped], some)
            engine[tripped] = "native"
    return LanesRollout(state, engine, "")


def _touching_at_once(m: mujoco.MjModel, sample: "_Sample") -> str:
    """Why guards would hand over most worlds, from native rollouts of a few; empty if they need not.

    Compiling takes longer than this, and would be in vain.
    """
    guarded = np.zeros((m.ngeom, m.ngeom), bool)
    for own in possible_contacts(m).guarded:
        guarded[own.pair.first, own.pair.second] = guarded[own.pair.second, own.pair.first] = True
    touching, count = 0, len(sample.start)
    for row in range(count) if guarded.any() else ():
        fields = {name: values[row] for name, values in sample.leaves.items()}
        model = _with_fields(m, fields) if fields else m
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, sample.start[row], _FULL)
        for control_row in sample.control[row]:
            data.ctrl[:] = control_row
            mujoco.mj_step(model, data)
            if guarded[tuple(data.contact.geom.T)].any():
                touching += 1
                break
    if touching <= _MAX_TRIPPED * count:
        return ""
    return f"bodies whose contact lanes does not compute touch in {touching} of {count} worlds that were tried"


def _with_fields(m: mujoco.MjModel, fields: Mapping[str, np.ndarray]) -> mujoco.MjModel:
    """A copy of the model with other values of some fields."""
    model = copy.copy(m)
    for name, value in fields.items():
        write_field(model, name, value)
    return model


def _checked(
    m: mujoco.MjModel,
    initial_states: ArrayLike,
    controls: ArrayLike | None,
    steps: int | None,
    varying: Mapping[str, ArrayLike],
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """States (B, n), controls (B, T, nu) and fields (B, ...), all of full size."""
    start, size = np.atleast_2d(np.asarray(initial_states, np.float64)), mujoco.mj_stateSize(m, _FULL)
    control = np.zeros((1, steps or 0, m.nu)) if controls is None else np.asarray(controls, np.float64)
    if start.ndim != 2 or start.shape[1] != size:
        raise InputError(f"initial_states: got {start.shape}, expected (B, {size}): mjSTATE_FULLPHYSICS of the model")
    if control.ndim != 3 or control.shape[2] != m.nu:
        raise InputError(f"controls: got {control.shape}, expected (B, T, {m.nu}), one column for each control")
    if control.shape[1] == 1 and steps:
        control = np.repeat(control, steps, axis=1)
    if not control.shape[1] or (steps and control.shape[1] != steps):
        raise InputError(f"steps: got {steps} and controls of {control.shape[1]} steps, expected a number above 0")
    leaves = {name: np.asarray(value, np.float64) for name, value in varying.items()}
    sizes = {"initial_states": len(start), "controls": len(control), **{name: len(x) for name, x in leaves.items()}}
    count = max(sizes.values())
    wrong = {name: n for name, n in sizes.items() if n not in (1, count)}
    if wrong:
        raise InputError(f"{', '.join(wrong)}: got {', '.join(map(str, wrong.values()))} rows, expected 1 or {count}")
    for name, value in leaves.items():
        owner, word = (m.opt, name[4:]) if name.startswith("opt.") else (m, name)
        if not hasattr(owner, word):
            raise InputError(f"varying: got {name!r}, expected a field of MjModel, or of its options as 'opt.<name>'")
        if value.shape[1:] != (shape := base_field(m, name).shape):
            raise InputError(
                f"varying: got {name!r} of shape {value.shape}, expected (B, {', '.join(map(str, shape))})"
            )
    full = lambda x: np.broadcast_to(x, (count, *x.shape[1:]))  # noqa: E731
    return full(start), full(control), {name: full(value) for name, value in leaves.items()}


def _split(m: mujoco.MjModel, state: np.ndarray) -> dict[str, np.ndarray]:
    """Parts of mjSTATE_FULLPHYSICS (B, n)."""
    sizes = [mujoco.mj_stateSize(m, part) for part in _PARTS.values()]
    return dict(zip(_PARTS, np.split(state, np.cumsum(sizes)[:-1], axis=1), strict=True))


def _all_native(
    m: mujoco.MjModel, start: np.ndarray, control: np.ndarray, leaves: Mapping[str, np.ndarray], note: str
) -> LanesRollout:
    _LOG.warning("native MuJoCo computes all worlds: %s", note)
    return LanesRollout(_native(m, start, control, leaves), np.full(len(start), "native"), note)


def _native(m: mujoco.MjModel, start: np.ndarray, control: np.ndarray, leaves: Mapping[str, np.ndarray]) -> np.ndarray:
    """States (B, T, n) by native MuJoCo, on all cores."""
    batch = _batch(m, len(start), leaves)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    for name, values in _split(m, start).items():
        if values.shape[1]:
            bound = batch.bind(name)
            bound[...] = values.reshape(bound.shape)
    return batch.rollout(control.shape[1], control, record=(_FULL,))[_FULL]


def _batch(m: mujoco.MjModel, count: int, leaves: Mapping[str, np.ndarray]) -> Batch:
    """Simulations whose models have the given fields, and the constants that follow from them."""
    batch = Batch(m, nsim=count, nthread=available_cores())
    expand(batch, leaves)
    if leaves:
        batch.set_const()
        expand(batch, leaves)
    return batch


def _with_constants(m: mujoco.MjModel, count: int, leaves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The fields in which worlds differ, with the constants that MuJoCo derives from them."""
    if not leaves:
        return leaves
    batch = _batch(m, count, leaves)
    names = [
        "body_invweight0",
        "body_subtreemass",
        "dof_invweight0",
        *(("tendon_invweight0", "tendon_length0") if m.ntendon else ()),
    ]
    names += ["eq_data"] if np.any(m.eq_type == mujoco.mjtEq.mjEQ_CONNECT) else []  # a joined body's anchor
    return {name: np.array(batch.expand(name)) for name in names} | leaves


@dataclass(frozen=True, eq=False)
class _Sample:
    """States (n, size), controls (n, T, nu) and varying fields (n, ...) of a few worlds."""

    start: np.ndarray
    control: np.ndarray
    leaves: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class _Structure:
    """What a program is made of, as a key of caches: the bytes of a model, and the fields in which worlds differ."""

    digest: str
    varying: tuple[str, ...]
    model: mujoco.MjModel = field(compare=False)
    sample: _Sample = field(compare=False)


def _program(structure: _Structure, chunk: int | None) -> "ControlledProgram":
    """The compiled program of a model.

    Raises:
      UnsupportedModel: lanes does not compute it, or hardly any of its worlds.
    """
    _admitted(structure)
    from btr_mjx.engines import uses_doubles  # loads JAX, which takes seconds and bad input should not

    return _compiled(structure, chunk, uses_doubles())


@lru_cache(maxsize=16)
def _admitted(structure: _Structure) -> mujoco.MjModel:
    """A copy of a model that is worth compiling: the caller may change the model later; what is traced must not."""
    require_supported(structure.model, guards=True)
    if note := _touching_at_once(structure.model, structure.sample):
        raise UnsupportedModel(note)
    return copy.copy(structure.model)


@lru_cache(maxsize=16)
def _compiled(structure: _Structure, chunk: int | None, x64: bool) -> "ControlledProgram":
    import jax

    from btr_mjx.engines import (
        ControlledProgram,
        LanesStepper,
        Layout,
        default_chunk,
        use_all_cores,
        use_compilation_cache,
    )

    use_all_cores()
    use_compilation_cache()
    devices = jax.devices()
    stepper = LanesStepper(_admitted(structure), structure.varying, guards=True)
    capacity = _CAPACITY if devices[0].platform == "cpu" else 1
    layout = Layout(len(devices), capacity, chunk or default_chunk(devices[0]))
    return ControlledProgram(stepper, layout, devices, _SEGMENT)
