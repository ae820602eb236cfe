"""Data types of effects: `Parameter`, `Effect` and `Candidate` (an effect at a place)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.law_terms import LawTerm
from btr_mjx.gap.effects.places import Place
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import World


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter of an effect at a place.

    Attributes:
      name: of the parameter.
      unit: SI unit, "1" if dimensionless.
      low: lower bound of the search.
      high: upper bound of the search.
      step: signed difference from `null` for finite differences: visible above the noise, but in the linear range.
      tolerance: standard deviation of the residual calibration error; 0 for none.
      null: value at which the effect is absent; sizes are differences from it.
      shape: the parameter has no influence while the first one is at its null (position of a mass, Stribeck speed);
        `null` is then the starting value of its search.
      negligible: smallest difference from `null` of the first parameter for which an effect is named.
      floor: the lower bound is a physical limit, such as zero friction: nothing lies below it.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float
    tolerance: float = 0.0
    null: float = 0.0
    shape: bool = False
    negligible: float = 0.0
    floor: bool = False

    def __post_init__(self) -> None:
        if not (self.low <= self.null <= self.high and self.step != 0):
            raise InputError(
                f"parameter {self.name!r}: got low {self.low}, null {self.null}, high {self.high}, step {self.step}; "
                "expected low <= null <= high and a step other than 0"
            )

    def at_edge(self, value: float) -> bool:
        """Whether a value lies at a bound of the search beyond which larger effects are possible."""
        room = 1e-3 * (self.high - self.low)
        high = self.high > self.null and value > self.high - room
        low = self.low < self.null and not self.floor and value < self.low + room
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
      places: function that lists the places of a model where the effect may occur.
      parameters: function that returns the parameters at a place, with ranges that suit the model and the data.
      apply: edits a world in place. Its changes of model fields are also used for the mended model.
      excited_by: motion that excites the effect, for reports.
      summable: whether the signature of a group of places is the sum of those of its members.
      saturates: whether the first parameter is a limit that does nothing at its null: what it does tighter is not
        linear, and it is tried at several values.
      native: writes the part of the effect that is not in model fields (command edit, law, wrench) into an MjSpec;
        returns whether MuJoCo can represent it.
      equation: the effect in one line, for reports.
      law: the term of the dictionary of laws that it is; None for an effect of the library.
    """

    name: str
    places: Places
    parameters: _MakeParameters
    apply: Apply
    excited_by: str = ""
    summable: bool = False
    saturates: bool = False
    native: Native | None = None
    equation: str = ""
    law: LawTerm | None = None


@dataclass(frozen=True)
class Candidate:
    """An effect at one place.

    Attributes:
      effect: the effect.
      place: where it acts.
      parameters: its parameters there.
    """

    effect: Effect
    place: Place
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Name of effect and place, for tables."""
        return f"{self.effect.name}@{self.place.label}"

    @property
    def singles(self) -> tuple["Candidate", ...]:
        """Itself, or the members of its group where each of them has a number of its own."""
        pairs = zip(self.place.parts, self.parameters, strict=bool(self.place.parts))
        return tuple(Candidate(self.effect, part, (own,)) for part, own in pairs) or (self,)

    @property
    def null(self) -> np.ndarray:
        """(p,) values at which the effect is absent."""
        return np.array([parameter.null for parameter in self.parameters])

    def covers(self, other: "Candidate") -> bool:
        """Whether it has a number of its own for every place of another candidate of the same effect."""
        theirs = other.place.members or (other.place.label,)
        return self.effect is other.effect and bool(self.place.parts) and set(theirs) <= set(self.place.members)

    def apply(self, world: World, values: Sequence[float] | np.ndarray) -> World:
        """Edit a world in place and return it.

        Args:
          world: edited in place.
          values: (p,) one value per parameter.

        Returns:
          The world.

        Raises:
          InputError: another number of values.
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
      scales: typical sizes that set the ranges of parameters; places of geoms without ground contact are left out.
      effects: the library.

    Returns:
      The candidates, in the order of effects and places.

    Raises:
      InputError: two effects have the same name.
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
