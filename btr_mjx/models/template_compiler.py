"""Fields of the models of many simulations without compiling each, in about a fiftieth of the compiler's time.

A `TemplateCompiler` is built once per robot and prepares any number of simulations:

    compiler = build_template_compiler(robot, base, varying)   # raises `NotVectorisable`, with the reason
    leaves, done = compiler.prepare(simulations)               # field -> (L, *field shape); which rows are valid

1. The template's numbers are functions of the parameters (`btr_mjx.models.symbolic`).
2. Elements of the model that are copies of such a number are found by tagging (`btr_mjx.models.sources`).
3. Frames, sizes, boxes and inertias of geoms follow the compiler's rules (`btr_mjx.models.compiler_rules`).
4. Fields that MuJoCo derives from these (inverse weights, subtree masses, bounding volumes, ...) are computed by MuJoCo
   itself: `mj_setConst` on threads, by `mujoco.batch.Batch`.

The result is verified: it is compared with models compiled from rendered MJCF at the box's ends, at some of its corners
and at random simulations, in every field; with one difference the robot's models are compiled one by one. A row depends
on its own simulation only, to the bit. "The compiler" below is MuJoCo's.
"""

import copy
from functools import partial
from threading import Lock

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from btr_mjx.models.compiler_rules import SIZES
from btr_mjx.models.fields import PHYSICS, field_names, read_field
from btr_mjx.models.geom_compiler import (
    FRAME_FIELDS,
    INERTIA_FIELDS,
    GeomCompiler,
    NotVectorisable,
    build_geom_compiler,
)
from btr_mjx.models.sources import ElementSources, TaggedModel, sources, tag_models
from btr_mjx.models.statistics import KINEMATICS, model_statistics, unsupported_statistics
from btr_mjx.models.symbolic import Skeleton, Untraceable, trace
from btr_mjx.robots import Robot
from btr_mjx.runs import available_cores

_CHUNK = 256
"""Number of simulations that are prepared at a time, so that their arrays fit into the processor's cache."""

_TOLERANCE = 1e-12
"""Largest allowed difference from the compiler, relative to the largest element of a field."""

_INPUTS = MODEL_FIELDS & set(mujoco.MjModel._setconst_inputs) - {"geom_aabb"}
"""Fields that mj_setConst reads, except the bounding boxes of geoms, which it computes from their sizes."""

_HIERARCHY = ("bvh_child", "bvh_nodeid", "bvh_depth")
"""Tree of bounding volumes. Any tree over the same geoms is valid: all rows have the base model's."""


