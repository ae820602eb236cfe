"""One way the robot could be: what an effect edits."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from btr_mjx.gap.simulate.commands import Command
from btr_mjx.gap.simulate.laws import Law

CommandEdit = Callable[[Command], Command]


@dataclass
class World:
    """One way the robot could be. Effects edit it in place, one after another.

    Attributes:
      model: a private copy. Constants that MuJoCo derives from it follow by themselves when it is simulated.
      command_edits: applied to the command of every recording, in order.
      laws: the state-dependent part, called in order before every step.
      offset: (nv,) what the encoders add to the true configuration, in the tangent space.
      wrench: (nbody, 6) constant force [N] and torque [N m] on bodies, at their centre of mass in the world frame.
      kept: it is not edited any more, so that derived constants are brought up to date once only.
    """

    model: mujoco.MjModel
    command_edits: list[CommandEdit]
    laws: list[Law]
    offset: np.ndarray
    wrench: np.ndarray
    kept: bool = False
    _settled: bool = field(default=False, init=False, repr=False, compare=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "World":
        """The world that a model describes; native delays of actuators become an edit of the command."""
        model = copy.copy(model)
        edits: list[CommandEdit] = []
        if model.actuator_delay.any():
            delay = np.zeros(model.nu)
            for actuator, first in enumerate(model.actuator_ctrladr):
                delay[first : first + model.actuator_ctrlnum[actuator]] = model.actuator_delay[actuator]
            model.actuator_delay[:] = 0
            edits.append(lambda command: command.shifted(delay))
        return cls(model, edits, [], np.zeros(model.nv), np.zeros((model.nbody, 6)))

    def command(self, command: Command) -> Command:
        """What arrives at the actuators when `command` is sent."""
        for edit in self.command_edits:
            command = edit(command)
        return command

    def settle(self, data: mujoco.MjData | None = None) -> mujoco.MjModel:
        """Bring the constants that MuJoCo derives up to date; returns the model.

        Args:
          data: of a model of the same structure, for whoever settles many: to make one takes longer than all the rest.
            It is overwritten.
        """
        with self._lock:
            if not (self.kept and self._settled):
                mujoco.mj_setConst(self.model, mujoco.MjData(self.model) if data is None else data)
                self._settled = True
        return self.model


Fingerprint = Mapping[str, object]
"""The fields of a model that are compared, as bytes or numbers."""


def fields_of(
    world: World, base: mujoco.MjModel, known: Fingerprint | None = None, data: mujoco.MjData | None = None
) -> dict[str, np.ndarray]:
    """The fields of a world's model that differ from a base model, derived constants included.

    Args:
      world: whose model is compared; it is settled where it differs.
      base: a model of the same structure.
      known: `fingerprint(base)`, for whoever compares many worlds with one base.
      data: of the base, for the same, see `World.settle`.
    """
    known = fingerprint(base) if known is None else known
    changed = _differing(world.model, known)
    if changed:
        changed = _differing(world.settle(data), known)
    return changed


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
"""Fields in which two worlds of one structure may differ in a way that matters to motion."""


def fingerprint(model: mujoco.MjModel) -> Fingerprint:
    """What `fields_of` compares: what a model has none of cannot differ."""
    fields = ((name, _field(model, name)) for name in _COMPARED)
    return {name: _comparable(value) for name, value in fields if np.size(value)}


def _field(model: mujoco.MjModel, name: str) -> Any:
    return getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)


def _comparable(value: Any) -> object:
    # Bytes, because this is done for hundreds of worlds and array_equal takes ten times as long.
    return value.tobytes() if isinstance(value, np.ndarray) else value


def _differing(model: mujoco.MjModel, known: Fingerprint) -> dict[str, np.ndarray]:
    changed = {}
    for name, theirs in known.items():
        ours = _field(model, name)
        if _comparable(ours) != theirs:
            changed[name] = np.array(ours)
    return changed
