"""What is fitted along with every hypothesis: tolerances, and the time step that data have of their own."""

import numpy as np
import pytest
from gap_arm import arm_windows, dataset

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Options, project, step_uncertainty

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "joint_offset", "actuator_gain"))


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(dataset(seed=4, fit=2, test=2), LIBRARY, Options(steps=4e4, leaders=2, contact_leaders=0))


def test_doubt_about_the_time_step_is_what_another_one_does() -> None:
    """Data of a machine and of a simulation in steps of 0.1 ms, against both simulated in such steps."""
    windows = arm_windows()
    shift = 1e-4
    near, far = (windows.whiten(windows.states([World.of], timestep=t)[0]) for t in (1e-4, 1e-4 + shift))
    expected = project(near - far, windows.basis)
    found = step_uncertainty(windows) * shift / 1e-4
    np.testing.assert_allclose(found, expected, atol=0.1 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.1


@pytest.mark.parametrize("name", ["viscous_damping@joint:elbow", "joint_offset@joint:shoulder"])
def test_an_effect_is_fitted_without_a_tolerance_of_its_own(bench: Bench, name: str) -> None:
    """The column that is held is that of the effect, as its true simulation has it, and all others are as they were."""
    candidate = next(c for c in bench.candidates if c.name == name)
    tolerance = candidate.parameters[0].tolerance
    hypothesis = bench.base.with_effect(candidate, candidate.null + tolerance)
    for side in (bench.fit, bench.test):
        windows, usual, held = side.windows, bench.nuisance(side), bench.nuisance(side, hypothesis)
        (own,) = np.flatnonzero(held.precision != usual.precision)
        moved = windows.residuals([hypothesis])[0] - windows.residual
        np.testing.assert_allclose(usual.columns[:, own], moved, atol=0.05 * np.abs(moved).max())
        rest = np.delete(np.arange(len(usual.precision)), own)
        less = Nuisance(usual.columns[:, rest], usual.precision[rest], usual.gram[:, rest[:, None], rest])
        residual = windows.residual + 30 * moved
        found, expected = held.profile(residual, bench.cut), less.profile(residual, bench.cut)
        assert found.loss == pytest.approx(expected.loss, rel=1e-2)
        np.testing.assert_allclose(found.values[rest], expected.values, atol=0.05)
        assert abs(found.values[own]) < 0.1
        assert usual.profile(residual, bench.cut).loss < expected.loss
