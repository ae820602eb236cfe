"""Hypotheses: values of what may be refitted and effects that are added, and the worlds they make."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Candidate
from btr_mjx.gap.simulate import World
from btr_mjx.models import PathParameter


@dataclass(frozen=True)
class Hypothesis:
    """What the robot could be.

    Attributes:
      parameters: what may be refitted.
      believed: (P,) their values.
      effects: candidates with their values.
    """

    parameters: tuple[PathParameter, ...]
    believed: tuple[float, ...]
    effects: tuple[tuple[Candidate, tuple[float, ...]], ...] = ()
    _worlds: dict[int, tuple[mujoco.MjModel, World]] = field(
        default_factory=dict, init=False, repr=False, compare=False, hash=False
    )
    _shorter: "Hypothesis | None" = field(default=None, repr=False, compare=False, hash=False)

    def __call__(self, model: mujoco.MjModel) -> World:
        """The world of a recording whose believed model is `model`, made once: it must not be edited."""
        if id(model) not in self._worlds:
            self._worlds[id(model)] = model, self._world(model)
        return self._worlds[id(model)][1]

    def _world(self, model: mujoco.MjModel) -> World:
        world, left = self._begun(model)
        for candidate, values in left:
            candidate.apply(world, np.array(values))
        world.frozen = True
        world.update_constants()  # at once: the same world is the same to a journal, simulated before or not
        return world

    def _begun(self, model: mujoco.MjModel) -> tuple[World, Sequence[tuple[Candidate, tuple[float, ...]]]]:
        """A world to be edited, and the effects that it lacks: the last one, where what is shorter has a world."""
        own = self.parameters, self.believed, self.effects[:-1]
        match self._shorter:
            case Hypothesis() as it if (it.parameters, it.believed, it.effects) == own and id(model) in it._worlds:
                return it(model).copy(), self.effects[-1:]
        world = World.of(model)
        for parameter, value in zip(self.parameters, self.believed, strict=True):
            parameter.write(world.model, value)
        if self.parameters:
            mujoco.mj_setConst(world.model, mujoco.MjData(world.model))
        return world, self.effects

    def with_effect(self, candidate: Candidate, values: Sequence[float] | np.ndarray) -> "Hypothesis":
        """The same with one more effect; its worlds begin as copies of those of this one that were made before."""
        added = (candidate, tuple(float(value) for value in values))
        return replace(self, effects=(*self.effects, added), _shorter=self)

    @property
    def numbers(self) -> int:
        """How many numbers its effects have."""
        return sum(len(values) for _, values in self.effects)

    @property
    def name(self) -> str:
        """Its effects' names."""
        return " + ".join(candidate.name for candidate, _ in self.effects) or "nothing"

    def values(self, with_believed: bool) -> np.ndarray:
        """Its free numbers: believed ones if wanted, then those of its effects."""
        own = [value for _, values in self.effects for value in values]
        return np.array([*(self.believed if with_believed else ()), *own], float)

    def replaced(self, values: np.ndarray, with_believed: bool) -> "Hypothesis":
        """The same with other free numbers, in the order of `values`."""
        numbers = [float(value) for value in values]
        believed = tuple(numbers[: len(self.believed)]) if with_believed else self.believed
        rest = numbers[len(self.believed) :] if with_believed else numbers
        effects, first = [], 0
        for candidate, own in self.effects:
            effects.append((candidate, tuple(rest[first : first + len(own)])))
            first += len(own)
        return Hypothesis(self.parameters, believed, tuple(effects))


def believed_steps(parameters: Sequence[PathParameter], values: Sequence[float]) -> np.ndarray:
    """Finite-difference steps of what may be refitted (P,)."""
    steps = []
    for parameter, value in zip(parameters, values, strict=True):
        size = min(
            0.02 * max(abs(value), 1e-3 * (parameter.high - parameter.low)), 0.1 * (parameter.high - parameter.low)
        )
        steps.append(size if value + size <= parameter.high else -size)
    return np.array(steps)
