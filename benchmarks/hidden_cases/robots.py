"""Robots of hidden cases: those of demonstrations, and where effects may be added to them.

There are four: the hexapod of this project, a servo with a pendulum, a quadruped and an arm. Missing effects are added
in `physics`.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

from btr_mjx.demo import DemoRobot, demo_robot


@dataclass(frozen=True)
class CaseRobot(DemoRobot):
    """A robot for hidden cases.

    Attributes:
      floor: geom on which it stands; None for none.
      legs: root bodies of the limbs, for effects on all joints of a limb.
      links: bodies whose length may differ.
      drag: range from which the density of a medium is drawn [kg/m^3].
    """

    floor: str | None
    legs: tuple[str, ...]
    links: tuple[str, ...]
    drag: tuple[float, float]


_QUARTERS = ("fl", "fr", "rl", "rr")
_PLACES: dict[str, dict[str, Any]] = {
    "hexapod": {
        "floor": "ground",
        "legs": tuple(f"b{i}" for i in range(3, 9)),
        "links": tuple(f"b{i}" for i in range(3, 15)),
        "drag": (5.0, 100.0),
    },
    "pendulum": {"floor": None, "legs": (), "links": ("arm",), "drag": (100.0, 2000.0)},
    "quadruped": {
        "floor": "floor",
        "legs": tuple(f"{leg}_hip" for leg in _QUARTERS),
        "links": tuple(f"{leg}_{part}" for leg in _QUARTERS for part in ("thigh", "shank")),
        "drag": (20.0, 400.0),
    },
    "arm": {"floor": None, "legs": ("lower",), "links": ("upper", "lower"), "drag": (50.0, 1000.0)},
}
"""Fields of a case robot besides those of the demonstration."""


@cache
def case_robot(name: str) -> CaseRobot:
    """A case robot by name.

    Args:
      name: hexapod, pendulum, quadruped or arm.

    Returns:
      The robot.

    Raises:
      InputError: there is none of that name.
    """
    return CaseRobot(**vars(demo_robot(name)), **_PLACES[name])
