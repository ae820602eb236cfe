"""Confounds: correlations against plain least squares, and cases in which it is known what cannot be told apart."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from gap_arm import QUICK, damped, dataset

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.confounds import Rest, closest, confounds
from btr_mjx.gap.results import confound_sentence, refit_sentence
from btr_mjx.models import PathParameter


@pytest.mark.parametrize("wide", [True, False], ids=["free nuisances", "held nuisances"])
def test_the_rest_against_least_squares(rng: np.random.Generator, wide: bool) -> None:
    """Absorbing a nuisance with a prior is an ordinary fit with one more row a nuisance."""
    windows, rows, count = 5, 7, 3
    nuisance = rng.normal(size=(windows, count, rows))
    precision = np.full(count, 1e-9 if wide else 4.0)
    weights = rng.uniform(0.2, 1.0, windows)
    signature, others = rng.normal(size=(windows, rows)), rng.normal(size=(2, windows, rows))

    def tall(column: np.ndarray) -> np.ndarray:
        return np.concatenate([(column * np.sqrt(weights)[:, None]).ravel(), np.zeros(count)])

    design = np.stack([tall(nuisance[:, i]) for i in range(count)], 1)
    design[-count:] = np.diag(np.sqrt(precision))

    def left(column: np.ndarray) -> np.ndarray:
        return column - design @ np.linalg.lstsq(design, column, rcond=None)[0]

    target, columns = left(tall(signature)), np.stack([left(tall(o)) for o in others], 1)
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    correlation, factors = Rest(nuisance, precision, weights).alike(signature, others)
    np.testing.assert_allclose(factors, expected, rtol=1e-6)
    share = 1 - np.sum((target - columns @ expected) ** 2) / np.sum(target**2)
    assert correlation == pytest.approx(np.sqrt(share), rel=1e-6)


def test_no_nuisances_leave_the_plain_correlation(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 4, 6))
    rest = Rest(np.zeros((4, 0, 6)), np.zeros(0), np.ones(4))
    plain = abs(np.sum(a * b)) / np.sqrt(np.sum(a * a) * np.sum(b * b))
    assert rest.alike(a, b[None])[0] == pytest.approx(plain)
    assert rest.alike(a, -3 * a[None])[0] == pytest.approx(1.0)
    assert rest.alike(a, -3 * a[None])[1] == pytest.approx(-1 / 3)


def test_all_candidates_at_once_against_each_alone(rng: np.random.Generator) -> None:
    """What the scanner's inner products say of a signature is what its columns do."""
    bench, leader = damping_found((PathParameter("servo kp", ("actuator:shoulder/kp",), 10.0, 30.0),))
    weights = rng.uniform(0.2, 1.0, len(bench.fit.windows))
    signature, free = leader.refined.columns[-1], bench.free(bench.fit)
    gram = bench.scanner.left(signature, weights, free.precision)
    rest, checked = Rest(free.columns, free.precision, weights), 0
    for index, span in enumerate(bench.scanner.spans):
        correlation, factors = rest.alike(signature, bench.scanner.screened.signature(index))
        own, values = closest(gram[np.ix_([*span, len(gram) - 1], [*span, len(gram) - 1])])
        assert own == pytest.approx(correlation, abs=1e-3)
        if correlation > 0.1:
            np.testing.assert_allclose(values, factors, rtol=0.01, atol=0.01 * np.abs(factors).max())
            checked += 1
    assert checked > 2


def damping_found(believed: tuple[PathParameter, ...]) -> tuple[Bench, Judged]:
    """A search among recordings of an arm with more damping at the elbow, and that leader."""
    library = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature", "load_friction"))
    options = replace(QUICK, leaders=8)
    bench = Bench(dataset(damped, seed=1, fit=2, test=1, parameters=believed), library, options)
    return bench, next(j for j in bench.find() if j.name == "viscous_damping@joint:elbow")


def test_servo_damping_is_mistaken_for_joint_damping() -> None:
    """A servo's velocity gain damps exactly as its joint does; its stiffness does not."""
    believed = (
        PathParameter("servo kv", ("actuator:elbow/kv",), 0.0, 2.0),
        PathParameter("servo kp", ("actuator:shoulder/kp",), 10.0, 30.0),
    )
    bench, leader = damping_found(believed)
    found = confounds(bench, bench.base, [leader])
    alike = {c.other: c for c in found if c.correlation is not None}
    # It is told as alike or, where the fit has moved it, as changed by the effect.
    (own,) = (c for c in found if c.other == "servo kv")
    assert own.correlation is None or own.correlation > 0.9
    assert own.effect == "viscous_damping@joint:elbow"
    assert "servo kp" not in alike
    assert not any(name.startswith("viscous_damping") for name in alike)
    assert confounds(bench, bench.base, []) == ()


def test_a_believed_number_that_gave_way_is_told() -> None:
    bench, leader = damping_found((PathParameter("elbow inertia", ("joint:elbow/armature",), 0.0, 0.05),))
    before = bench.base.believed[0]
    for step, told in ((0.0, []), (0.0005, []), (0.01, [refit_sentence("elbow inertia", before, before + 0.01)])):
        went = dataclasses.replace(leader.hypothesis, believed=(before + step,))
        found = confounds(bench, bench.base, [dataclasses.replace(leader, hypothesis=went)])
        assert [c.text for c in found if c.correlation is None] == told


def test_words() -> None:
    assert confound_sentence("actuator_gain", "joint:knee", -0.1, 0.97) == (
        "A weaker motor at joint knee would leave almost the same traces (0.97)."
    )
    similar = confound_sentence("backlash", "all", 0.1, 0.91)
    assert similar == "Backlash at all joints would leave similar traces (0.91)."
    assert confound_sentence("servo kv", "", 0.1, 1.0) == "A larger servo kv would leave almost the same traces (1.00)."
    refitted = refit_sentence("knee damping", 0.1, 0.25)
    assert refitted == "The believed knee damping moved from 0.1 to 0.25 when the effect entered."
