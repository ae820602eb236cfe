"""Whole recordings, simulated open loop from their first sample."""

import numpy as np
import pytest
from gap_arm import dataset

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, Hypothesis
from btr_mjx.gap.inference.verdict.openloop import open_loop, recording_errors
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


def test_the_nearer_to_the_truth_the_better_recordings_are_followed(bench: Bench) -> None:
    tries = [at(bench, damping) for damping in (0.0, 0.05, 0.1, 0.2)]
    errors = recording_errors(bench.fit.windows.data, tries)
    assert np.argmin(errors.mean(1)) == 2
    held_out = open_loop(bench, [tries[0], tries[2]])
    assert held_out.after is not None
    assert held_out.after < 0.3 * held_out.before
