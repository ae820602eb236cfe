"""The library of effects that a model may lack: `EFFECTS`, one entry an effect.

An `Effect` is data: a name, the `Place`s where it may sit, its parameters with units and ranges, and one edit of a
world that serves search and mending alike. A `Candidate` is an effect at a place.
"""

from btr_mjx.gap.effects.effect import Candidate, Effect, Parameter, candidates
from btr_mjx.gap.effects.library import EFFECTS, KNOWN
from btr_mjx.gap.effects.links import link_of
from btr_mjx.gap.effects.places import (
    WORLD,
    Place,
    actuator_places,
    body_place,
    ground_geoms,
    joint_of,
    joint_places,
    one_limb,
)
from btr_mjx.gap.effects.ranges import Scales, closes_loops
from btr_mjx.gap.effects.selection import own_code, selected_effects

__all__ = [
    "EFFECTS",
    "KNOWN",
    "WORLD",
    "Candidate",
    "Effect",
    "Parameter",
    "Place",
    "Scales",
    "actuator_places",
    "body_place",
    "candidates",
    "closes_loops",
    "ground_geoms",
    "joint_of",
    "joint_places",
    "link_of",
    "one_limb",
    "own_code",
    "selected_effects",
]
