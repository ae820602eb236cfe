"""The run-off on fresh windows: an arm of which hardly anything was looked at before."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_arm import SIGMA, XML, arm, arm_windows, recording

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search import runoff
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.runoff import apart
from btr_mjx.gap.inference.search.search_records import Judged, Side
from btr_mjx.gap.inference.verdict.outcome import named_effects
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Options, Windows, linearise
from btr_mjx.gap.windows import placement as planning
from btr_mjx.gap.windows.time_steps import step_error

FRICTIONS = tuple(e for e in EFFECTS if e.name in ("dry_friction", "viscous_damping", "load_friction"))
RICH = Options(steps=1e6)


def few_windows(friction: float) -> Bench:
    """Two windows of twelve seconds of an arm whose elbow rubs, by so many N m."""

    def rubs(model):
        model.dof_frictionloss[1] = friction

    believed = arm()
    rows = [
        recording(f"r{i}", rubs, 400 + i, "fit" if i < 2 else "test", believed=believed, duration=6.0 if i < 2 else 3.0)
        for i in range(3)
    ]
    noise = Noise(SIGMA[:2].copy(), SIGMA[2:].copy())
    data = Dataset(Path(), believed, Path("arm.xml"), XML, (), tuple(rows), "cubic", {}, noise)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "_MAX_SPAN", 0.2)
        bench = Bench(data, FRICTIONS, Options(steps=3e3, leaders=9, contact_leaders=0))
    assert len(bench.fit.windows) == 2
    return bench


@pytest.fixture(autouse=True)
def hopeful(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two windows see so little that the scores of all are negative."""
    monkeypatch.setattr(runoff, "_HOPELESS", -20.0)


@pytest.fixture(scope="module")
def rubbing() -> tuple[Bench, list[Judged]]:
    bench = few_windows(3e-3)
    judged = Polisher(bench)(bench.find())
    bench.options = RICH
    return bench, judged


def test_fresh_windows_tell_what_few_windows_could_not(rubbing: tuple[Bench, list[Judged]]) -> None:
    bench, judged = rubbing
    assert judged[0].score < 0  # nothing to be seen, and something else leads
    assert judged[0].name != "dry_friction@joint:elbow"
    out = runoff.runoff(bench, judged)
    assert out[0].name == "dry_friction@joint:elbow"
    assert out[0].score > out[1].score + 10
    assert out[0].fresh > 50
    assert {j.name for j in out} == {j.name for j in judged}
    scores = [j.score for j in out]
    assert scores == sorted(scores, reverse=True)


def test_numbers_are_those_that_suit_all_windows(rubbing: tuple[Bench, list[Judged]]) -> None:
    bench, judged = rubbing
    name = "dry_friction@joint:elbow"
    before = next(j for j in judged if j.name == name)
    after = next(j for j in runoff.runoff(bench, judged) if j.name == name)
    wide = after.widest
    assert after.hypothesis == before.hypothesis
    assert before.widest is before
    assert len(wide.sides[0].windows) > len(bench.fit.windows) + 8
    own, other = (h.values(bench.joint)[0] for h in (wide.hypothesis, before.hypothesis))
    losses = [_loss(bench, wide, value) for value in (own, other, 0.9 * own, 1.1 * own)]
    assert losses[0] < min(losses[1:])
    assert losses[0] == pytest.approx(wide.fits[0].loss, rel=1e-6)
    assert abs(own - 3e-3) < 0.6 * abs(other - 3e-3)
    said, earlier = (
        named_effects(bench, [j], [[j]], np.random.default_rng(0))[0].parameters["torque"] for j in (after, before)
    )
    assert said.value == pytest.approx(own, rel=0.05)
    assert said.high - said.low < 0.5 * (earlier.high - earlier.low)
    # What the time step does in fresh windows is the hypothesis' own, not the believed model's.
    windows = wide.sides[0].windows
    fresh = windows.some(np.arange(len(bench.fit.windows), len(windows)))
    np.testing.assert_allclose(fresh.correction, step_error(fresh, before.hypothesis, fresh.base), atol=1e-9)
    assert np.abs(fresh.correction - step_error(fresh, bench.base, fresh.base)).max() > 1e-3


def _loss(bench: Bench, wide: Judged, value: float) -> float:
    """Of one number, simulated anew."""
    side = wide.sides[0]
    h = wide.hypothesis.replaced(np.array([value]), bench.joint)
    return bench.free(side, h).profile(side.windows.residuals([h])[0], bench.cut).loss


def test_where_nothing_is_missing_fresh_windows_make_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runoff, "_TELLING", 0.0)
    bench = few_windows(0.0)
    judged = Polisher(bench)(bench.find())
    bench.options = RICH
    before = bench.counter.steps
    out = runoff.runoff(bench, judged)
    assert bench.counter.steps > before + 1e4  # they were looked at
    assert out[0].score < 3
    assert max(j.fresh for j in out) < 5


