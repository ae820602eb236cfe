"""Numbers of what was named, from all recordings, against plain least squares and against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from gap_arm import dataset

from btr_mjx.gap.effects import EFFECTS, Parameter, joint_places
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.finalists import Finalists
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.intervals import intervals
from btr_mjx.gap.windows import Options, window_weight

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature"))
QUICK = Options(steps=4e4, leaders=2, contact_leaders=0)


def damped(model):
    model.dof_damping[1] += 0.1


def found(bench: Bench) -> Judged:
    return next(j for j in Finalists(bench)(bench.find()) if j.name == "viscous_damping@joint:elbow")


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(dataset(damped, seed=4, fit=2, test=2), LIBRARY, QUICK)


def least_squares(bench: Bench, judged: Judged) -> float:
    """Where a fit of all windows on both sides ends, one row after another; what is fitted along is shared."""
    step, hypothesis = 1e-3, judged.hypothesis
    rows, target = [], []
    for i, (side, residual) in enumerate(zip(judged.sides, (judged.refined.residual, judged.residual), strict=True)):
        more = hypothesis.replaced(hypothesis.values(False) + step, False)
        column = judged.refined.columns[0] if i == 0 else (side.windows.residuals([more])[0] - residual) / step
        nuisance = bench.nuisance(side, hypothesis)
        root = np.sqrt(window_weight(judged.fits[i].chi2, bench.cut))
        for w in range(len(residual)):
            for r in range(residual.shape[1]):
                rows.append(root[w] * np.array([column[w, r], *nuisance.columns[w, :, r]]))
                target.append(-root[w] * residual[w, r])
    for i, precision in enumerate(nuisance.precision):
        rows.append(np.sqrt(precision) * (np.arange(len(nuisance.precision) + 1) == i + 1))
        target.append(0.0)
    return float(np.linalg.lstsq(np.array(rows), np.array(target), rcond=None)[0][0])


def test_numbers_come_from_all_recordings(bench: Bench) -> None:
    judged = found(bench)
    before = judged.hypothesis.effects[0][1][0]
    (after,) = intervals(bench, judged, np.random.default_rng(0))
    step = least_squares(bench, judged)
    assert abs(step) > 1e-5
    assert after.value - before == pytest.approx(step, rel=0.08)
    assert after.low < 0.1 < after.high
    assert after.low < after.value < after.high


def test_a_step_that_true_simulation_refuses_is_not_taken(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    judged = found(bench)
    monkeypatch.setattr("btr_mjx.gap.inference.verdict.intervals._SHARES", (-1.0, -0.4))
    (same,) = intervals(bench, judged, np.random.default_rng(0))
    assert same.value == judged.hypothesis.effects[0][1][0]


def test_what_does_not_show_stays_where_it_is() -> None:
    """Its hundredth of a millionth of a spring would be driven to a bound otherwise, as rounding can be."""
    damping = LIBRARY[0]
    assert damping.name == "viscous_damping"

    def parameters(model, scales, place):
        return (*damping.parameters(model, scales, place), Parameter("side", "1", -0.3, 0.3, 0.05, shape=True))

    def apply(world, place, values):
        damping.apply(world, place, values[:1])
        world.model.jnt_stiffness[0] = 1e-8 * values[1]

    with_spring = replace(damping, places=joint_places, parameters=parameters, apply=apply)
    bench = Bench(dataset(damped, seed=4, fit=2, test=2), (with_spring,), QUICK)
    judged = found(bench)
    columns = judged.refined.columns
    assert np.linalg.norm(columns[0]) > 1.0
    assert not columns[1].any()
    size, side = intervals(bench, judged, np.random.default_rng(0))
    assert size.value == pytest.approx(0.1, rel=0.1)
    assert (side.low, side.value, side.high) == (-0.3, 0.0, 0.3)
