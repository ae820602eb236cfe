"""Rivals are compared from starting states that all of them know."""

import numpy as np
import pytest
from gap_arm import arm_windows

from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.search.pairwise import share_starting_states
from btr_mjx.gap.inference.search.search_records import Side


def raw(side: Side) -> np.ndarray:
    return (side.windows.raw**2).sum(1)


@pytest.fixture(scope="module")
def rivals() -> tuple[list[Hypothesis], list[Side]]:
    """The believed arm, a wrong offset and a damping, from starting states that were found for each alone."""
    windows = arm_windows()
    model = windows.models[0]
    found = {c.name: c for c in candidates(model, Scales.of(model), EFFECTS)}
    base = Hypothesis((), ())
    offset = base.with_effect(found["joint_offset@joint:elbow"], [0.03])
    damping = base.with_effect(found["viscous_damping@joint:elbow"], [0.02])
    side = Side(windows, Nuisance.nothing(*windows.residual.shape)).based(base)
    return [base, offset, damping], [side, side.with_fitted_states(offset), side.with_fitted_states(damping)]


def test_no_window_is_farther_from_the_data_than_from_any_state_that_a_rival_found(rivals) -> None:
    hypotheses, sides = rivals
    shared = share_starting_states(hypotheses, sides, [1, 2])
    for h, own in zip(hypotheses, shared, strict=True):
        for other in sides:
            assert (raw(own) <= raw(other.based(h)) + 1e-9).all()
    gained = sum(float((raw(own) - raw(now)).sum()) for own, now in zip(sides, shared, strict=True))
    assert gained > 1.0  # the others' states are worth something
    for h, own in zip(hypotheses, shared, strict=True):
        np.testing.assert_array_equal(own.windows.base, own.windows.states([h])[0])


def test_where_fewer_than_two_move_contacts_nothing_changes(rivals) -> None:
    hypotheses, sides = rivals
    for moving in ([], [1]):
        assert all(a is b for a, b in zip(share_starting_states(hypotheses, sides, moving), sides, strict=True))
