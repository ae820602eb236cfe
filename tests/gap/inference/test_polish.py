"""Leaders judged again: every window with the starting state that suits it, compared on equal terms."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from gap_arm import arm_windows, dataset
from gap_judged import falls

from btr_mjx.gap.effects import EFFECTS, WORLD
from btr_mjx.gap.inference import Bench, nearest
from btr_mjx.gap.inference.scoring.gains import robust_gain, trimmed_gain
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.inference.search.exchange import beside_the_best
from btr_mjx.gap.inference.search.polish import Polisher
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
    made = [first, first.recentred(damped(0.02)), first.recentred(damped(0.2)).redirected(damped(0.2))]
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

    return Bench(dataset(changed, seed=4, fit=3, test=1), LIBRARY, Options(steps=4e4, leaders=2, contact_leaders=0))


def test_leaders_share_their_starting_states(bench: Bench) -> None:
    """No window of a leader lies nearer with the starting states of the believed model, or of the other leader."""
    before = bench.find()
    leaders = Polisher(bench).again([j.hypothesis for j in before[:2]], None)
    assert [j.name for j in leaders] == [j.name for j in before[:2]]
    assert leaders[0].references == leaders[1].references
    for i, own in enumerate((bench.fit, bench.test)):
        pool = [own, leaders[0].sides[i], leaders[1].sides[i]]
        for judged in leaders:
            raw = [(side.based(judged.hypothesis).windows.raw ** 2).sum(1) for side in pool]
            mine = (judged.sides[i].based(judged.hypothesis).windows.raw ** 2).sum(1)
            assert mine.sum() <= min(r.sum() for r in raw) + (0.01 if i else 0.5)  # refined after the choice


def test_rivals_differ_by_what_tells_them_apart(bench: Bench) -> None:
    """Window by window between the two of them; the better one keeps its score."""
    before = bench.find()
    polish = Polisher(bench)
    leaders = polish.again([j.hypothesis for j in before[:2]], None)
    best, other = sorted(leaders, key=lambda j: -j.score)
    alone = bench.judge([best.hypothesis], [best.refined], best.sides, best.references)[0]
    assert best.score == pytest.approx(alone.score)
    parts = [robust_gain(b, a, bench.cut) / bench.dispersion for a, b in zip(best.fits, other.fits, strict=True)]
    assert best.gain - other.gain == pytest.approx(parts[0])
    assert best.held_out - other.held_out == pytest.approx(parts[1])
    assert best.hypothesis.numbers == other.hypothesis.numbers
    assert best.score - other.score == pytest.approx(sum(parts))


def test_between_rivals_that_move_contacts_few_windows_say_nothing(bench: Bench) -> None:
    before = bench.find()
    leaders = Polisher(bench).again([j.hypothesis for j in before[:2]], None)
    touching = copy.copy(bench)
    touching.delicate = {j.name for j in leaders}
    best, other = sorted(beside_the_best(touching, leaders), key=lambda j: -j.score)
    parts = [trimmed_gain(b, a, bench.cut) / bench.dispersion for a, b in zip(best.fits, other.fits, strict=True)]
    assert best.score - other.score == pytest.approx(sum(parts))
    touching.delicate = {best.name}
    best, other = sorted(beside_the_best(touching, leaders), key=lambda j: -j.score)
    parts = [robust_gain(b, a, bench.cut) / bench.dispersion for a, b in zip(best.fits, other.fits, strict=True)]
    assert best.score - other.score == pytest.approx(sum(parts))


def test_one_more_effect_is_compared_with_what_was_found(bench: Bench) -> None:
    """Its gains are those of the first, and what falls from there to it on the same windows."""
    first = Polisher(bench)(bench.find())[0]
    second = bench.find(first)[0]
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
    own.delicate = {elbow.name}

    def judged(size):
        hypothesis = own.base.with_effect(elbow, [size])
        side = own.fit.recentred(hypothesis)
        return own.fall(reference, own.free(side).profile(side.windows.residual, own.cut))

    reference = own.free(own.fit).profile(own.fit.windows.residual, own.cut)
    sizes = np.linspace(-0.04, 0.04, 41)
    best = sizes[int(np.argmax([judged(size) for size in sizes]))]
    assert abs(best) > 0.01
    for start in (0.67 * best, 1.33 * best):
        hypothesis = own.base.with_effect(elbow, [start])
        found, (side,) = best_size(own, hypothesis, [own.fit.recentred(hypothesis)], [reference])
        assert found.effects[0][1][0] == pytest.approx(best, rel=0.15)  # the time step is not looked at again
        np.testing.assert_allclose(side.windows.residuals([found])[0], side.windows.residual, atol=1e-9)


def test_an_effect_beside_another_ends_where_the_search_ends(bench: Bench) -> None:
    polish = Polisher(bench)
    first = polish(bench.find())[0]
    second = polish(bench.find(first), 1, first)[0]
    candidate, values = second.hypothesis.effects[-1]
    found = polish.beside(first, first.hypothesis.with_effect(candidate, [0.7 * value for value in values]))
    assert found.name == second.name
    assert found.hypothesis.effects[-1][1] == pytest.approx(values, rel=0.05)
    assert found.score == pytest.approx(second.score, rel=0.02)


def test_all_that_were_judged_come_back_best_first(bench: Bench) -> None:
    before = bench.find()
    again = Polisher(bench)(before)
    assert {j.name for j in again} == {j.name for j in before}
    assert [j.score for j in again] == sorted((j.score for j in again), reverse=True)
    assert any(j not in before for j in again)
    assert Polisher(bench)([]) == []


def stand_in(name, score, gain=None):
    effects = [(SimpleNamespace(name=letter, place=None), (1.0,)) for letter in name]
    hypothesis = SimpleNamespace(effects=effects, name=name)
    return SimpleNamespace(name=name, score=score, gain=score if gain is None else gain, hypothesis=hypothesis)


class Walked(dict):
    """Gains of single effects with directions of their own; a walk ends where it begins."""

    def best(self, name):
        return self.get(name, -np.inf)

    def gain(self, hypothesis):
        return 0.0

    def __call__(self, hypothesis, hope, promise):
        return hypothesis


def bench_of(delicate: str, **more) -> SimpleNamespace:
    """A bench on which little has been spent, as far as a choice of candidates needs one."""
    return SimpleNamespace(delicate=set(delicate), costly=lambda: False, **more)


@pytest.mark.parametrize(
    ("given", "score", "alone", "tried"),
    [
        ("a", {"ab": 505.0}, {}, "ab"),
        ("a", {"ab": 499.0}, {}, ""),  # worth less than its price
        ("a", {"ab": 505.0, "ac": 504.0}, {}, "ab"),  # one at a time
        ("a", {"am": 620.0}, {}, "am"),
        ("a", {"am": 520.0}, {}, ""),  # contacts cost more to look at
        ("a", {"am": 520.0}, {"m": 300.0}, "am"),  # the first one hides it as long as directions are not its own
        ("a", {"ab": 505.0, "am": 400.0}, {"m": 300.0}, "ab am"),
        ("n", {"nm": 520.0}, {"m": 300.0}, ""),  # a rival of the first one, which explains the same
    ],
)
def test_who_is_worth_another_look_beside_an_effect(given, score, alone, tried) -> None:
    polish = Polisher(bench_of("mn", walks=Walked(alone), hopes_beside={}))
    judged = [stand_in(name, value) for name, value in score.items()]
    found = [own.name for own, _ in polish._promising(judged, 1, stand_in(given, 500.0))]
    assert " ".join(found) == tried
    polish._done |= set(found)
    assert polish._promising(judged, 1, stand_in(given, 500.0)) == []


@pytest.mark.parametrize(
    ("hopes", "tried"),
    [
        ({"c": 1.0, "b": 4.9}, "ab"),  # worse than nothing from starting states that suit the first effect alone
        ({"c": 1.0, "b": 1.4}, ""),  # not worth much in the linear picture either
        ({"c": 5.0, "b": 4.9}, "ac"),
        ({"m": 5.0, "b": 4.9}, ""),  # of what moves contacts the linear picture says little
    ],
)
def test_what_leads_the_scan_beside_an_effect_is_looked_at_with_starting_states_of_its_own(hopes, tried) -> None:
    polish = Polisher(bench_of("mn", walks=Walked({}), hopes_beside=hopes))
    judged = [stand_in(name, score) for name, score in (("am", 480.0), ("ab", 471.0), ("ac", 420.0))]
    found = [own.name for own, _ in polish._promising(judged, 1, stand_in("a", 500.0))]
    assert " ".join(found) == tried


@pytest.mark.parametrize(("place", "walked", "tried"), [(WORLD, 46.0, "m"), (None, 46.0, ""), (None, 70.0, "m")])
def test_the_ground_is_worth_another_look_for_less_than_a_limb(place, walked, tried) -> None:
    """It leads the scan of contacts and is worse than nothing with the believed model's directions."""

    class Walking(Walked):
        def __call__(self, hypothesis, hope, promise):
            return hypothesis if walked > max(hope, promise) else None

    polish = Polisher(bench_of("m", walks=Walking({"m": walked}), hopes={}))
    judged = [stand_in("a", 12.0), stand_in("m", -139.0, 27.0)]
    judged[1].hypothesis.effects[-1][0].place = place
    found = [own.name for own, _ in polish._promising(judged, 0, None)]
    assert " ".join(found) == tried


