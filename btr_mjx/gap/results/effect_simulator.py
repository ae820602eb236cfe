"""Effects as part of a robot: edits of its model where that is all they do, and a simulator for the others.

An effect that only changes numbers of the model is an `EffectEdit`, and every engine simulates it. Delays, lags and
rate limits of commands, forces that depend on the state and constant forces have no numbers in a model;
`EffectSimulator` adds them to every simulation in the way of the search that found them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import Effect, Place
from btr_mjx.gap.results.mended_model import applied_alone, resolve_effect
from btr_mjx.gap.results.records import FoundEffect
from btr_mjx.gap.simulate import Command, Segments, World, differing_fields, simulate
from btr_mjx.models import start_of, write_field
from btr_mjx.robots import Edit, Pairs, Robot, Simulator


@dataclass(frozen=True)
class EffectEdit:
    """An effect at a place as an edit of a model, see `robots.Edit`.

    Attributes:
      effect: of the library.
      place: in the model.
      parameters: names of the parameters of S that are its numbers.
    """

    effect: Effect
    place: Place
    parameters: tuple[str, ...]

    def __call__(self, model: mujoco.MjModel, values: Sequence[float]) -> None:
        """Change the numbers of a model that the effect changes."""
        world = World.of(model)
        self.effect.apply(world, self.place, np.array(values))
        write_world(model, world)


def write_world(model: mujoco.MjModel, world: World) -> None:
    """Give a model the numbers in which the model of a world differs from it."""
    for name, value in differing_fields(world, model).items():
        if name != "actuator_delay":  # of a world it is an edit of the command
            write_field(model, name, value)


@dataclass(frozen=True)
class EffectSimulator:
    """Simulates effects that are more than changed numbers of a model, in native MuJoCo; see `robots.Simulator`.

    Attributes:
      effects: with the names of their parameters.
    """

    effects: tuple[EffectEdit, ...]

    def __call__(self, robot: Robot, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """See `robots.Simulator`. The signal is held over every step, as in the engines."""
        times, timestep, nq = pairs.times, pairs.timestep, pairs.models[0].nq
        at = np.arange(round(float(times[-1]) / timestep)) * timestep
        distinct, which = np.unique(pairs.controllers, axis=0, return_inverse=True)
        columns = np.ascontiguousarray(distinct.T)
        control = np.stack([robot.signal(columns, t, np) for t in at])  # (steps, nu, controllers)
        commands = tuple(Command(at, control[:, :, i], "hold") for i in range(len(distinct)))
        start, jobs, rows = start_of(robot), [], []
        for i, model in enumerate(pairs.models):
            own = np.flatnonzero(pairs.index == i)
            world = World.of(model)
            for effect in self.effects:
                values = [pairs.simulations[i, robot.simulation_box.index(name)] for name in effect.parameters]
                effect.effect.apply(world, effect.place, np.array(values))
            qpos, qvel, act = start or (model.qpos0, np.zeros(model.nv), np.zeros(model.na))
            qpos, qvel, act = (np.tile(values, (len(own), 1)) for values in (qpos, qvel, act))
            jobs.append((world, Segments(np.zeros(len(own)), qpos, qvel, times, commands, which[own], act)))
            rows.append(own)
        found = np.empty((len(pairs.index), len(times), nq + pairs.models[0].nv))
        for own, states in zip(rows, simulate(jobs, timestep=timestep), strict=True):
            found[own] = states
        return found[..., :nq], found[..., nq:]


def added_effects(
    model: mujoco.MjModel,
    found: Sequence[FoundEffect],
    parameters: Sequence[tuple[str, ...]],
    effects: Sequence[Effect],
    simulator: Simulator | None = None,
) -> tuple[tuple[Edit, ...], Simulator | None]:
    """Effects as parts of a robot.

    Args:
      model: the robot's model, in which places are looked up.
      found: the effects, with values at which they are present.
      parameters: per effect the names of the parameters of S that are its numbers.
      effects: the library that `found` refers to.
      simulator: the robot's own so far.

    Returns:
      Edits of the model, and the simulator with the effects that are not edits; None for the engines.

    Raises:
      InputError: effects that are not edits for a robot with another simulator; an effect, place or parameter that
        the library or the model does not have.
    """
    edits, others = list[Edit](), list[EffectEdit]()
    for item, names in zip(found, parameters, strict=True):
        effect, place, values = resolve_effect(model, item, effects)
        _, is_edit = applied_alone(effect, model, place, values)
        (edits if is_edit else others).append(EffectEdit(effect, place, names))
    if not others:
        return tuple(edits), simulator
    if simulator is not None and not isinstance(simulator, EffectSimulator):
        raise InputError(f"{others[0].effect.name}: cannot be added to {type(simulator).__name__}")
    known = () if simulator is None else simulator.effects
    return tuple(edits), EffectSimulator((*known, *others))
