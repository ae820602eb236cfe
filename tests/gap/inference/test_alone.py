"""Two effects held against the first of them with the number that it has beside the second."""

import numpy as np
import pytest
from gap_arm import dataset
from gap_judged import falls

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.alone import alone
from btr_mjx.gap.inference.search.naming import SECOND_THRESHOLD, accepted
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.windows import Options

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature"))


def bench_of(armature: float) -> Bench:
    """An arm whose elbow is damped by 0.1 N m s/rad more, and whose shoulder has more inertia."""

    def changed(model):
        model.dof_damping[1] += 0.1
        model.dof_armature[0] += armature

    return Bench(dataset(changed, seed=4, fit=3, test=1), LIBRARY, Options(steps=4e4, leaders=2, contact_leaders=0))


def with_a_number_off(bench: Bench) -> tuple[Judged, Judged]:
    """The damping alone at half its size, as it was not refined, and with an armature beside it, both refined."""
    damping, armature = (
        next(c for c in bench.candidates if c.name == name)
        for name in ("viscous_damping@joint:elbow", "armature@joint:shoulder")
    )
    off = bench.base.with_effect(damping, [0.05])
    reference, sides = bench.reference[0], (bench.fit, bench.test)
    found = bench.refined(bench.fit, [(off, [np.array([0.05])])], [0], reference)
    first = bench.judge([off], found, sides)[0]
    pair = off.with_effect(armature, [0.001])
    found = bench.refined(bench.fit, [(pair, [np.array([0.05, 0.001])])], [4], reference)
    pair = pair.replaced(found[0].values, bench.joint)
    return first, bench.judge([pair], found, sides, bench.reference, first)[0]


def test_what_led_the_first_number_to_a_better_place_is_nothing_beside_it() -> None:
    bench = bench_of(0.0)
    first, both = with_a_number_off(bench)
    assert both.score - first.score > 4 * SECOND_THRESHOLD
    better, beside = alone(bench, both)
    assert better.name == first.name
    assert better.score > first.score
    assert better.hypothesis.effects[0][1][0] == pytest.approx(0.1, rel=0.1)
    assert beside.name == both.name
    assert beside.score - better.score < SECOND_THRESHOLD
    assert not accepted(bench, beside, better)


def test_what_is_there_remains_so_beside_the_best_number_of_the_first() -> None:
    bench = bench_of(0.02)
    first, both = with_a_number_off(bench)
    better, beside = alone(bench, both)
    assert better.score > first.score
    assert accepted(bench, beside, better)
    fit, test = falls(bench, both.sides, better.hypothesis, both.hypothesis)
    assert beside.gain - better.gain == pytest.approx(fit, rel=1e-6)
    assert beside.held_out - better.held_out == pytest.approx(test, rel=1e-6)
    assert beside.score - better.score > SECOND_THRESHOLD
