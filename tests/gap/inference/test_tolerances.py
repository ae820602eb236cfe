"""What is fitted along with every hypothesis: tolerances, and the time step that data have of their own."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from gap_arm import LIBRARY as ALL
from gap_arm import QUICK, SIGMA, arm, arm_windows, dataset, recording

from btr_mjx.gap.data import Noise
from btr_mjx.gap.effects import EFFECTS, field_tolerance
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.scoring.screening import tolerances_of
from btr_mjx.gap.inference.search.naming import THRESHOLD
from btr_mjx.gap.inference.verdict.identify import name_missing
from btr_mjx.gap.simulate import Command, World
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


def test_what_a_dataset_says_of_calibration_is_taken(bench: Bench) -> None:
    """Else it is that of the field, but for what moves contacts; groups leave it to their members."""
    elbow, every = "viscous_damping@joint:elbow", "actuator_gain@all"
    own = next(c for c in bench.candidates if c.name == elbow).parameters[0].tolerance
    of = partial(tolerances_of, bench.candidates)
    usual = of({}, (), 0.005)
    assert usual[elbow] == field_tolerance("viscous_damping", own) > own
    assert every not in usual
    assert of({}, {elbow}, 0.005)[elbow] == own
    assert of({"viscous_damping": 0.3}, (), 0.005)[elbow] == 0.3
    assert elbow not in of({"viscous_damping": 0.0}, (), 0.005)


@pytest.mark.parametrize("name", ["viscous_damping@joint:elbow", "joint_offset@joint:shoulder"])
def test_an_effect_is_fitted_without_a_tolerance_of_its_own(bench: Bench, name: str) -> None:
    """The column that is held is that of the effect, as its true simulation has it, and all others are as they were."""
    candidate = next(c for c in bench.candidates if c.name == name)
    tolerance = bench.tolerances[name]
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


@pytest.mark.parametrize(("early", "verdict"), [(-1e-4, "none"), (5e-3, "effect")], ids=["within a step", "late"])
def test_when_commands_act_within_a_step_of_the_data_is_calibration(early: float, verdict: str) -> None:
    """Without the tolerance the small shift scores 120."""

    def arrive(sent: Command, time: np.ndarray) -> np.ndarray:
        return sent.at(time - early)

    noise = 0.3
    believed = arm()
    recordings = tuple(
        recording(f"r{i}", None, i, "fit" if i < 3 else "test", noise, believed, duration=0.7, arrive=arrive)
        for i in range(5)
    )
    data = replace(dataset(fit=1, test=1), recordings=recordings, noise=Noise(noise * SIGMA[:2], noise * SIGMA[2:]))
    found = name_missing(Bench(data, ALL, QUICK))
    assert found.verdict == verdict
    assert [named.name for named in found.effects] == (["actuator_delay@all"] if verdict == "effect" else [])
    assert (found.ranking[0].score > THRESHOLD) == (verdict == "effect")
    for named in found.effects:
        assert named.parameters["delay"].value == pytest.approx(early, rel=0.03)
