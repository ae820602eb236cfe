"""Fit of starting states, time steps of derivatives, and scans over sizes of candidates."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from gap_arm import SIGMA, arm, arm_windows, elbow_off, recording
from hidden_cases import CaseSettings, case_robot, make_case
from scipy.optimize import least_squares

from btr_mjx.gap.data import load
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.contact_scan import contact_scan, with_line_search
from btr_mjx.gap.inference.search.search_records import Side
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import (
    Fit,
    Options,
    Span,
    Windows,
    fit_starting_states,
    prepare,
    transitions,
    with_fitted_states,
)
from btr_mjx.gap.windows.transitions import stride
from btr_mjx.gap.windows.window_fits import column_space
from btr_mjx.models import integrate


@pytest.fixture(scope="module")
def windows() -> Windows:
    return arm_windows()


def damped(model):
    world = World.of(model)
    world.model.dof_damping[:] += 0.001
    return world


def test_column_space_and_pseudo_inverse() -> None:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((3, 20, 4))
    columns[1, :, 2] = columns[1, :, 0] - columns[1, :, 1]
    basis, inverse = column_space(columns)
    np.testing.assert_allclose(inverse, np.linalg.pinv(columns, rcond=1e-9), atol=1e-9)
    np.testing.assert_allclose(basis @ np.swapaxes(basis, 1, 2) @ columns, columns, atol=1e-9)


def test_starting_states_equal_nonlinear_least_squares(windows: Windows) -> None:
    """Window by window, with the same bounds."""
    states = windows.states([damped])[0]
    qpos, qvel, there = fit_starting_states(windows, damped, 4, states, windows.correction)
    moved = windows.states([damped], start=(qpos, qvel))[0]
    np.testing.assert_allclose(there, moved, atol=1e-12)
    left = ((windows.whiten(there) + windows.correction) ** 2).sum(1)
    before = ((windows.whiten(states) + windows.correction) ** 2).sum(1)
    assert (before - left).max() > 1

    def residual(w, move):
        start = windows.qpos.copy(), windows.qvel.copy()
        start[0][w] = integrate(arm(), windows.smoothed[0][w], (move * SIGMA)[:2])
        start[1][w] = windows.smoothed[1][w] + (move * SIGMA)[2:]
        return (windows.whiten(windows.states([damped], start=start)[0]) + windows.correction)[w]

    for w in range(len(windows)):
        reach = windows.reach[w] / SIGMA
        found = least_squares(lambda x, w=w: residual(w, x), np.zeros(4), bounds=(-reach, reach), diff_step=0.05)
        assert left[w] < 2 * found.cost + 1.0


def test_rejected_steps_are_reduced(windows: Windows) -> None:
    """If the true derivative is three times the assumed one, a full step increases chi^2."""
    off = copy.copy(windows)
    rng = np.random.default_rng(3)
    nudge = 1.5 * SIGMA * rng.choice([-1.0, 1.0], (len(windows), 4))
    off.qpos, off.qvel = integrate(arm(), windows.qpos, nudge[:, :2]), windows.qvel + nudge[:, 2:]
    off.reach = 1e3 * windows.reach
    states = off.states([World.of])[0]

    def left(some: Windows) -> np.ndarray:
        there = fit_starting_states(some, World.of, 4, states, windows.correction)[2]
        return ((windows.whiten(there) + windows.correction) ** 2).sum(1)

    best, before = left(off), ((windows.whiten(states) + windows.correction) ** 2).sum(1)
    assert (before - best > 100).sum() > len(windows) / 2
    off.jacobians, off.inverse = off.jacobians / 3, off.inverse * 3
    assert ((before - left(off)) > 0.8 * (before - best))[before - best > 100].all()


def test_base_states_are_not_simulated_again(windows: Windows) -> None:
    own = with_fitted_states(windows, damped)
    counted = own.counter.steps
    again = own.based(damped)
    assert own.counter.steps == counted
    np.testing.assert_array_equal(again.base, own.base)
    np.testing.assert_array_equal(again.residual, own.residual)
    np.testing.assert_allclose(own.states([damped])[0], own.base, atol=1e-12)
    other = own.based(World.of)
    assert own.counter.steps > counted
    np.testing.assert_allclose(other.base, own.states([World.of])[0], atol=1e-12)


def test_converged_windows_are_not_simulated_again(windows: Windows) -> None:
    own = with_fitted_states(windows, World.of)
    counted = windows.counter.steps
    again = with_fitted_states(own, World.of, exact=False)
    whole = (len(windows) * (windows.since[:, -1] / windows.dt)).max()
    assert windows.counter.steps - counted < 2.5 * whole  # once from the current states, and one rejected step
    np.testing.assert_allclose(again.residual, own.residual, atol=0.2)


def test_stride_depends_on_accuracy() -> None:
    """No long steps for a stiff motor, nor for short sample intervals."""

    def of(believed, rate):
        data = prepare([recording("r", believed=believed)], SIGMA, Span(5, 6))
        out = Windows(data, np.array([0, 0]), np.array([20, 120]), 30)
        out.since = out.since * (200.0 / rate)
        return stride(out, World.of, out.states([World.of])[0])

    fine = arm()
    fine.opt.timestep = 5e-4
    assert of(fine, 200.0) == 2
    assert of(fine, 800.0) == 2
    assert of(fine, 2000.0) == 1
    stiff = arm()
    stiff.opt.timestep = 5e-4
    stiff.actuator_gainprm[:, 0] *= 3000
    stiff.actuator_biasprm[:, 1] *= 3000
    assert of(stiff, 200.0) == 1


def test_stride_is_short_for_touchdowns_of_light_legs(tmp_path, monkeypatch) -> None:
    """Long steps are accurate in most intervals of a quadruped, but not in those with a touchdown."""
    make_case(
        tmp_path,
        912,
        "quadruped",
        CaseSettings(verdict="none", background=0.0, recordings=(1, 1), duration=1.0, noise=1.0),
    )
    data = load(tmp_path)
    sigma = np.concatenate(case_robot("quadruped").sigma(data.fit[0].model))
    first = np.arange(8, len(data.fit[0].time) - 14, 8)
    legs = Windows(prepare(data.fit, sigma, Span(5, 4)), np.zeros(len(first), int), first, 8)
    states = legs.states([World.of])[0]
    assert stride(legs, World.of, states) == 1
    monkeypatch.setattr(transitions, "_MAX_ERROR", np.inf)
    assert stride(legs, World.of, states) == 2


@pytest.fixture(scope="module")
def bench() -> Bench:
    offsets = tuple(effect for effect in EFFECTS if effect.name in ("joint_offset", "armature"))
    return Bench(elbow_off(), offsets, Options(steps=4e4, leaders=2, contact_leaders=0))


def test_a_walk_sees_what_all_windows_show(bench: Bench) -> None:
    """Its gain is that of all windows, roughly; it climbs to the best size from a third and asks nothing twice."""
    elbow = next(c for c in bench.candidates if c.name == "joint_offset@joint:elbow")

    def whole(value):
        hypothesis = bench.base.with_effect(elbow, [value])
        sides = [bench.fit.with_fitted_states(h).with_own_directions(h) for h in (bench.base, hypothesis)]
        return bench.fall(*(bench.free(s).profile(s.windows.residual, bench.cut) for s in sides))

    sizes = np.linspace(-0.04, 0.04, 17)
    gains = [whole(value) for value in sizes]
    best = sizes[int(np.argmax(gains))]
    assert abs(best) > 0.01
    assert bench.line_search.gain(bench.base.with_effect(elbow, [best])) == pytest.approx(max(gains), rel=0.5)
    found = bench.line_search(bench.base.with_effect(elbow, [best / 3]), hope=0.0, promise=0.0)
    assert found is not None
    assert found.effects[0][1][0] == pytest.approx(best, rel=0.2)
    assert bench.line_search.best(found.name) >= bench.line_search.gain(bench.base.with_effect(elbow, [best / 3]))
    counted = bench.counter.steps
    bench.line_search.gain(bench.base.with_effect(elbow, [best]))
    assert bench.counter.steps == counted
    assert bench.line_search(bench.base.with_effect(elbow, [-best]), hope=1e9, promise=0.0) is None
    assert bench.line_search.best("nothing that was tried") == -np.inf


def test_the_best_of_a_scan_are_looked_at_with_directions_of_their_own(bench: Bench) -> None:
    moving = [c for c in bench.candidates if c.effect.name == "joint_offset"]
    side = Side(bench.fit.windows, bench.free(bench.fit))
    found = contact_scan(side, bench.base, moving, bench.cut, bench.fit.windows.residual, 1)
    again = with_line_search(found, bench.base, bench.line_search, 0.0)
    assert {c.name for _, c, _ in again} == {c.name for _, c, _ in found}
    assert [gain for gain, _, _ in again] == sorted((gain for gain, _, _ in again), reverse=True)
    first = {c.name: (gain, values) for gain, c, values in found}
    for gain, candidate, values in again:
        known, start = first[candidate.name]
        tries = {f: bench.line_search.gain(bench.base.with_effect(candidate, f * start)) for f in (1.0, 3.0)}
        assert gain == max(known, *tries.values())
        factor = max(tries, key=lambda f: tries[f])
        assert values[0] == (start[0] if gain == known else factor * start[0])
    assert with_line_search(found, bench.base, bench.line_search, 1e9) == found  # something else is far stronger


def test_some_windows_speak_for_all_but_their_luckiest_for_itself() -> None:
    """A third of the windows says what three times as many of the same would, of which one is luckiest."""
    own = SimpleNamespace(cut=1e3, dispersion=2.0)
    before, after = np.full(12, 50.0), np.full(12, 46.0)
    after[3] = 20.0

    def fit_of(chi2: np.ndarray) -> Fit:
        return Fit(np.zeros(0), float(chi2.sum()), chi2, np.eye(0))

    whole = Bench.fall(own, fit_of(np.tile(before, 3)), fit_of(np.tile(after, 3)))
    assert Bench.fall(own, fit_of(before), fit_of(after), 1 / 3) == pytest.approx(whole)
    assert whole == pytest.approx((3 * (11 * 4 + 27) - 27) / 2)  # the 30 count as 27: 15, and three times what is usual
