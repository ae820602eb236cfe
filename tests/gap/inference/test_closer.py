"""A closer look at what is weak or close: starting states and directions that suit each, shared by all."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gap_arm import arm_windows, dataset

from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Bench, Hypothesis
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.search import closer as module
from btr_mjx.gap.inference.search.closer import closer, shared
from btr_mjx.gap.inference.search.naming import THRESHOLD
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search_records import Judged, Side
from btr_mjx.gap.windows import Options
from btr_mjx.gap.windows.linearisation import differentiate

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "dry_friction", "armature", "actuator_delay"))


def raw(side: Side) -> np.ndarray:
    return (side.windows.raw**2).sum(1)


def test_every_window_is_as_near_to_the_data_as_from_any_known_state() -> None:
    windows = arm_windows()
    found = {c.name: c for c in candidates(windows.models[0], Scales.of(windows.models[0]), EFFECTS)}
    base = Hypothesis((), ())
    offset = base.with_effect(found["joint_offset@joint:elbow"], [0.03])
    damping = base.with_effect(found["viscous_damping@joint:elbow"], [0.05])
    side = Side(windows, Nuisance.nothing(*windows.residual.shape))
    known = [side, side.based(offset).recentred(offset)]
    for h, own in zip((base, offset, damping), shared([base, offset, damping], known), strict=True):
        for other in known:
            assert (raw(own) <= raw(other.based(h)) + 1e-9).all()
        np.testing.assert_array_equal(own.windows.base, own.windows.states([h])[0])
    # Directions are those of the world that found the state: of the damped arm those of differences.
    own = shared([damping], [side])[0].windows
    again = own.copied()
    differentiate(again, damping)
    for w in np.flatnonzero(np.abs(own.qvel - windows.qvel).max(1) > 0):
        lost = again.basis[w] - own.basis[w] @ (own.basis[w].T @ again.basis[w])
        assert np.linalg.norm(lost) < 0.1


def touching(bench: Bench) -> Bench:
    """The same as if something touched."""
    own = copy.copy(bench)
    own.survey, own.options = replace(bench.survey, contact=True), Options(steps=1e7)
    return own


def arm_bench(damping: float) -> Bench:
    def changed(model):
        model.dof_damping[1] += damping

    return Bench(dataset(changed, seed=6, fit=3, test=2), LIBRARY, Options(steps=4e4, leaders=4, contact_leaders=0))


@pytest.fixture(scope="module")
def weak() -> tuple[Bench, list[Judged]]:
    bench = arm_bench(2e-3)
    return touching(bench), Polisher(bench)(bench.find())


def test_what_is_weak_is_compared_with_nothing_on_equal_terms(weak: tuple[Bench, list[Judged]]) -> None:
    bench, judged = weak
    assert judged[0].score < module.WEAK
    out = closer(bench, judged)
    assert {j.name for j in out} == {j.name for j in judged}
    assert [j.score for j in out] == sorted((j.score for j in out), reverse=True)
    old = {id(j) for j in judged}
    looked = [j for j in out if id(j) not in old]
    assert 1 <= len(looked) <= module._MOST
    for one in looked:
        side = one.sides[0]
        assert one.references is looked[0].references
        # What it is compared with: the believed model from whichever of their states suits it best.
        base = bench.nuisance(bench.fit).profile(bench.fit.windows.residual, bench.cut)
        assert one.references[0].loss <= base.loss + 5.0
        own = bench.free(side, one.hypothesis).profile(side.windows.residuals([one.hypothesis])[0], bench.cut)
        assert own.loss == pytest.approx(one.fits[0].loss, rel=1e-6)


@pytest.mark.parametrize("damping", [0.0, 2e-3], ids=["nothing", "something"])
def test_where_nothing_touches_it_finds_what_was_found_before(damping: float, monkeypatch) -> None:
    """Directions are the same in all worlds there: a name stays one, and nothing becomes one."""
    monkeypatch.setattr(module, "_HOPELESS", -30.0)
    bench = arm_bench(damping)
    judged = Polisher(bench)(bench.find())
    before = bench.counter.steps
    out = closer(touching(bench), judged)
    assert bench.counter.steps > before + 1000
    assert [j.name for j in out] == [j.name for j in judged]
    np.testing.assert_allclose([j.score for j in out], [j.score for j in judged], atol=1.0)
    assert (out[0].score > THRESHOLD) == (damping > 0)
    assert damping == 0 or out[0].name == "viscous_damping@joint:elbow"


def standing(judged: Judged, score: float) -> Judged:
    return replace(judged, score=score)


def test_who_is_looked_at(weak: tuple[Bench, list[Judged]], monkeypatch) -> None:
    bench, judged = weak
    a, b, c, d = judged[:4]
    differ = {j.name: 100.0 for j in (b, c, d)}

    def apart(windows, other, states):
        return np.full(8, next(differ[j.name] for j in (b, c, d) if np.array_equal(other, ends[j.name])))

    windows = bench.fit.windows
    ends = {j.name: windows.states([j.hypothesis])[0] for j in (b, c, d)}
    monkeypatch.setattr(module, "apart", apart)

    def chosen(*scores: float, delicate: tuple[str, ...] = ()) -> list[str]:
        own = copy.copy(bench)
        own.delicate = set(delicate)
        rows = [standing(j, s) for j, s in zip((a, b, c, d), scores, strict=False)]
        return [j.name for j in module._chosen(own, rows)]

    assert chosen(30.0, -20.0) == [a.name]  # weak
    assert chosen(-7.0, -20.0) == []  # hopeless
    assert chosen(70.0, 20.0) == []  # neither weak nor close
    assert chosen(70.0, 50.0) == [a.name, b.name]
    assert chosen(300.0, 230.0, 200.0) == [a.name, b.name]  # within a part of the best score
    assert chosen(500.0, 490.0) == []  # strong
    assert chosen(50.0, 40.0, 39.0, 38.0) == [a.name, b.name, c.name]
    moving = (a.name,)
    assert chosen(90.0, 50.0, 40.0, delicate=moving) == [a.name, b.name, c.name]
    assert chosen(900.0, 500.0, 40.0, delicate=moving) == [a.name]
    assert chosen(90.0, 50.0, 40.0, 39.0, delicate=moving) == [a.name, b.name, c.name]
    assert chosen(30.0, 20.0, -20.0, delicate=moving) == [b.name]
    assert chosen(90.0, 80.0, -20.0, delicate=(a.name, b.name)) == [a.name]
    differ[b.name] = 0.5  # as a lag and a delay of a millisecond
    assert chosen(70.0, 60.0) == []
    assert chosen(70.0, 60.0, 55.0) == [a.name, c.name]
    costly = copy.copy(bench)
    costly.options = Options(steps=1.0)
    assert closer(costly, judged) == judged
    nothing = copy.copy(bench)
    nothing.survey = replace(bench.survey, contact=False)
    assert closer(nothing, judged) == judged
    assert closer(bench, []) == []
