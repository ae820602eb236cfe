"""What leaves the traces of a named effect is listed, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from gap_arm import LIBRARY
from gap_forces import arm_side, arm_stretches, believed, moved_arm

from btr_mjx.gap.forces.answer.force_confounds import confounds_of
from btr_mjx.gap.forces.points import Point, evaluate_point
from btr_mjx.gap.forces.search import first_variances

DAMPING, FRICTION = (next(e for e in LIBRARY if e.name == name) for name in ("viscous_damping", "dry_friction"))
OIL = replace(DAMPING, name="oil")
"""Damping by another name."""


@pytest.fixture(scope="module")
def side():
    return arm_side(arm_stretches([moved_arm("r", 1)]), (DAMPING, OIL, FRICTION))


def point(side, name: str, value: float) -> Point:
    candidate = {e.candidate.name: e.candidate for e in side.library.entries}[name]
    return Point(believed(), ((candidate, (value,)),), np.zeros(len(side.library.calibrated)))


def test_the_same_effect_by_another_name_is_a_confound_of_correlation_one(side):
    fit = evaluate_point(side, point(side, "viscous_damping@joint:elbow", 0.1), first_variances(side, believed()))
    found = {one.other: one for one in confounds_of(side, fit)}
    assert found["oil@joint:elbow"].correlation == pytest.approx(1, abs=5e-3)
    assert found["oil@joint:elbow"].effect == "viscous_damping@joint:elbow"
    assert "Oil" in found["oil@joint:elbow"].text
    assert "elbow" in found["oil@joint:elbow"].text  # not at all joints, each with its own number
    assert not any("shoulder" in other for other in found)
    assert not any("viscous_damping" in other for other in found)


def test_what_is_not_named_has_no_confounds(side):
    nothing = Point(believed(), (), np.zeros(len(side.library.calibrated)))
    fit = evaluate_point(side, nothing, first_variances(side, believed()))
    assert confounds_of(side, fit) == ()
