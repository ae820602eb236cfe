"""What an effect is: a name, where it may sit, its parameters there, and how it edits a world."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.places import Place
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import World


@dataclass(frozen=True)
class Parameter:
    """One number of an effect at a place.

    Attributes:
      name: what it is.
      unit: SI, "1" for a pure number.
      low: smallest value that is tried.
      high: largest value that is tried.
      step: signed difference from `null` that is large enough to be seen and small enough to be linear.
      tolerance: standard deviation of what a calibration always leaves; 0 for none.
      null: value at which the effect is absent; sizes and errors are measured from there.
      shape: the parameter only matters while the first one differs from its null (where a mass sits, the speed at
        which friction falls); `null` is then where its search starts.
      least: difference from `null` that a first number needs to be called by name, however sure it is.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float
    tolerance: float = 0.0
    null: float = 0.0
    shape: bool = False
    least: float = 0.0

    def __post_init__(self) -> None:
        if not (self.low <= self.null <= self.high and self.step != 0):
            raise InputError(
                f"parameter {self.name!r}: got low {self.low}, null {self.null}, high {self.high}, step {self.step}; "
                "expected low <= null <= high and a step other than 0"
            )

    def at_edge(self, value: float) -> bool:
        """Whether a value is the end of what is tried though more of the effect is possible.

        Less than none of something that is believed to be there is not: where the range below the null is the shorter
        one, it ends where nothing is left.
        """
        room = 1e-3 * (self.high - self.low)
        above, below = self.high - self.null, self.null - self.low
        high = above > 0 and value > self.high - room
        low = below > 0 and below >= above and value < self.low + room
        return not self.shape and (high or low)


Places = Callable[[mujoco.MjModel], list[Place]]
_MakeParameters = Callable[[mujoco.MjModel, Scales, Place], tuple[Parameter, ...]]
Apply = Callable[[World, Place, np.ndarray], None]
Native = Callable[[mujoco.MjSpec, mujoco.MjModel, Place, np.ndarray], bool]


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model may lack.

    Attributes:
      name: in results.
      places: where it may sit in a model; empty where it makes no sense.
      parameters: its parameters at a place, with ranges that suit the model and the data.
      apply: edits a world in place. What it writes into the model's fields is also its native form.
      excited_by: the motion that shows it.
      summable: whether the signature of a group of places is the sum of its members'.
      native: writes the part of it that `apply` does not write into the model's fields (an edit of the command, a
        law, a wrench) into an MjSpec, and returns whether MuJoCo has a term for it.
      equation: the effect in one line, for reports.
      akin: effects that are easily taken for this one, see `twins`.
    """

    name: str
    places: Places
    parameters: _MakeParameters
    apply: Apply
    excited_by: str = ""
    summable: bool = False
    native: Native | None = None
    equation: str = ""
    akin: tuple["Effect", ...] = ()


@dataclass(frozen=True)
class Candidate:
    """An effect at one place.

    Attributes:
      effect: the effect.
      place: where it sits.
      parameters: its parameters there.
    """

    effect: Effect
    place: Place
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Effect and place, for tables."""
        return f"{self.effect.name}@{self.place.label}"

    @property
    def null(self) -> np.ndarray:
        """(p,) values at which it is absent."""
        return np.array([parameter.null for parameter in self.parameters])

    def apply(self, world: World, values: Sequence[float] | np.ndarray) -> World:
        """Edit a world in place and return it.

        Args:
          world: what is edited.
          values: (p,) one value per parameter.
        """
        values = np.asarray(values, float)
        if values.shape != (len(self.parameters),):
            raise InputError(f"{self.name}: got {values.shape} values, expected ({len(self.parameters)},)")
        self.effect.apply(world, self.place, values)
        return world


def candidates(model: mujoco.MjModel, scales: Scales, effects: Sequence[Effect]) -> list[Candidate]:
    """Every effect at every place of a model.

    Args:
      model: the believed model.
      scales: what ranges of parameters are made of; geoms that do not touch the ground there are left out.
      effects: the library.

    Raises:
      InputError: two effects of one name.
    """
    names = [effect.name for effect in effects]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"effects of the same name: {', '.join(twice)}; expected one entry each")
    return [
        Candidate(effect, place, effect.parameters(model, scales, place))
        for effect in effects
        for place in effect.places(model)
        if not place.geoms or scales.touching[list(place.geoms)].any()
    ]
