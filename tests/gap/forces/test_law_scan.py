"""Laws that no library has, planted at one joint of the arm: found by a scan."""

import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_forces import Force, arm_side, arm_stretches, believed, moved_arm

from btr_mjx.gap.effects import LAW_EFFECTS, Candidate, candidates
from btr_mjx.gap.forces.law_scan import law_words, scan_laws
from btr_mjx.gap.forces.motion import ends
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.search import select_effects, start
from btr_mjx.gap.windows import scales_of

FRICTION = [e for e in LIBRARY if e.name in ("viscous_damping", "dry_friction")]


def scene(force: Force | None, seed: int = 0) -> tuple[ForceSide, Fitted, list[Candidate]]:
    recordings = [moved_arm(f"r{i}", 10 * seed + i, force=force, seconds=0.8) for i in range(2)]
    side = arm_side(arm_stretches(recordings), FRICTION)
    return side, start(side, believed()), candidates(arm(), scales_of(side.stretches.data), LAW_EFFECTS)


def at(joint: int, of) -> Force:
    """A force at one joint."""

    def force(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        out = np.zeros(2)
        out[joint] = of(q[joint], v[joint], t)
        return out

    return force


RIPPLE = at(0, lambda q, v, t: 0.45 * np.sin(8 * q + 0.7))


@pytest.mark.parametrize(
    ("joint", "of", "law"),
    [
        (1, lambda q, v, t: -2.0 * abs(q), "law_corner_spring"),
        (1, lambda q, v, t: -0.03 * v * abs(v), "law_quadratic_drag"),
        (0, lambda q, v, t: 1.5 * t, "law_drift"),
        (0, lambda q, v, t: 0.6 * np.cos(9 * t + 1), "law_periodic"),
    ],
)
def test_what_a_force_looks_like_is_told(joint, of, law):
    best = scan_laws(*scene(at(joint, of))).leads[0]
    assert best.score > 30
    assert (best.candidate.effect.name, best.candidate.place.joints[0]) == (law, joint)
    words = law_words(arm(), best)
    assert best.candidate.effect.law.title in words
    assert ("shoulder", "elbow")[joint] in words


def test_a_robot_that_is_as_believed_follows_no_law():
    assert scan_laws(*scene(None, 1)).leads[0].score < 0


def test_columns_of_laws_are_what_simulation_says():
    """The scan's columns need no simulation; differences of simulations with tiny steps are the obvious route."""
    side, fit, laws = scene(RIPPLE)
    found = {lead.candidate.name: lead for lead in scan_laws(side, fit, laws).leads}
    lead, stretches = found["law_ripple@joint:shoulder"], fit.linear.stretches
    plain = fit.point.hypothesis(side.library)
    makes = [plain.with_effect(lead.candidate, (size, 0.0, lead.values[2])) for size in (1e-3, -1e-3)]
    more, less = (own[..., 2:] for own in ends(stretches, makes, counter=side.counter, factor=1 / 32))
    simulated = (more - less) / 2e-3
    middle = np.sin(lead.values[2] * 0.5 * (stretches.qpos[:, 1:, 0] + stretches.qpos[:, :-1, 0]))
    column = fit.linear.force[..., 2:, 0] * middle[..., None]
    error, size = (np.sqrt((of**2).mean()) for of in (simulated - column, column))
    assert error < 0.03 * size


def test_damping_is_no_law():
    side, fit, laws = scene(at(1, lambda q, v, t: -0.1 * v))
    _, chain, _ = select_effects(side, fit, 2, lambda _: None, lambda *_: True, laws)
    assert [candidate.name for candidate, _ in chain[-1].point.named] == ["viscous_damping@joint:elbow"]
