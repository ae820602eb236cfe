"""Forces of shapes that no effect of the library has, planted at one joint of the arm."""

import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_forces import Force, arm_side, arm_stretches, believed, moved_arm

from btr_mjx.gap.forces import shapes
from btr_mjx.gap.forces.missing_force import MissingForce, missing_force
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.search import start
from btr_mjx.gap.forces.shapes import best_shape, shape_sentence

FRICTION = [e for e in LIBRARY if e.name in ("viscous_damping", "dry_friction")]


def scene(force: Force | None, seed: int = 0) -> tuple[ForceSide, Fitted, MissingForce]:
    recordings = [moved_arm(f"r{i}", 10 * seed + i, force=force, seconds=1.2) for i in range(2)]
    side = arm_side(arm_stretches(recordings), FRICTION)
    return *start(side, believed()), missing_force(side.stretches, believed())


def at(joint: int, of) -> Force:
    """A force at one joint."""

    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        out = np.zeros(2)
        out[joint] = of(q[joint], v[joint], t)
        return out

    return force


RIPPLE = at(0, lambda q, v, t: 0.45 * np.sin(8 * q + 0.7))


@pytest.mark.parametrize(
    ("joint", "of", "follows"),
    [
        (1, lambda q, v, t: -2.0 * abs(q), "the absolute value of its position"),
        (1, lambda q, v, t: -0.03 * v * abs(v), "the square of its speed"),
        (0, lambda q, v, t: 1.5 * t, "time (a drift)"),
    ],
)
def test_what_a_force_follows_is_told(joint, of, follows):
    found = best_shape(*scene(at(joint, of)))
    assert found.score > 30
    assert (found.dof, found.follows) == (joint, follows)
    words = shape_sentence(arm(), found)
    assert follows in words
    assert ("shoulder", "elbow")[joint] in words


def test_a_robot_that_is_as_believed_follows_nothing():
    assert best_shape(*scene(None, 1)).score < 10


def test_a_ripple_has_as_many_periods_as_the_force(monkeypatch):
    """Of those that are tried alone, that with 8 per radian explains most, of the right joint."""
    side, fit, missing = scene(RIPPLE)
    found = best_shape(side, fit, missing)
    assert (found.dof, found.follows) == (0, "a ripple over its position")
    assert found.score > 30
    scores = {}
    for count in shapes._RIPPLES:
        monkeypatch.setattr(shapes, "_RIPPLES", (count,))
        scores[count] = best_shape(side, fit, missing).score
    other = max(score for count, score in scores.items() if count != 8)
    assert scores[8] > 2 * max(other, 10)
