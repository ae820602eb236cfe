"""Choice of the next experiment on the arm: expected and recorded differences of scores, recordings saved."""

import dataclasses

import numpy as np
import pytest
from gap_arm import SIGMA, dataset
from recorded_margins import Measurement, noisy_recording, recorded_margin, recordings_needed

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.experiments import propose
from btr_mjx.gap.experiments.next_experiment import expected_margins
from btr_mjx.gap.inference import Bench, identify
from btr_mjx.gap.simulate import Command
from btr_mjx.gap.windows import Options

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature"))
QUICK = Options(steps=6e4, leaders=4, contact_leaders=0)


def damped(model):
    model.dof_damping[1] += 0.1


def hypotheses():
    bench = Bench(dataset(damped, seed=1, fit=2, test=1), LIBRARY, QUICK)
    by_name = {c.name: c for c in bench.candidates}
    viscous = bench.base.with_effect(by_name["viscous_damping@joint:elbow"], [0.006])
    heavy = bench.base.with_effect(by_name["armature@joint:elbow"], [0.0005])
    return bench, viscous, heavy


def test_a_constant_command_separates_less_than_a_moving_one():
    bench, viscous, heavy = hypotheses()
    time = np.arange(0, 1.0, 0.005)
    still = Command(time, np.zeros((len(time), 2)), "linear")
    lively = Command(time, 0.8 * np.sin(time[:, None] * [5.0, 9.0]), "linear")
    span = bench.survey.span
    for pair in ([viscous, heavy], [bench.base, viscous], [viscous, bench.base]):
        values = [expected_margins(pair, bench.dataset, c, SIGMA, span)[0, 1] for c in (still, lively)]
        assert values[1] > 10 * max(values[0], 1e-9)
        assert values[1] > 50.0  # against no effect, too
    made = [noisy_recording(viscous, bench.dataset, lively, SIGMA, np.random.default_rng(0))]
    assert recorded_margin(viscous, bench.base, made, SIGMA, span) > 50.0


def test_recordings_show_the_expected_disagreement():
    bench, viscous, heavy = hypotheses()
    time = np.arange(0, 1.0, 0.005)
    command, span = Command(time, 0.8 * np.sin(time[:, None] * [5.0, 9.0]), "linear"), bench.survey.span
    average = []
    for truth, rival in ((viscous, heavy), (heavy, viscous)):
        rngs = [np.random.default_rng(seed) for seed in range(4)]
        made = [noisy_recording(truth, bench.dataset, command, SIGMA, rng) for rng in rngs]
        shown = [recorded_margin(truth, rival, [own], SIGMA, span) for own in made]
        assert recorded_margin(truth, rival, made, SIGMA, span) == pytest.approx(sum(shown), rel=0.05)
        # The result does not depend on the order of the two.
        assert recorded_margin(rival, truth, made, SIGMA, span) == pytest.approx(-sum(shown), rel=0.05)
        average.append(np.mean(shown))
    # The expected difference, which does not use the truth, is of the size of the recorded ones.
    expected = expected_margins([viscous, heavy], bench.dataset, command, SIGMA, span)[0, 1]
    assert min(average) / 2.5 < expected < max(average) * 1.5


def test_chosen_experiments_save_recordings():
    """Three of the four commands do not move the arm; a chosen order takes the fourth first."""
    bench, viscous, heavy = hypotheses()
    time = np.arange(0, 0.6, 0.005)
    still = Command(time, np.zeros((len(time), 2)), "linear")
    lively = Command(time, 0.8 * np.sin(time[:, None] * [5.0, 9.0]), "linear")
    commands = [still, still, still, lively]
    needed = [
        recordings_needed(
            *(viscous, heavy, bench.dataset, Measurement(SIGMA, bench.survey.span), np.random.default_rng(0), choose),
            max_recordings=4,
            commands=commands,
        )
        for choose in (True, False)
    ]
    assert needed[0] == 1
    assert needed[1] > 2


def test_a_proposal_names_its_pair_and_stays_in_range():
    made = dataset(damped, seed=1, fit=2, test=1)
    found = identify(made, LIBRARY[:1], max_effects=1, options=QUICK)
    _, viscous, heavy = hypotheses()
    survivors = (viscous, heavy)
    asked = dataclasses.replace(found, survivors=survivors)
    proposal = propose(asked, made, seed=3)
    assert proposal is not None
    assert proposal.values.shape == (len(proposal.time), 2)
    assert proposal.disagreement == max(proposal.others)
    assert set(proposal.between) <= {h.name for h in survivors}
    assert propose(dataclasses.replace(found, survivors=survivors[:1]), made) is None