def test_fresh_windows_are_the_ones_that_were_left(rubbing: tuple[Bench, list[Judged]]) -> None:
    bench, _ = rubbing
    unseen = runoff._unseen(bench)
    assert unseen is not None
    pairs = {(r, a) for r, a in zip(unseen.recording.tolist(), unseen.first.tolist(), strict=True)}
    used = bench.fit.windows
    for r, a in zip(used.recording.tolist(), used.first.tolist(), strict=True):
        assert all(other != r or abs(start - a) >= used.k for other, start in pairs)
    short = copy.copy(bench)
    short.fit = Side(unseen, bench.fit.nuisance)
    assert runoff._unseen(short) is None


@pytest.mark.parametrize("change", ["poor", "hopeless", "touches", "sure", "alike"])
def test_whom_a_run_off_leaves_alone(
    rubbing: tuple[Bench, list[Judged]], monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    bench, judged = rubbing
    own = copy.copy(bench)
    if change == "poor":
        own.options = Options(steps=1.0)
    if change == "hopeless":
        monkeypatch.setattr(runoff, "_HOPELESS", judged[0].score + 1)
    if change == "touches":
        own.delicate = {judged[0].name}
    if change == "sure":  # no rivals, and no doubt
        monkeypatch.setattr(runoff, "_WEAK", judged[0].score)
        monkeypatch.setattr(runoff, "CLOSE", 0.0)
    if change == "alike":
        monkeypatch.setattr(runoff, "_TELLING", 1e9)
    assert runoff.runoff(own, judged) == judged
    assert runoff.runoff(own, []) == []


@pytest.mark.parametrize("touching", [0, 2])
def test_rivals_that_no_fresh_window_tells_apart_keep_their_distance(
    rubbing: tuple[Bench, list[Judged]], monkeypatch: pytest.MonkeyPatch, touching: int
) -> None:
    """Only the difference from nothing at all tells, then all of them rise and fall with the leader.

    One or two windows in which a foot may touch or not tell nothing.
    """
    bench, judged = rubbing

    def differences(windows, hypotheses):
        out = np.zeros((len(hypotheses) - 1, len(windows)))
        out[:, :touching] = 20.0
        out[0] = 1.0
        return out

    monkeypatch.setattr(runoff, "_differences", differences)
    out = {j.name: j for j in runoff.runoff(bench, judged)}
    close = [j for j in judged if judged[0].score - j.score < runoff.CLOSE]
    assert len(close) > 2
    for j in close:
        assert out[j.name].score - out[judged[0].name].score == pytest.approx(j.score - judged[0].score)
        assert out[j.name].fresh == out[judged[0].name].fresh


def test_windows_joined_are_those_linearised_together() -> None:
    both = arm_windows()
    first, second = (
        Windows(both.data, both.recording[own], both.first[own], both.k) for own in (slice(0, 3), slice(3, 4))
    )
    for windows in (first, second):
        linearise(windows, World.of, step=both.step)
    joined = first.joined(second)
    assert joined.stride == both.stride
    assert len(joined) == 4
    np.testing.assert_allclose(joined.residual, both.residual, atol=1e-9)
    np.testing.assert_allclose(joined.residuals([World.of])[0], both.residuals([World.of])[0], atol=1e-9)
    assert [own.tolist() for _, own in joined.groups] == [[0, 1], [2, 3]]


def test_states_are_apart_beyond_shift_and_drift() -> None:
    """Against least squares, window by window and joint by joint."""
    windows, rng = arm_windows(), np.random.default_rng(0)
    states = windows.base + 1e-2 * rng.standard_normal(windows.base.shape)
    expected = np.zeros(len(windows))
    for w in range(len(windows)):
        time = windows.since[w]
        for joint in range(2):
            away = (states - windows.base)[w][:, [joint, 2 + joint]] / SIGMA[[joint, 2 + joint]]
            zero, one = np.zeros_like(time), np.ones_like(time)
            columns = np.array(
                [np.append(one / SIGMA[joint], zero), np.append(time / SIGMA[joint], one / SIGMA[2 + joint])]
            )
            rows = np.append(away[:, 0], away[:, 1])
            expected[w] += ((rows - columns.T @ np.linalg.lstsq(columns.T, rows)[0]) ** 2).sum()
    np.testing.assert_allclose(apart(windows, states, windows.base), expected, rtol=1e-8)
    shifted = states.copy()
    shifted[:, :, :2] += 0.3 + 0.2 * windows.since[..., None]
    shifted[:, :, 2:] += 0.2
    np.testing.assert_allclose(apart(windows, shifted, windows.base), expected, rtol=1e-6)


def test_one_more_effect_stands_on_what_the_run_off_said(rubbing: tuple[Bench, list[Judged]]) -> None:
    """What fresh windows add to a name's score they add to that of a pair with it, and not to their difference."""
    bench, judged = rubbing
    best, candidate = judged[0], judged[1].hypothesis.effects[0]
    richer = replace(best, score=best.score + 70.0)
    pairs = [Polisher(bench).beside(given, best.hypothesis.with_effect(*candidate)) for given in (best, richer)]
    assert pairs[1].score == pytest.approx(pairs[0].score + 70.0)
    assert pairs[1].gain == pytest.approx(pairs[0].gain)
