"""The library of effects that a model may lack: `EFFECTS`, one entry an effect.

An `Effect` is data: a name, the `Place`s where it may sit, its parameters with units and ranges, and one edit of a
world that serves search and mending alike. A `Candidate` is an effect at a place.
"""

from btr_mjx.gap.effects.effect import Candidate, Effect, candidates
from btr_mjx.gap.effects.library import EFFECTS, KNOWN
from btr_mjx.gap.effects.links import link_of
from btr_mjx.gap.effects.places import WORLD, Place, body_place, ground_geoms, joint_of, one_limb
from btr_mjx.gap.effects.ranges import Scales, closes_loops

__all__ = [
    "EFFECTS",
    "KNOWN",
    "WORLD",
    "Candidate",
    "Effect",
    "Place",
    "Scales",
    "body_place",
    "candidates",
    "closes_loops",
    "ground_geoms",
    "joint_of",
    "link_of",
    "one_limb",
]
