"""Library of physical effects that a model may lack: `EFFECTS`.

An `Effect` is data: a name, the `Place`s where it may occur, parameters with units and ranges, and one edit of a world
that is used by the search and for the mended model. A `Candidate` is an effect at a place.
"""

from btr_mjx.gap.effects.actuators import TORQUE_CONSTANT
from btr_mjx.gap.effects.effect import Candidate, Effect, Parameter, candidates
from btr_mjx.gap.effects.hypothesis import Hypothesis, believed_steps
from btr_mjx.gap.effects.law_dictionary import LAW_EFFECTS, LAWS
from btr_mjx.gap.effects.law_effects import equation_of, law_effect
from btr_mjx.gap.effects.law_terms import LawState, LawTerm, Tried
from btr_mjx.gap.effects.library import (
    EFFECTS,
    KNOWN_EFFECTS,
    OF_LOG,
    TIME_IN_SAMPLE,
    TIMING,
    custom_effect_code,
    field_tolerance,
    known_effects,
    of_forces,
    selected_effects,
)
from btr_mjx.gap.effects.links import link_of
from btr_mjx.gap.effects.mass import MassProperties, rotation_matrix
from btr_mjx.gap.effects.per_member import EACH_MEMBER, per_member
from btr_mjx.gap.effects.places import (
    WORLD,
    Place,
    actuator_count,
    actuator_places,
    body_place,
    ground_geoms,
    joint_of,
    joint_places,
)
from btr_mjx.gap.effects.ranges import Scales, has_closed_loops
from btr_mjx.gap.effects.residual import RESIDUAL, ResidualTable

__all__ = [
    "EACH_MEMBER",
    "EFFECTS",
    "KNOWN_EFFECTS",
    "LAWS",
    "LAW_EFFECTS",
    "OF_LOG",
    "RESIDUAL",
    "TIME_IN_SAMPLE",
    "TIMING",
    "TORQUE_CONSTANT",
    "WORLD",
    "Candidate",
    "Effect",
    "Hypothesis",
    "LawState",
    "LawTerm",
    "MassProperties",
    "Parameter",
    "Place",
    "ResidualTable",
    "Scales",
    "Tried",
    "actuator_count",
    "actuator_places",
    "believed_steps",
    "body_place",
    "candidates",
    "custom_effect_code",
    "equation_of",
    "field_tolerance",
    "ground_geoms",
    "has_closed_loops",
    "joint_of",
    "joint_places",
    "known_effects",
    "law_effect",
    "link_of",
    "of_forces",
    "per_member",
    "rotation_matrix",
    "selected_effects",
]
