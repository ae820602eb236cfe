"""Robots of hidden cases: those of demonstrations, and where effects may be added to them.

There are four: the hexapod of this project, a servo with a pendulum, a quadruped and an arm. Missing effects are added
in `physics`.
"""

from dataclasses import dataclass
from functools import cache

from btr_mjx.demo import DemoRobot, demo_robots
from btr_mjx.errors import InputError


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


@cache
def case_robots() -> dict[str, CaseRobot]:
    """All case robots by name."""
    quarters = ("fl", "fr", "rl", "rr")
    shanks = tuple(f"{leg}_{part}" for leg in quarters for part in ("thigh", "shank"))
    six, twelve = tuple(f"b{i}" for i in range(3, 9)), tuple(f"b{i}" for i in range(3, 15))
    robots = demo_robots()
    return {
        "hexapod": CaseRobot(**vars(robots["hexapod"]), floor="ground", legs=six, links=twelve, drag=(5.0, 100.0)),
        "pendulum": CaseRobot(**vars(robots["pendulum"]), floor=None, legs=(), links=("arm",), drag=(100.0, 2000.0)),
        "quadruped": CaseRobot(
            **vars(robots["quadruped"]),
            floor="floor",
            legs=tuple(f"{leg}_hip" for leg in quarters),
            links=shanks,
            drag=(20.0, 400.0),
        ),
        "arm": CaseRobot(
            **vars(robots["arm"]), floor=None, legs=("lower",), links=("upper", "lower"), drag=(50.0, 1000.0)
        ),
    }


def case_robot(name: str) -> CaseRobot:
    """A case robot by name.

    Args:
      name: hexapod, pendulum, quadruped or arm.

    Returns:
      The robot.

    Raises:
      InputError: there is none of that name.
    """
    robots = case_robots()
    if name not in robots:
        raise InputError(f"robot {name!r}: expected one of {', '.join(robots)}")
    return robots[name]
