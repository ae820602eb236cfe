"""Walks over the size of an effect end at its bounds."""

import mujoco
import numpy as np
import pytest
from gap_systems import CUBE

from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.inference.search.line_search import factor_within_bounds, scaled
from btr_mjx.gap.inference.verdict.profile import _lowest

MODEL = mujoco.MjModel.from_xml_string(CUBE)


def slippery(coefficient: float) -> Hypothesis:
    found = candidates(MODEL, Scales.of(MODEL), EFFECTS)
    (friction,) = (c for c in found if c.name == "ground_friction@world")
    return Hypothesis((), ()).with_effect(friction, [coefficient])


@pytest.mark.parametrize(("factor", "expected"), [(0.5, 0.5), (1.0, 1.0), (1.5, 0.95 / 0.8), (9.0, 0.95 / 0.8)])
def test_a_factor_ends_at_the_bound(factor: float, expected: float) -> None:
    """From 1 believed to 0.2; the smallest coefficient that is tried is 0.05."""
    hypothesis = slippery(0.2)
    found = factor_within_bounds(hypothesis, factor)
    assert found == pytest.approx(expected)
    assert scaled(hypothesis, found).effects[0][1] == pytest.approx(scaled(hypothesis, factor).effects[0][1])


def test_the_lowest_point_of_a_parabola() -> None:
    sizes = np.linspace(0.1, 0.3, 9)
    assert _lowest(sizes, 4 + 7 * (sizes - 0.18) ** 2) == pytest.approx(0.18)
    assert _lowest(sizes, 4 + 7 * (sizes - 0.5) ** 2) is None
    assert _lowest(sizes, 4 - 7 * (sizes - 0.18) ** 2) is None