def test_the_best_change_of_the_ground_is_judged_with_care_once(monkeypatch) -> None:
    """Not what moves one limb, nor what moves no contacts, nor what was judged before."""
    polish = Polisher(bench_of("mgh"))
    judged = [stand_in("a", 12.0), stand_in("m", 5.0), stand_in("g", -20.0), stand_in("h", -30.0)]
    for j in judged:
        j.hypothesis.effects[-1][0].place = WORLD if j.name in "agh" else None
    monkeypatch.setattr(polish, "again", lambda tried, given: [stand_in(h.name, 50.0) for h in tried])
    assert [(j.name, j.score) for j in polish.ground(judged)] == [("g", 50.0), ("a", 12.0), ("m", 5.0), ("h", -30.0)]
    polish._done.add("h")
    assert polish.ground(judged) == judged


def test_the_best_of_what_was_walked_over_are_judged_again() -> None:
    gains = {"m": 300.0, "n": 900.0, "o": 500.0, "p": 700.0}
    polish = Polisher(bench_of("mnop", walks=Walked(gains), hopes={}))
    judged = [stand_in(name, 600.0 - i) for i, name in enumerate("mnop")]
    assert [own.name for own, _ in polish._promising(judged, 3, None)] == ["n", "p", "o"]
    gains |= {"o": 800.0, "p": 790.0, "m": 780.0}
    polish.bench.walks = Walked(gains)
    assert [own.name for own, _ in polish._promising(judged, 3, None)] == ["n", "o", "p", "m"]  # all as good
    polish.bench.costly = lambda: True
    assert [own.name for own, _ in polish._promising(judged, 3, None)] == ["n", "o", "p"]


