"""Worlds: a model, command edits, laws, encoder offsets and constant forces, edited by effects."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from threading import Lock

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from btr_mjx.gap.simulate.commands import Command
from btr_mjx.gap.simulate.laws import Law
from btr_mjx.models import read_field

CommandEdit = Callable[[Command], Command]


@dataclass
class World:
    """A hypothesis about the robot. Effects edit it in place, one after another.

    Attributes:
      model: a private copy. Constants derived by MuJoCo are updated before a simulation.
      command_edits: applied to the command of every recording, in order.
      laws: state-dependent changes, called in order before every step.
      offset: (nv,) encoder offset, added to the true configuration in the tangent space.
      wrench: (nbody, 6) constant force [N] and torque [N m] on bodies, at their centre of mass in the world frame.
      report: (actuators,) forces that drives report, in units of those that they have.
      frozen: the world is not edited any more, so that derived constants are computed once only.
    """

    model: mujoco.MjModel
    command_edits: list[CommandEdit]
    laws: list[Law]
    offset: np.ndarray
    wrench: np.ndarray
    report: np.ndarray
    frozen: bool = False
    _constants_current: bool = field(default=False, init=False, repr=False, compare=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "World":
        """The world of a model; native actuator delays are converted to a command edit."""
        model = copy.copy(model)
        edits: list[CommandEdit] = []
        if model.actuator_delay.any():
            delay = np.zeros(model.nu)
            for actuator, first in enumerate(model.actuator_ctrladr):
                delay[first : first + model.actuator_ctrlnum[actuator]] = model.actuator_delay[actuator]
            model.actuator_delay[:] = 0
            edits.append(partial(Command.shifted, delay=delay))
        return cls(
            model, edits, [], np.zeros(model.nv), np.zeros((model.nbody, 6)), np.ones(len(model.actuator_trntype))
        )

    def copy(self) -> "World":
        """Another world like this one, to be edited."""
        edits, laws = list(self.command_edits), list(self.laws)
        return World(copy.copy(self.model), edits, laws, self.offset.copy(), self.wrench.copy(), self.report.copy())

    def command(self, command: Command) -> Command:
        """The command that reaches the actuators."""
        for edit in self.command_edits:
            command = edit(command)
        return command

    def update_constants(self, data: mujoco.MjData | None = None) -> mujoco.MjModel:
        """The model, with the constants that MuJoCo derives from it (`mj_setConst`) brought up to date.

        `data` of a model of the same structure is overwritten, which saves its allocation.
        """
        with self._lock:
            if not (self.frozen and self._constants_current):
                mujoco.mj_setConst(self.model, mujoco.MjData(self.model) if data is None else data)
                self._constants_current = True
        return self.model


Fingerprint = Mapping[str, bytes]
"""Values of the compared fields of a model."""


def differing_fields(
    world: World, base: mujoco.MjModel, known: Fingerprint | None = None, data: mujoco.MjData | None = None
) -> dict[str, np.ndarray]:
    """The fields of the model of a world that differ from a base model, derived constants included.

    Args:
      world: the world; its derived constants are updated if a field differs.
      base: a model of the same structure.
      known: `fingerprint(base)`, if already computed.
      data: scratch data of the base, see `World.update_constants`.

    Returns:
      Values of the world's model by field name.
    """
    known = fingerprint(base) if known is None else known
    changed = _differing(world.model, known)
    return _differing(world.update_constants(data), known) if changed else {}


_COMPARED = tuple(
    sorted(
        name
        for name in MODEL_FIELDS
        if name.startswith(("body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "tendon_", "ten_", "eq_", "opt."))
        or name in ("qpos0", "qpos_spring", "pair_friction", "pair_solref", "pair_solimp", "pair_margin", "pair_gap")
        if not name.endswith(("_user", "_rgba", "_group", "_matid", "adr", "num", "id"))
        if name not in ("opt.timestep", "opt.integrator", "opt.disableflags", "opt.enableflags")
    )
)
"""Fields that affect the motion and may differ between worlds of one structure."""


def fingerprint(model: mujoco.MjModel) -> Fingerprint:
    """The nonempty fields of a model that `differing_fields` compares."""
    return {name: content for name in _COMPARED if (content := read_field(model, name).tobytes())}


def _differing(model: mujoco.MjModel, known: Fingerprint) -> dict[str, np.ndarray]:
    # Comparing bytes is faster than np.array_equal.
    fields = ((name, read_field(model, name)) for name in known)
    return {name: value for name, value in fields if value.tobytes() != known[name]}
