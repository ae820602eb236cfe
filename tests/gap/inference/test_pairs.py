"""A lag against a delay: what hardly differs is told apart from the same starting states."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_arm import SIGMA, XML, arm, recording
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search import pairs
from btr_mjx.gap.inference.search.pairs import told_apart
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.windows import bounded_loss

LATE = tuple(e for e in EFFECTS if e.name in ("actuator_lag", "actuator_delay"))
SIZE = 3e-3


def lagged(sent, time):
    """Commands through a first-order filter, which starts at rest."""
    part = 1.0 - np.exp(-(time[1] - time[0]) / SIZE)
    commands = sent.at(time)
    return lfilter([part], [1.0, part - 1.0], commands - commands[0], axis=0) + commands[0]


def delayed(sent, time):
    return sent.at(np.maximum(time - SIZE, 0.0))


@pytest.fixture(scope="module", params=[(lagged, "actuator_lag@all"), (delayed, "actuator_delay@all")])
def late(request) -> tuple[Bench, list[Judged], str]:
    arrive, name = request.param
    believed = arm()
    rows = [
        recording(f"r{i}", None, 30 + i, "fit" if i < 3 else "test", believed=believed, duration=0.7, arrive=arrive)
        for i in range(5)
    ]
    noise = Noise(SIGMA[:2].copy(), SIGMA[2:].copy())
    bench = Bench(Dataset(Path(), believed, Path("arm.xml"), XML, (), tuple(rows), "cubic", {}, noise), LATE)
    return bench, Polisher(bench)(bench.find()), name


def led_by(judged: list[Judged], name: str) -> list[Judged]:
    """A round in which another hypothesis leads by a little."""
    first = next(j for j in judged if j.name == name)
    best = max(j.score for j in judged)
    return [replace(first, score=best + 1.0), *(j for j in judged if j is not first)]


@pytest.mark.parametrize("leads", ["actuator_lag@all", "actuator_delay@all"])
def test_whoever_leads_the_truth_ends_in_front(late, leads, monkeypatch) -> None:
    bench, judged, name = late
    monkeypatch.setattr(pairs, "_HARDLY", 1e3)
    ahead = told_apart(bench, led_by(judged, leads))
    assert ahead[0].name == name
    assert {j.name for j in ahead} == {j.name for j in judged}
    assert ahead[0].score == max(j.score for j in ahead)
    assert ahead[0].hypothesis.values(False)[0] == pytest.approx(SIZE, rel=0.1)


def test_a_rival_is_tried_at_the_size_that_is_most_like_the_leader_and_from_its_starting_states(
    late, monkeypatch
) -> None:
    bench, judged, _ = late
    monkeypatch.setattr(pairs, "_HARDLY", 1e3)
    leader, rival = (next(j for j in judged if j.name == f"{e}@all") for e in ("actuator_lag", "actuator_delay"))
    ahead, found = pairs._ahead(bench, leader, rival.hypothesis)

    def distance(size: float) -> float:
        other = rival.hypothesis.replaced(np.array([size]), False)
        return sum(
            float(((s.windows.residuals([other])[0] - s.windows.residuals([leader.hypothesis])[0]) ** 2).sum())
            for s in leader.sides
        )

    best = minimize_scalar(distance, bounds=(0.5 * SIZE, 2 * SIZE), method="bounded", options={"xatol": 1e-7}).x
    assert found.values(False)[0] == pytest.approx(best, rel=0.02)
    fall = 0.0
    for side, along in zip(leader.sides, (bench.free, bench.nuisance), strict=True):
        for sign, h in ((1.0, leader.hypothesis), (-1.0, found)):
            chi2 = along(side, h).profile(side.windows.residuals([h])[0], bench.cut).chi2
            fall += sign * sum(float(bounded_loss(x, bench.cut)) for x in chi2)
    assert ahead == pytest.approx(fall / bench.dispersion)


def test_what_differs_by_more_is_left_as_it_was(late, monkeypatch) -> None:
    bench, judged, _ = late
    monkeypatch.setattr(pairs, "_HARDLY", 1e-9)
    for leads in ("actuator_lag@all", "actuator_delay@all"):
        given = led_by(judged, leads)
        assert told_apart(bench, given) == given


def test_what_moves_contacts_or_stands_alone_is_left_as_it_was(late, monkeypatch) -> None:
    bench, judged, _ = late
    assert told_apart(bench, judged[:1]) == judged[:1]
    monkeypatch.setattr(bench, "delicate", {j.name for j in judged})
    assert told_apart(bench, judged) == judged