@pytest.mark.parametrize(("score", "gain", "tried"), [(49.0, 30.0, "n"), (51.0, 30.0, "m n"), (30.0, 61.0, "m n")])
def test_a_leader_that_is_sure_is_not_given_up_for_what_a_walk_sees(score, gain, tried) -> None:
    """Whether its gain is in the recordings to fit or in those held out."""

    class Walking(Walked):
        def __call__(self, hypothesis, hope, promise):
            return hypothesis if hypothesis.name == "n" else None

    polish = Polisher(bench_of("mn", walks=Walking({"m": 20.0, "n": 90.0}), hopes={}))
    judged = [stand_in("m", score, gain), stand_in("n", 20.0, 15.0)]
    assert sorted(own.name for own, _ in polish._promising(judged, 3, None)) == tried.split()


def test_what_gained_before_its_walk_need_not_gain_at_its_first_step() -> None:
    """With directions of its own two thirds of the truth may say nothing, where all of it says most."""

    class Walking(Walked):
        def __call__(self, hypothesis, hope, promise):
            asked[hypothesis.name] = hope
            return hypothesis

    for gain, free in ((300.0, True), (240.0, False)):
        asked = dict[str, float]()
        polish = Polisher(bench_of("mn", walks=Walking({"m": 900.0, "n": 400.0}), hopes={}))
        polish._promising([stand_in("m", 1000.0), stand_in("n", 200.0, gain)], 3, None)
        assert (asked["n"] < 50.0) is free


def test_one_more_effect_gets_half_and_less_where_the_first_has_cost_much() -> None:
    options = Options(steps=1e5, leaders=6, contact_leaders=4, every=2)
    assert options.fewer(False) == Options(steps=1e5, leaders=3, contact_leaders=2, every=4)
    assert options.fewer(True) == Options(steps=1e5, leaders=2, contact_leaders=1, iterations=2, every=8, starts=2)
    assert Options(leaders=1).fewer(False).leaders == 1
    assert not options.over_budget(145_000, 20)
    assert options.over_budget(165_000, 20)
    assert not options.over_budget(180_000, 10)  # small models step faster
