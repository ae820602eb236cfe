"""Whole recordings, simulated open loop from their first sample."""

import numpy as np
import pytest
from gap_arm import dataset

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, Hypothesis
from btr_mjx.gap.inference.verdict.openloop import followed, following, open_loop, recording_errors
from btr_mjx.gap.windows import Options


def damped(model):
    model.dof_damping[1] += 0.1


@pytest.fixture(scope="module")
def bench() -> Bench:
    effects = [effect for effect in EFFECTS if effect.name == "viscous_damping"]
    return Bench(dataset(damped, seed=4, noise=0.01), effects, Options(steps=3e4, leaders=2))


def at(bench: Bench, damping: float) -> Hypothesis:
    elbow = next(c for c in bench.candidates if c.name == "viscous_damping@joint:elbow")
    return bench.base.with_effect(elbow, [damping])


def test_numbers_that_follow_whole_recordings_are_found_from_afar(bench: Bench) -> None:
    start = at(bench, 0.02)
    found = followed(bench, start).values(False)[0]
    assert found == pytest.approx(0.1, rel=0.25)  # the model's steps of 2 ms damp by themselves
    tries = [at(bench, damping) for damping in (0.02, 0.7 * found, found, 1.3 * found)]
    afar, less, best, more = recording_errors(bench.fit.windows.data, tries).mean(1)
    assert best < min(less, more)
    assert best < 0.3 * afar
    assert open_loop(bench, [at(bench, found)])[0] < open_loop(bench, [start])[0]


def test_what_has_no_numbers_stays(bench: Bench) -> None:
    assert followed(bench, bench.base) is bench.base


def test_a_name_that_follows_is_judged_by_its_new_numbers(bench: Bench) -> None:
    start = at(bench, 0.03)
    sides = bench.fit, bench.test
    values = start.values(bench.joint)
    refined = bench.find()[0].refined
    (judged,) = bench.judge([start], [refined], sides)
    again = following(bench, judged)
    np.testing.assert_array_equal(again.refined.residual, sides[0].windows.residuals([again.hypothesis])[0])
    np.testing.assert_array_equal(again.refined.values, again.hypothesis.values(bench.joint))
    assert again.hypothesis.values(bench.joint)[0] > 2 * values[0]
    assert again.held_out > judged.held_out
