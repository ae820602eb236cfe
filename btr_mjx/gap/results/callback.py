"""Effects that MJCF cannot express, added to a simulation of the mended model.

A `Callback` adds the terms of mended.json to any simulation, step by step:

    model = mujoco.MjModel.from_xml_path("mended.xml")
    data = mujoco.MjData(model)
    missing = Callback(model, json.loads(Path("mended.json").read_text())["terms"])
    while data.time < 1.0:
        data.ctrl[:] = controller(data.time)
        missing(model, data)  # before every step, after the control was set
        mujoco.mj_step(model, data)
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.effects import KNOWN_EFFECTS, RESIDUAL, Effect, ResidualTable
from btr_mjx.gap.results.mended_model import resolve_effect
from btr_mjx.gap.results.records import FoundEffect
from btr_mjx.gap.simulate import Command, Rows, World
from btr_mjx.models import read_field

_MEMORY = 2.0
"""Time for which a callback keeps past commands [s], much longer than any delay or lag of the library."""


class Callback:
    """Effects that MJCF cannot express, for a simulation of the mended model step by step.

    Call it before every `mujoco.mj_step`, after the control was set: it changes the control, the applied forces and
    fields of the model for the coming step, and reverts its own changes at the next call. As MuJoCo's control callback
    it is called at a later stage of the step, so that friction acts one step late:

        mujoco.set_mjcb_control(lambda model, data: (control(model, data), missing(model, data)))

    A negative delay would need a command that is not known yet; such a command is not changed.
    """

    def __init__(
        self, model: mujoco.MjModel, terms: Sequence[Mapping[str, Any]], effects: Sequence[Effect] = KNOWN_EFFECTS
    ) -> None:
        """A callback for one simulation.

        Args:
          model: the mended model; fields such as dof_frictionloss are written at every call.
          terms: entries of `MendedModel.terms`.
          effects: the library that they refer to.

        Raises:
          InputError: an effect, place or parameter that the library or the model does not have.
        """
        world = World.of(model)
        inherent = len(world.command_edits)  # the model's own delays, which MuJoCo simulates
        for term in terms:
            if term["effect"] == RESIDUAL:
                ResidualTable.from_json(term["table"]).candidate(model).apply(world, ())
                continue
            effect, place, values = resolve_effect(model, FoundEffect.from_result(term), effects)
            effect.apply(world, place, values)
        self._world, world.command_edits = world, world.command_edits[inherent:]
        self._baseline = {name: read_field(model, name) for law in world.laws for name in law.fields}
        self._sent: list[tuple[float, np.ndarray]] = []
        self._force, self._wrench = np.zeros(model.nv), np.zeros((model.nbody, 6))
        self._fresh = True

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Apply the effects to the coming step.

        Args:
          model: the mended model.
          data: the state; `data.ctrl` is the command.
        """
        data.qfrc_applied -= self._force
        data.xfrc_applied -= self._wrench
        for name, values in self._baseline.items():
            getattr(model, name)[...] = values
        if self._world.command_edits:
            data.ctrl[:] = self._command(model, data)
        if self._fresh and self._world.laws and mujoco.get_mjcb_control() is None:
            mujoco.mj_forward(model, data)  # laws may read the actuators' forces
        self._fresh = False
        force, wrench = data.qfrc_applied.copy(), data.xfrc_applied.copy()
        data.xfrc_applied += self._world.wrench
        rows = Rows(
            self._world.model,
            time=np.array([data.time]),
            qpos=data.qpos[None],
            qvel=data.qvel[None],
            act=data.act[None],
            ctrl=data.ctrl[None],
            qfrc_applied=data.qfrc_applied[None],
            xfrc_applied=data.xfrc_applied[None],
            actuator_force=data.actuator_force[None],
            qfrc_actuator=data.qfrc_actuator[None],
            fields={name: getattr(model, name)[None] for name in self._baseline},
        )
        for law in self._world.laws:
            law(rows)
        self._force, self._wrench = data.qfrc_applied - force, data.xfrc_applied - wrench

    def _command(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """The command at the middle of the coming step, after delays and lags of all commands so far."""
        middle = data.time + 0.5 * model.opt.timestep
        if self._sent and middle <= self._sent[-1][0]:  # a simulation that starts again
            self._sent.clear()
        self._sent.append((middle, data.ctrl.copy()))
        while self._sent[0][0] < middle - _MEMORY:
            self._sent.pop(0)
        times, values = zip(*self._sent, strict=True)
        return self._world.command(Command(np.array(times), np.array(values), "linear")).at(middle)
