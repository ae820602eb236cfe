"""What the lanes engine computes, guards and refuses of a model."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from btr_mjx.engines import possible_contacts, refusals
from btr_mjx.errors import InputError

_FAR = 1e3
"""Distances beyond it are not told apart [m]."""

_SHOWN = 5
"""Reasons of one kind that the summary names."""


@dataclass(frozen=True)
class CoveredPair:
    """How the lanes engine treats the contact of two geoms.

    Attributes:
      names: of both geoms.
      reason: why their contact is guarded; empty where it is computed.
      distance: between guarded geoms in qpos0 [m], below 0 where they overlap; NaN where the contact is computed.
    """

    names: str
    reason: str
    distance: float


@dataclass(frozen=True)
class Coverage:
    """How the lanes engine treats a model; `str()` of it is a summary.

    Attributes:
      pairs: every pair of geoms that MuJoCo can collide: those whose contact is computed, then those that are guarded,
        nearest first. A world in which guarded geoms may touch is evaluated by native MuJoCo.
      refused: features that are not computed, each with the element that uses it; where there are any, native MuJoCo
        evaluates all worlds.
    """

    pairs: tuple[CoveredPair, ...]
    refused: tuple[str, ...]

    @property
    def computed(self) -> tuple[str, ...]:
        """Names of the geom pairs whose contact is computed."""
        return tuple(pair.names for pair in self.pairs if not pair.reason)

    @property
    def guarded(self) -> tuple[str, ...]:
        """Geom pairs whose contact is not computed, each with the reason."""
        return tuple(f"{pair.reason} ({pair.names})" for pair in self.pairs if pair.reason)

    @property
    def verdict(self) -> str:
        """Whether the model as a whole is "refused", "guarded" or "computed"."""
        return "refused" if self.refused else "guarded" if self.guarded else "computed"

    def __str__(self) -> str:
        own = [pair for pair in self.pairs if pair.reason]
        lines = [
            f"{self.verdict}: contacts of {len(self.computed)} pairs of geoms are computed, {len(own)} are guarded"
        ]
        if own:
            lines += ["guarded: native MuJoCo computes the worlds in which they may touch"]
            lines += _shown([f"{n} x {reason}" for reason, n in Counter(pair.reason for pair in own).most_common()])
            lines += [f"  nearest: {pair.names}, {pair.distance:.3g} m apart" for pair in own[:3]]
        if self.refused:
            lines += [f"refused ({len(self.refused)}): native MuJoCo computes all worlds", *_shown(self.refused)]
        return "\n".join(lines)


def _shown(items: Sequence[str]) -> list[str]:
    """The first items, indented, and how many more there are."""
    more = [f"  and {len(items) - _SHOWN} more"] if len(items) > _SHOWN else []
    return [f"  {item}" for item in items[:_SHOWN]] + more


def as_model(model: mujoco.MjModel | str | Path) -> mujoco.MjModel:
    """The model, or the one of an MJCF file or MJCF text."""
    if isinstance(model, mujoco.MjModel):
        return model
    text = str(model)
    try:
        return mujoco.MjModel.from_xml_string(text) if "<" in text else mujoco.MjModel.from_xml_path(text)
    except ValueError as error:
        raise InputError(f"model: got {text[:80]!r}, expected an MjModel, an MJCF file or MJCF text: {error}") from None


def coverage(model: mujoco.MjModel | str | Path) -> Coverage:
    """What the lanes engine computes, guards and refuses of a model.

    Args:
      model: an MjModel, the path of an MJCF file or MJCF text.

    Returns:
      The coverage; `print` of it is a summary of at most 20 lines, `Coverage.pairs` the whole.

    Raises:
      InputError: MuJoCo cannot read the model.
    """
    m = as_model(model)
    contacts, data = possible_contacts(m), mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)

    def both(*geoms: int) -> str:
        names = [m.geom(g).name or f"geom number {g} of {m.body(int(m.geom_bodyid[g])).name}" for g in geoms]
        return " and ".join(names)

    computed = [both(g, plane) for g, planes in contacts.computed.items() for plane, _ in planes]
    computed += [both(pair.first, pair.second) for pair in contacts.between]
    guarded = [
        CoveredPair(
            both(own.pair.first, own.pair.second),
            own.reason.partition(" (")[0],
            mujoco.mj_geomDistance(m, data, own.pair.first, own.pair.second, _FAR, None),
        )
        for own in contacts.guarded
    ]
    guarded.sort(key=lambda pair: pair.distance)
    return Coverage((*(CoveredPair(names, "", math.nan) for names in computed), *guarded), tuple(refusals(m)))
