"""Which candidates are looked at closely, and from where."""

import copy
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from gap_arm import arm, dataset
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.inference.scoring.scanner import Lead
from btr_mjx.gap.inference.scoring.screening import Entry
from btr_mjx.gap.inference.search import contact_leaders
from btr_mjx.gap.inference.search.contact_leaders import contact_scan, with_contacts
from btr_mjx.gap.inference.search.leaders import pick, starts
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.inference.search.walks import vertex
from btr_mjx.gap.windows import Options

OFFSETS = tuple(effect for effect in EFFECTS if effect.name in ("joint_offset", "armature"))
QUICK = Options(steps=4e4, leaders=2, contact_leaders=0)


def raised(model, angle=0.02):
    """Links that hang at another angle [rad] than believed: what an encoder's offset looks like, roughly."""
    model.body_quat[2] = [np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(dataset(raised, seed=4, fit=3, test=1), OFFSETS, QUICK)


@pytest.mark.parametrize(("every", "angle"), [(1, 0.02), (2, 0.02), (1, 0.12)])
def test_a_scan_of_contacts_is_a_loop_over_candidates(
    bench: Bench, every: int, angle: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contact_leaders, "_BEST", 1)  # all go further, whoever is judged anew
    if angle > 0.02:
        bench = Bench(dataset(partial(raised, angle=angle), seed=4, fit=3, test=1), OFFSETS, QUICK)
    moving = [c for c in bench.candidates if c.effect.name == "joint_offset"]
    windows = copy.copy(bench.fit.windows)
    windows.stride = 1
    side = Side(windows, bench.free(bench.fit))
    residual = windows.residual
    found = contact_scan(side, bench.base, moving, bench.cut, residual, every)
    assert [gain for gain, _, _ in found] == sorted((gain for gain, _, _ in found), reverse=True)

    def gain(candidate, value, index):
        some = side.some(index)
        before = some.nuisance.profile(residual[index], bench.cut)
        after = some.windows.residuals([bench.base.with_effect(candidate, [value])])[0]
        return robust_gain(before, some.nuisance.profile(after, bench.cut), bench.cut)

    few = np.arange(len(residual))[::every]
    share = len(few) / len(residual)
    firsts = {c.name: c.parameters[0] for c in moving}
    for best, candidate, values in found:
        step = firsts[candidate.name].step
        once = {sign: gain(candidate, sign * step, few) / share for sign in (1, -1)}
        sign = max(once, key=lambda s: once[s])
        tried = {1.0: once[sign]}
        for factor in (3.0, 9.0, 27.0):
            tried[factor] = gain(candidate, factor * sign * step, few) / share
            if tried[factor] <= max(tried[factor / 3.0], 100.0):
                break
        factor = max(tried, key=lambda f: tried[f])
        assert best == pytest.approx(tried[factor], rel=1e-5, abs=1e-3)
        np.testing.assert_allclose(values, [factor * sign * step])
    assert found[0][0] > 20  # something is there to be found
    assert abs(found[0][2][0]) > 0.4 * angle  # and a large one far enough
    coarse = copy.copy(windows)
    coarse.stride = 2
    longer = contact_scan(Side(coarse, side.nuisance), bench.base, moving, bench.cut, residual, every)
    assert [c.name for _, c, _ in longer] == [c.name for _, c, _ in found]
    np.testing.assert_allclose([gain for gain, _, _ in longer], [gain for gain, _, _ in found], rtol=0.05, atol=5.0)


def test_a_limit_brings_those_of_its_group_along() -> None:
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    names = [("torque_limit@actuator:elbow", 90.0, True), ("viscous_damping@joint:elbow", 80.0, False)]
    names += [("armature@joint:elbow", 70.0, False), ("torque_limit@actuator:shoulder", 5.0, True)]
    names += [("torque_limit@all", -1.0, True)]  # in the linear picture the other motors speak against it
    entries = [Entry(known[name], np.ones(len(known[name].parameters)), probe) for name, _, probe in names]
    leads = [Lead(i, gain, known[name].null + 1.0) for i, (name, gain, _) in enumerate(names) if gain > 0]
    picked = pick(leads, entries, Options(leaders=1), 10.0)
    assert set(picked) == {"torque_limit@actuator:elbow", "torque_limit@all"}
    (group,) = picked["torque_limit@all"]
    assert entries[group.index].candidate.name == "torque_limit@all"
    np.testing.assert_array_equal(group.values, leads[0].values)
    # One that is not worth its price brings nobody: a robot that never comes near a limit says nothing of groups.
    assert set(pick(leads, entries, Options(leaders=1), 100.0)) == {"torque_limit@actuator:elbow"}


def test_an_effect_that_leads_at_several_places_is_tried_at_all_of_them() -> None:
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    names = [f"dry_friction@{place}" for place in ("joint:elbow", "joint:shoulder", "all")] + ["armature@joint:elbow"]
    entries = [Entry(known[name], np.ones(1)) for name in names]
    leads = [Lead(i, gain, np.array([gain])) for i, gain in enumerate([90.0, 70.0, -50.0, 80.0])]
    picked = pick(leads, entries, Options(leaders=3), 10.0)
    assert set(picked) == set(names)
    assert 90.0 in [lead.values[0] for lead in picked["dry_friction@all"]]
    assert set(pick(leads, entries, Options(leaders=2), 10.0)) == {names[0], names[3]}  # one place says nothing of all
    assert set(pick(leads, entries, Options(leaders=3), 80.0)) == {names[0], names[1], names[3]}  # the other is chance
    ahead = [leads[0], leads[1], Lead(2, 100.0, np.ones(1))]
    assert len(pick(ahead, entries, Options(leaders=3), 10.0)["dry_friction@all"]) == 1  # it leads by itself
    assert set(pick(leads[:2], entries[:2], Options(), 10.0)) == set(names[:2])  # there is no such group


def test_a_limit_that_the_simulation_never_reaches_is_tried_where_all_is_far_away() -> None:
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    names = ["load_friction@joint:elbow", "torque_limit@actuator:elbow", "torque_limit@actuator:shoulder"]
    entries = [Entry(known[name], -0.1 * known[name].null - 0.01, name.startswith("torque")) for name in names]
    leads = [Lead(0, 90.0, known[names[0]].null + 0.1)]
    assert set(pick(leads, entries, Options(leaders=2), 10.0)) == {names[0]}
    picked = pick(leads, entries, Options(leaders=2), 10.0, far=True)
    assert set(picked) == set(names[:2])
    tried = starts(picked[names[1]], lambda lead: entries[lead.index])
    first = known[names[1]].parameters[0]
    share = (np.concatenate(tried) - first.null) / (first.low - first.null)
    assert share.max() > 0.95
    assert np.all((share > 0) & (share < 1))
    fewer = starts(picked[names[1]], lambda lead: entries[lead.index], every=2)
    np.testing.assert_array_equal(fewer[0], tried[0])
    np.testing.assert_array_equal(fewer[1:], tried[1::2])


def test_single_motors_have_no_clocks_of_their_own() -> None:
    known = {c.name: c.parameters[0] for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    assert known["actuator_delay@actuator:elbow"].low == 0.0
    assert known["actuator_delay@all"].low < 0.0


@pytest.mark.parametrize("effect", ["actuator_delay", "actuator_lag"])
def test_late_commands_are_counted_from_a_part_of_a_time_step(effect: str) -> None:
    model = arm()
    for step in (1e-3, 4e-3):
        model.opt.timestep = step
        found = [c.parameters[0] for c in candidates(model, Scales.of(model), EFFECTS) if c.effect.name == effect]
        assert len(found) > 1
        assert {parameter.negligible for parameter in found} == {step / 4}


@given(st.floats(0.7, 1.45), st.floats(0.5, 50.0), st.floats(-100.0, 100.0))
def test_a_walk_ends_where_a_parabola_peaks(peak: float, steep: float, height: float) -> None:
    known = {factor: height - steep * (factor - peak) ** 2 for factor in (1 / 1.5, 1.0, 1.5)}
    if max(known, key=lambda factor: known[factor]) == 1.0:
        assert vertex(known) == pytest.approx(peak, abs=1e-6)
    else:
        assert vertex(known) in known


def test_a_walk_that_still_climbs_ends_at_its_end() -> None:
    assert vertex({1.0: 3.0, 1.5: 7.0, 2.25: 9.0}) == 2.25
    assert vertex({1.0: 3.0}) == 1.0


def test_a_scan_of_contacts_adds_the_best_few_and_more_starts() -> None:
    a, b, c, d = (SimpleNamespace(name=name) for name in "abcd")
    tries = [(a, [np.array([1.0])])]
    found = [
        (9.0, b, np.array([2.0])),
        (8.0, c, np.array([3.0])),
        (7.0, a, np.array([4.0])),
        (-1.0, d, np.array([5.0])),
    ]
    out = {one.name: [float(v[0]) for v in values] for one, values in with_contacts(tries, found, 1)}
    assert out == {"a": [1.0, 4.0], "b": [2.0]}
    assert [one.name for one, _ in with_contacts(tries, found, 9)] == [
        "a",
        "b",
        "c",
    ]  # what is worse than nothing never
    assert [len(values) for _, values in tries] == [1]