class TemplateCompiler:
    """Computes fields of models, see the module's docstring. Thread-safe: concurrent calls run one after the other."""

    def __init__(
        self,
        base: mujoco.MjModel,
        varying: tuple[str, ...],
        skeleton: Skeleton,
        copies: dict[str, ElementSources],
        geoms: GeomCompiler,
        derived: tuple[str, ...],
        statistics: bool,
    ) -> None:
        """Make a compiler from its parts; see `build_template_compiler`.

        Args:
          base: model of the nominal simulation.
          varying: names of the fields that `prepare` returns.
          skeleton: the template's numbers.
          copies: field -> sources of its elements, for fields that depend on the template's numbers or on the rules.
          geoms: the compiler's rules.
          derived: fields that mj_setConst computes.
          statistics: whether fields of `MjModel.stat` vary.
        """
        self.base, self.varying, self.skeleton, self.geoms = base, varying, skeleton, geoms
        self._copies = {
            name: (copied, cells.slot[copied], cells.factor[copied, None])
            for name, cells in copies.items()
            for copied in [np.flatnonzero(cells.slot >= 0)]
        }
        # Fields that did not change at any probe are not returned: a row in which one changes is not done.
        self._constant = [name for name in copies if name not in varying and name.startswith(PHYSICS)]
        model = copy.copy(base)
        # Kinematics for the statistics need no contacts; constants do not depend on these flags.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
        # One batch serves all calls: allocating its arrays costs as much as computing their values.
        self._batch, self._lock = Batch(model, nsim=_CHUNK, nthread=available_cores()), Lock()
        self._fields = {name: self._batch.expand(name) for name in (*copies, *derived) if name in MODEL_FIELDS}
        for name in copies.keys() - self._fields.keys():
            value = read_field(base, name)
            self._fields[name] = np.broadcast_to(value, (_CHUNK, *value.shape)).copy()
        self._kinematics = {name: self._batch.bind(name) for name in KINEMATICS} if statistics else {}

    def prepare(self, simulations: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Fields of the models of some simulations.

        Args:
          simulations: (L, n_s) parameters inside the robot's box.

        Returns:
          field -> (L, *field shape) float64, and bool (L,): rows that are done. The values of the other rows are
          undefined, since the compiler rejects them or uses another rule; the caller must compile them.
        """
        count = len(simulations)
        leaves = {name: np.empty((count, *read_field(self.base, name).shape)) for name in self.varying}
        done = np.zeros(count, bool)
        with self._lock:
            for first in range(0, count, _CHUNK):
                part = slice(first, min(first + _CHUNK, count))
                done[part] = self._prepare({name: x[part] for name, x in leaves.items()}, simulations[part])
        return leaves, done

    def _prepare(self, leaves: dict[str, np.ndarray], simulations: np.ndarray) -> np.ndarray:
        """Write one chunk's fields; return which rows are done."""
        count = len(simulations)
        fields = {name: values[:count] for name, values in self._fields.items()}
        slots, failed = self.skeleton.evaluate(simulations)
        for name, (elements, source, factor) in self._copies.items():
            fields[name].reshape(count, -1)[:, elements] = (slots[source] * factor).T
        failed |= self.geoms.write(slots, fields) | self._refused(fields)
        for name in self._constant:
            same = _equal(read_field(self.base, name), fields[name])
            failed |= ~same.reshape(count, -1).all(axis=1)
        if failed.any():  # MuJoCo must be able to process these rows too
            for name in self._copies:
                fields[name][failed] = read_field(self.base, name)
        rows = np.arange(count)
        self._batch.set_const(rows)
        if self._kinematics:
            self._batch.reset(rows, stage=mujoco.mjtStage.mjSTAGE_POS.value)
            own = [
                fields[name] if name in fields else getattr(self.base, name)[None].repeat(count, axis=0)
                for name in ("geom_rbound", "body_mass", "geom_size")
            ]
            kinematics = {name: values[:count] for name, values in self._kinematics.items()}
            fields = model_statistics(self.base, kinematics, *own) | fields
        for name, leaf in leaves.items():
            value = leaf[:0] if name in _HIERARCHY else fields[name]
            if value.shape != leaf.shape:  # a batch holds the bodies' part of bvh_aabb; the meshes' part is constant
                leaf[:] = read_field(self.base, name)
                leaf[: len(value), : value.shape[1]] = value
            else:
                leaf[:] = value
        return ~failed

    def _refused(self, fields: dict[str, np.ndarray]) -> np.ndarray:
        """Rows (L,) whose sizes or inertias the compiler does not accept."""
        count = len(next(iter(fields.values())))
        refused = np.zeros(count, bool)
        if "geom_size" in self._copies:
            counts = [SIZES.get(int(kind), 0) for kind in self.base.geom_type]
            needed = np.arange(3) < np.array(counts)[:, None]
            refused |= ~(fields["geom_size"][:, needed] > 0).all(axis=1)
        if "body_mass" in self._copies:
            refused |= ~(fields["body_mass"] >= 0).all(axis=1)
        if "body_inertia" in self._copies:
            a, b, c = fields["body_inertia"].transpose(2, 0, 1)
            accepted = (a >= 0) & (b >= 0) & (c >= 0) & (a + b >= c) & (a + c >= b) & (b + c >= a)
            refused |= ~accepted.all(axis=1)
        return refused


def build_template_compiler(robot: Robot, base: mujoco.MjModel, varying: tuple[str, ...]) -> TemplateCompiler:
    """Make the compiler of a robot's template and verify it against MuJoCo's.

    Args:
      robot: the robot.
      base: model of its nominal simulation.
      varying: fields that depend on the simulation.

    Returns:
      The compiler.

    Raises:
      NotVectorisable: the models have to be compiled one by one.
    """
    try:
        skeleton = trace(robot)
        tagged = tag_models(robot, skeleton)
    except (Untraceable, ValueError) as error:
        raise NotVectorisable(str(error)) from None
    names = field_names(base)
    for t in tagged:
        if any(read_field(t.model, name).shape != read_field(base, name).shape for name in names):
            raise NotVectorisable("the structure of the model depends on the parameters")
    cells = {name: sources(tagged, partial(_field, name)) for name in names}
    compiler = _assemble(base, varying, skeleton, tagged, cells)
    verify(compiler, robot)
    return compiler


def _field(name: str, tagging: TaggedModel) -> np.ndarray:
    return read_field(tagging.model, name)


def _assemble(
    base: mujoco.MjModel,
    varying: tuple[str, ...],
    skeleton: Skeleton,
    tagged: list[TaggedModel],
    cells: dict[str, ElementSources],
) -> TemplateCompiler:
    for name, found in cells.items():
        if name in _HIERARCHY:
            continue
        changed = found.responding | (found.constant != read_field(base, name).ravel())
        if changed.any() and read_field(base, name).dtype.kind != "f":
            raise NotVectorisable(f"{name} depends on the parameters")
        if name in varying and not found.responding.any():
            raise NotVectorisable(f"{name} depends on the parameters in a way that leaves no trace")
    geoms = build_geom_compiler(tagged, cells)
    ruled = (*FRAME_FIELDS, *INERTIA_FIELDS) if geoms.groups else ()
    copies = {name: c for name, c in cells.items() if name in ruled or (c.responding.any() and not c.computed.any())}
    rest = [name for name in varying if name not in copies and name not in _HIERARCHY]
    derived = tuple(name for name in rest if name in MODEL_FIELDS - _INPUTS)
    own = [name for name in rest if name.startswith("stat.")]
    for name in cells:
        known = name in copies or name not in rest or name in derived or name in own
        if not known or (name in _INPUTS and name not in copies and cells[name].responding.any()):
            raise NotVectorisable(f"{name} is computed by a rule that is not known here")
    if own and unsupported_statistics(base):
        raise NotVectorisable(f"statistics of a model with {unsupported_statistics(base)}")
    return TemplateCompiler(base, varying, skeleton, copies, geoms, derived, bool(own))


def verify(compiler: TemplateCompiler, robot: Robot) -> None:
    """Compare with models compiled by MuJoCo at simulations across the box.

    Raises:
      NotVectorisable: a field differs by more than rounding.
    """
    box, rng = robot.simulation_box, np.random.default_rng(2)
    corners = np.where(rng.random((5, box.n)) < 0.5, box.low, box.high)
    probes = np.stack([box.low, box.high, robot.nominal_simulation, *corners, *box.sample(rng, 6)])
    leaves, done = compiler.prepare(probes)
    names = [name for name in field_names(compiler.base) if name in leaves or name.startswith(PHYSICS)]
    slots, _ = compiler.skeleton.evaluate(probes)
    if not done.any():
        raise NotVectorisable("the compiler follows rules that are not known here")
    for i in np.flatnonzero(done):
        text = robot.render(probes[i])
        if not compiler.skeleton.matches(text, slots[:, i].tolist()):
            raise NotVectorisable("the template's text depends on the parameters by more than numbers")
        try:
            model = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise NotVectorisable(f"a model that the compiler refuses: {error}") from None
        rebuilt = any(not np.array_equal(getattr(model, n), getattr(compiler.base, n)) for n in _HIERARCHY)
        for name in names:
            if rebuilt and name.startswith("bvh_"):
                continue
            found = leaves[name][i] if name in leaves else read_field(compiler.base, name)
            expected = read_field(model, name)
            if expected.shape != found.shape or not np.all(_equal(expected, found)):
                raise NotVectorisable(f"{name} is not what the compiler makes of it")


def _equal(expected: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Which elements are equal, up to rounding where they are floats."""
    if expected.dtype.kind == "f":
        return np.abs(found - expected) <= _TOLERANCE * np.abs(expected).max(initial=0.0)
    return found == expected
