"""Effects that are named are seen: "none" is outside the interval of their numbers."""

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, arm, damped
from gap_forces import arm_side, arm_stretches, believed, moved_arm
from gap_models import one

from btr_mjx.gap.forces.answer.final_numbers import without_invisible
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, covariance
from btr_mjx.gap.forces.search import first_variances
from btr_mjx.gap.forces.settling import settled

NAME = "viscous_damping@joint:elbow"


def as_believed(model: mujoco.MjModel) -> None:
    """The robot lacks nothing."""


def fitted(seed: int, change) -> tuple[ForceSide, Fitted]:
    """More damping at the elbow, fitted to one short recording with twenty times the usual noise."""
    effects = tuple(e for e in LIBRARY if e.name == "viscous_damping")
    recordings = [moved_arm("r0", seed, change=change, noise=20.0, rate=100.0)]
    side = arm_side(arm_stretches(recordings), effects)
    point = Point(believed(), ((one(arm(), NAME, LIBRARY), (0.05,)),), np.zeros(len(side.library.calibrated)))
    return side, settled(side, point, first_variances(side, point.hypothesis(side.library)))


@pytest.mark.parametrize("seed", [2, 4, 5])
def test_a_number_that_may_as_well_be_nothing_is_not_named(seed: int) -> None:
    side, fit = fitted(seed, as_believed)
    (value,) = fit.point.named[0][1]
    assert 0.001 < abs(value) < 2 * np.sqrt(covariance(side, fit)[0, 0])
    assert without_invisible(side, fit).point.named == ()


@pytest.mark.parametrize("seed", [0, 2])
def test_a_number_that_is_seen_stays(seed: int) -> None:
    side, fit = fitted(seed, damped)
    assert without_invisible(side, fit) is fit
