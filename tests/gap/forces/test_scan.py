"""A scan against a fit of every candidate alone, and its price."""

from dataclasses import replace

import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_models import one
from scipy.optimize import lsq_linear

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces.evidence import CalibrationPrior
from btr_mjx.gap.forces.scan import price, scan_columns
from btr_mjx.gap.forces.unknowns import CandidateColumns

ROWS, COUNT = 300, 5000
NAMES = {"viscous_damping@joint:elbow": ((0,),), "armature@joint:elbow": ((1,),), "ground_slope@world": ((2,), (3,))}


@pytest.fixture(scope="module")
def scene():
    """Residual and columns: 0 to 3 of candidates, 4 of what was named before, 5 and 6 of calibration."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((ROWS, 7))
    columns[:, 1] += 0.7 * columns[:, 0]
    residual = 0.4 * columns[:, 0] + columns @ [0, 0, -0.3, 0.2, 0.5, 0.1, 0] + rng.standard_normal(ROWS)
    every = np.concatenate([residual[:, None], columns], 1)
    prior = CalibrationPrior(np.eye(7)[:, 5:], np.array([0.05, 0.2]), np.array([0.2, 0.8]), np.array([0.02, -0.1]))
    given = np.eye(7)[:, 4:5]
    candidates = {name: one(arm(), name, EFFECTS) for name in NAMES}
    entries = [
        CandidateColumns(candidates[name], columns_, ((-0.25, 0.25),) * len(columns_))
        for name, columns_ in NAMES.items()
    ]
    return residual, columns, every.T @ every, given, prior, entries


def alone(residual, columns, prior, chosen, bounds) -> tuple[float, np.ndarray]:
    """-2 ln p and numbers of columns that are chosen, beside calibration, by SciPy."""
    design = np.concatenate([columns[:, chosen], columns[:, 5:]], 1)
    rows = np.concatenate([np.zeros((2, len(chosen))), np.diag(1 / prior.tolerance)], 1)
    target = np.r_[-(residual - columns[:, 5:] @ prior.at), np.zeros(2)]
    low, high = np.r_[-np.array(bounds), -prior.reach], np.r_[np.array(bounds), prior.reach]
    found = lsq_linear(np.concatenate([design, rows]), target, (low, high), tol=1e-14)
    return 2 * found.cost, found.x


def test_candidates_gain_what_a_fit_of_each_alone_gains(scene):
    residual, columns, gram, given, prior, entries = scene
    base, leads = scan_columns(gram, entries, given, prior, COUNT)
    before, numbers = alone(residual, columns, prior, [4], [np.inf])
    assert base.loss == pytest.approx(before)
    np.testing.assert_allclose(base.values, numbers[:1], atol=1e-5)
    assert {lead.candidate.name for lead in leads} == set(NAMES)
    for lead in leads:
        own = [column for pair in NAMES[lead.candidate.name] for column in pair]
        after, numbers = alone(residual, columns, prior, [4, *own], [np.inf] + [0.25] * len(own))
        assert lead.gain == pytest.approx(before - after, rel=1e-5)
        assert lead.gain > 0
        np.testing.assert_allclose(lead.changes, numbers[:1], atol=1e-4)
        np.testing.assert_allclose(lead.values, numbers[1:-2], atol=1e-4)
        np.testing.assert_allclose(lead.calibration, numbers[-2:], atol=1e-4)
        assert lead.score == pytest.approx(lead.gain - price(len(own), COUNT, len(NAMES)))
    assert [lead.score for lead in leads] == sorted((lead.score for lead in leads), reverse=True)
    assert leads[0].values[0] == pytest.approx(-0.25)  # where its column ends to serve


def test_a_candidate_that_was_tried_at_several_steps_is_ranked_once_at_its_best(scene):
    _, _, gram, given, prior, entries = scene
    worse = replace(entries[0], columns=((3,),), near=((0.1, 0.2),))
    both = scan_columns(gram, [worse, *entries], given, prior, COUNT)[1]
    plain = scan_columns(gram, entries, given, prior, COUNT)[1]
    assert [(a.candidate.name, a.score) for a in both] == [(b.candidate.name, b.score) for b in plain]
    only = scan_columns(gram, [worse], given, prior, COUNT)[1][0]
    assert 0.1 <= only.values[0] <= 0.2


def test_the_price_is_that_of_numbers_and_of_the_choice():
    assert price(1, 1000, 1) == pytest.approx(np.log(1000))
    assert price(3, 1000, 50) - price(2, 1000, 50) == pytest.approx(np.log(1000))
    assert price(1, 1000, 50) - price(1, 1000, 10) == pytest.approx(2 * np.log(5))


def test_noise_pays_no_price():
    """Of many columns of nothing, the best gains less than its price."""
    rng = np.random.default_rng(2)
    damping = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    for _ in range(30):
        every = rng.standard_normal((COUNT, 21))
        nothing = CalibrationPrior(np.zeros((20, 0)), np.zeros(0), np.zeros(0), np.zeros(0))
        entries = [
            CandidateColumns(replace(damping, effect=replace(damping.effect, name=f"e{i}")), ((i,),), ((-9, 9),))
            for i in range(20)
        ]
        lead = scan_columns(every.T @ every, entries, np.zeros((20, 0)), nothing, COUNT)[1][0]
        assert lead.gain > 0
        assert lead.score < 0
