"""What a rollout records of every pair."""

from typing import Any, NamedTuple


class Record(NamedTuple):
    """Result of a rollout; inside the program the batch is the last axis of every array.

    Attributes:
      start: (3, C) base position at t = 0 [m].
      position: (K, 3, C) base position at the sample times [m].
      energy: (K, C) mechanical work of the motors up to the sample times, integral of sum |force x velocity| [J].
      peak_speed: (C,) highest speed of the base at any step [m/s].
      capped: (C,) number of steps in which the constraint solver reached its iteration limit.
      tripped: (C,) whether a contact that the engine does not compute may have taken part; the record is not MuJoCo's.
      qpos: (K, nq, C), or (K, 0, C) where states are not recorded.
      qvel: (K, nv, C), likewise.
      act: (K, na, C), likewise.
    """

    start: Any
    position: Any
    energy: Any
    peak_speed: Any
    capped: Any
    tripped: Any
    qpos: Any
    qvel: Any
    act: Any
