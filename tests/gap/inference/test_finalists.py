"""Leaders judged again: every window with the starting state that suits it, compared on equal terms."""

import numpy as np
import pytest
from gap_arm import arm_windows, dataset
from gap_judged import falls

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, nearest
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.search.finalists import Finalists
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.inference.search.sizes import best_size
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Options, Windows

LIBRARY = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature", "actuator_gain", "joint_offset"))


def damped(size):
    def make(model):
        world = World.of(model)
        world.model.dof_damping[:] += size
        return world

    return make


@pytest.fixture(scope="module")
def windows() -> Windows:
    return arm_windows()


def sides_of(windows: Windows) -> list[Side]:
    """Starting states that suit three worlds, all with the second one as base; the last has directions of its own."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((2, *windows.residual.shape)).astype(np.float32)
    first = Side(windows, Nuisance.of(columns, np.ones(2)))
    made = [
        first,
        first.with_fitted_states(damped(0.02)),
        first.with_fitted_states(damped(0.2)).with_own_directions(damped(0.2)),
    ]
    return [side.based(damped(0.02)) for side in made]


def test_another_base_from_the_same_starting_states(windows: Windows) -> None:
    based = windows.based(damped(0.02))
    np.testing.assert_array_equal(based.residual, windows.residuals([damped(0.02)])[0])
    np.testing.assert_array_equal(based.base, windows.states([damped(0.02)])[0])
    assert np.abs(based.residual - windows.residual).max() > 0.1


def test_windows_of_several_sides_are_those_of_each(windows: Windows) -> None:
    sides = sides_of(windows)
    chosen = np.array([2, 0, 1, 2])
    mixed = sides[0].mixed(sides[1:], chosen)
    for w, k in enumerate(chosen):
        own = sides[k]
        for name in ("qpos", "qvel", "base", "residual", "basis", "correction", "inverse", "target_q"):
            np.testing.assert_array_equal(getattr(mixed.windows, name)[w], getattr(own.windows, name)[w])
        np.testing.assert_array_equal(mixed.nuisance.columns[w], own.nuisance.columns[w])
        np.testing.assert_array_equal(mixed.nuisance.gram[w], own.nuisance.gram[w])
    np.testing.assert_allclose(mixed.windows.residuals([damped(0.02)])[0], mixed.windows.residual, atol=1e-12)
    plain = sides[0].mixed(sides[1:2], np.array([0, 1, 1, 0]))
    assert plain.windows.basis is windows.basis  # directions that are shared stay the same array
    assert plain.nuisance is sides[0].nuisance


def test_the_nearest_is_chosen_window_by_window(windows: Windows) -> None:
    """Against a loop over windows and sides, each window simulated alone."""
    sides = sides_of(windows)
    best = nearest(sides)
    picked = set()
    for w in range(len(windows)):
        away = []
        for side in sides:
            own = side.windows.some(np.array([w]))
            there = own.whiten(own.states([damped(0.02)])[0]) + own.correction
            away.append(float((there**2).sum()))
        picked.add(int(np.argmin(away)))
        assert (best.windows.raw[w] ** 2).sum() == pytest.approx(min(away))
    assert len(picked) > 1


@pytest.fixture(scope="module")
def bench() -> Bench:
    def changed(model):
        model.dof_damping[1] += 0.1
        model.dof_armature[0] += 0.02

    return Bench(dataset(changed, seed=4, fit=3, test=1), LIBRARY, Options(steps=4e4, leaders=4, contact_leaders=0))


def test_leaders_share_their_starting_states(bench: Bench) -> None:
    """No window of a leader lies nearer with the starting states of the believed model, or of the other leader."""
    before = [j for j in bench.find() if j.hypothesis.numbers == 1]
    leaders = Finalists(bench).again([j.hypothesis for j in before[:2]], None)
    assert [j.name for j in leaders] == [j.name for j in before[:2]]
    assert leaders[0].references == leaders[1].references
    for i, own in enumerate((bench.fit, bench.test)):
        pool = [own, leaders[0].sides[i], leaders[1].sides[i]]
        for judged in leaders:
            raw = [(side.based(judged.hypothesis).windows.raw ** 2).sum(1) for side in pool]
            mine = (judged.sides[i].based(judged.hypothesis).windows.raw ** 2).sum(1)
            assert mine.sum() <= min(r.sum() for r in raw) + (0.01 if i else 0.5)  # refined after the choice


def test_one_more_effect_is_compared_with_what_was_found(bench: Bench) -> None:
    """Its gains are those of the first, and what falls from there to it on the same windows."""
    first = Finalists(bench)([j for j in bench.find() if j.hypothesis.numbers == 1])[0]
    second = next(j for j in bench.find(first) if j.hypothesis.numbers == 2)
    names = {candidate.name for candidate, _ in second.hypothesis.effects}
    assert names == {"viscous_damping@joint:elbow", "armature@joint:shoulder"}
    fit, test = falls(bench, first.sides, first.hypothesis, second.hypothesis)
    assert second.gain == pytest.approx(first.gain + fit, rel=1e-6)
    assert second.held_out == pytest.approx(first.held_out + test, rel=1e-6)
    price = (first.gain + first.held_out - first.score) / first.hypothesis.numbers
    assert second.score == pytest.approx(second.gain + second.held_out - 2 * price)
    assert min(fit, test) > 10


def test_a_size_that_is_off_is_mended_on_all_windows() -> None:
    """From two thirds and from four thirds of it to where a scan of all sizes is best."""

    def turned(model):
        model.body_quat[2] = [np.cos(0.01), 0.0, np.sin(0.01), 0.0]

    own = Bench(dataset(turned, seed=4, fit=3, test=1), LIBRARY, Options(steps=4e4, leaders=2, contact_leaders=0))
    elbow = next(c for c in own.candidates if c.name == "joint_offset@joint:elbow")
    own.contact_sensitive = {elbow.name}

    def judged(size):
        hypothesis = own.base.with_effect(elbow, [size])
        side = own.fit.with_fitted_states(hypothesis)
        return own.fall(reference, own.free(side).profile(side.windows.residual, own.cut))

    reference = own.free(own.fit).profile(own.fit.windows.residual, own.cut)
    sizes = np.linspace(-0.04, 0.04, 41)
    best = sizes[int(np.argmax([judged(size) for size in sizes]))]
    assert abs(best) > 0.01
    for start in (0.67 * best, 1.33 * best):
        hypothesis = own.base.with_effect(elbow, [start])
        found, side = best_size(own, hypothesis, own.fit.with_fitted_states(hypothesis), reference)
        assert found.effects[0][1][0] == pytest.approx(best, rel=0.15)  # the time step is not looked at again
        np.testing.assert_allclose(side.windows.residuals([found])[0], side.windows.residual, atol=1e-9)


def test_an_effect_beside_another_ends_where_the_search_ends(bench: Bench) -> None:
    finalists = Finalists(bench)
    first = finalists(bench.find())[0]
    second = finalists(bench.find(first), 1, first)[0]
    candidate, values = second.hypothesis.effects[-1]
    found = finalists.beside(first, first.hypothesis.with_effect(candidate, [0.7 * value for value in values]))
    assert found.name == second.name
    assert found.hypothesis.effects[-1][1] == pytest.approx(values, rel=0.05)
    assert found.score == pytest.approx(second.score, rel=0.02)


def test_all_that_were_judged_come_back_best_first(bench: Bench) -> None:
    before = bench.find()
    again = Finalists(bench)(before)
    assert {j.name for j in again} == {j.name for j in before}
    assert [j.score for j in again] == sorted((j.score for j in again), reverse=True)
    assert any(j not in before for j in again)
    assert Finalists(bench)([]) == []


def test_one_more_effect_gets_half() -> None:
    options = Options(steps=1e5, leaders=6, contact_leaders=4, every=2)
    assert options.fewer() == Options(steps=1e5, leaders=3, contact_leaders=2, every=4)
    assert Options(leaders=1).fewer().leaders == 1


def test_small_models_step_faster() -> None:
    options = Options(steps=1e5)
    assert options.budget(20) == options.budget(30) == 1e5
    assert options.budget(10) == pytest.approx(2e5)
    assert options.budget(1) == pytest.approx(3.2e5)
