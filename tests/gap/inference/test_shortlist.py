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
from btr_mjx.gap.inference.search.contact_scan import contact_scan, with_contacts
from btr_mjx.gap.inference.search.line_search import vertex
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.inference.search.shortlist import pick, starts
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
def test_a_scan_of_contacts_is_a_loop_over_candidates(bench: Bench, every: int, angle: float) -> None:
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
    np.testing.assert_allclose([gain for gain, _, _ in longer], [gain for gain, _, _ in found], rtol=0.3, atol=5.0)


def test_the_best_leads_are_refined_and_the_best_limit_beside_them() -> None:
    """What a lead is worth is its gain less the price of its numbers; a limit looks like a weak motor from afar."""
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    rows = [("viscous_damping@joint:elbow", 80.0, False), ("payload@body:lower", 100.0, False)]
    rows += [("armature@joint:elbow", 75.0, False), ("torque_limit@actuator:elbow", 40.0, True)]
    rows += [("torque_limit@actuator:shoulder", 5.0, True)]
    entries = [Entry(known[name], np.ones(len(known[name].parameters)), probe) for name, _, probe in rows]
    leads = [Lead(i, gain, known[name].null + 1.0) for i, (name, gain, _) in enumerate(rows)]
    numbers = len(known["payload@body:lower"].parameters)
    assert numbers > 1

    def picked(leaders: int, price: float) -> list[str]:
        return list(pick(leads, entries, Options(leaders=leaders), price))

    assert picked(1, 0.0) == ["payload@body:lower", "torque_limit@actuator:elbow"]
    assert picked(1, 21.0 / (numbers - 1)) == ["viscous_damping@joint:elbow", "torque_limit@actuator:elbow"]
    assert picked(3, 0.0) == [rows[i][0] for i in (1, 0, 2, 3)]
    assert picked(4, 0.0) == picked(3, 0.0)  # a limit that leads by itself brings no other
    assert picked(5, 0.0) == [row[0] for row in (rows[1], rows[0], *rows[2:])]
    assert list(pick(leads[:3], entries, Options(leaders=1), 0.0)) == ["payload@body:lower"]


def test_a_leader_starts_from_its_three_best_leads_probes_first() -> None:
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    limit = known["torque_limit@actuator:elbow"]
    entries = [Entry(limit, -np.ones(1), probe) for probe in (False, True, True, True)]
    leads = [Lead(i, gain, np.array([gain])) for i, gain in enumerate((90.0, 10.0, 30.0, 20.0))]
    (own,) = pick(leads, entries, Options(leaders=1), 10.0).values()
    assert [lead.gain for lead in own] == [30.0, 20.0, 10.0]
    (own,) = pick(leads[:2], entries, Options(leaders=1), 10.0).values()
    assert [lead.gain for lead in own] == [10.0, 90.0]


def test_a_limit_is_refined_from_all_the_way_to_its_tightest() -> None:
    known = {c.name: c for c in candidates(arm(), Scales.of(arm()), EFFECTS)}
    limit, friction = known["torque_limit@actuator:elbow"], known["load_friction@joint:elbow"]
    entries = [Entry(limit, -0.1 * limit.null - 0.01, True), Entry(friction, np.ones(1))]
    first = limit.parameters[0]
    lead = Lead(0, 90.0, limit.null - 0.01)
    own, *further = starts([lead], lambda one: entries[one.index])
    np.testing.assert_array_equal(own, lead.values)
    share = (np.concatenate(further) - first.null) / (first.low - first.null)
    assert share.max() > 0.95
    assert np.all((share > 0) & (share < 1))
    plain = Lead(1, 90.0, friction.null + 0.1)
    (only,) = starts([plain], lambda one: entries[one.index])
    np.testing.assert_array_equal(only, plain.values)


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
