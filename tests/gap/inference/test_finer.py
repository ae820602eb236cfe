"""Sizes of what moves contacts and of its rivals, with the recordings held out having a say as well."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gap_arm import dataset

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search import finer as module
from btr_mjx.gap.inference.search.finer import finer
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.windows import Options

LIBRARY = tuple(e for e in EFFECTS if e.name in ("joint_offset", "armature"))
OFFSET = "joint_offset@joint:elbow"
TURN = 0.02
"""What is hidden: the angle by which the elbow is turned, in rad."""


@pytest.fixture(scope="module")
def polish() -> Polisher:
    def turned(model):
        model.body_quat[2] = [np.cos(TURN / 2), 0.0, np.sin(TURN / 2), 0.0]

    own = Bench(dataset(turned, seed=4, fit=3, test=2), LIBRARY, Options(steps=4e4, leaders=4, contact_leaders=0))
    own.delicate, own.options = {OFFSET}, Options(steps=1e7)  # as if the elbow moved contacts
    return Polisher(own)


@pytest.fixture(scope="module")
def judged(polish: Polisher) -> list[Judged]:
    """Best first; the offset leads."""
    out = polish(polish.bench.find())
    assert out[0].name == OFFSET
    assert out[0].score > module._LEAST
    return out


def at(polish: Polisher, judged: Judged, factor: float) -> Judged:
    """The offset at another size, from starting states that suit it there."""
    bench = polish.bench
    candidate, values = judged.hypothesis.effects[0]
    hypothesis = bench.base.with_effect(candidate, [factor * values[0]])
    sides = tuple(side.based(hypothesis).recentred(hypothesis) for side in judged.sides)
    refined = replace(judged.refined, residual=sides[0].windows.residual)
    return bench.judge([hypothesis], [refined], sides, judged.references)[0]


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_a_size_that_is_off_is_mended(polish: Polisher, judged: list[Judged], factor: float) -> None:
    wrong = at(polish, judged[0], factor)
    assert wrong.score < judged[0].score - 20.0
    before = polish.bench.counter.steps
    out = finer(polish, [wrong, *judged[1:]])
    assert polish.bench.counter.steps > before
    assert out[0].name == OFFSET
    assert abs(out[0].hypothesis.effects[0][1][0]) == pytest.approx(TURN, rel=0.05)
    assert out[0].score == pytest.approx(judged[0].score, rel=0.05)
    assert out[1:] == judged[1:]
    # It is what the believed model is compared with, too, and that has what it had before at least.
    loss = out[0].references[0].loss + out[0].references[1].loss
    assert loss <= wrong.references[0].loss + wrong.references[1].loss + 1e-6


def test_a_size_that_is_best_stays(polish: Polisher, judged: list[Judged]) -> None:
    assert finer(polish, judged) == judged


def test_who_is_looked_at(polish: Polisher, judged: list[Judged]) -> None:
    a, b, c, d = judged[0], *judged[1:4]

    def chosen(*scores: float, delicate: tuple[str, ...] = (a.name, b.name, c.name, d.name)):
        own = copy.copy(polish.bench)
        own.delicate = set(delicate)
        rows = [replace(j, score=s) for j, s in zip((a, b, c, d), scores, strict=False)]
        return [j.name for j in module._chosen(own, rows, 25.0, 0.02)]

    assert chosen() == []
    assert chosen(module._LEAST - 1.0) == []
    assert chosen(200.0, 180.0, 170.0) == [a.name, b.name]  # those that would be called equivalent
    assert chosen(5000.0, 4930.0, 4000.0) == [a.name, b.name]  # within a part of the best score
    assert chosen(200.0, 199.0, 198.0, 197.0) == [a.name, b.name, c.name]
    assert chosen(200.0, 190.0, 180.0, delicate=(a.name, c.name)) == [a.name, c.name]
    assert chosen(200.0, 190.0, delicate=(b.name,)) == []


@pytest.mark.parametrize(
    ("ahead", "steps", "expected"),
    [(5.0, 1e7, True), (-5.0, 1e7, True), (20.0, 1e7, False), (5.0, 1.0, False)],
    ids=["rival behind", "rival in front", "not abreast", "much has been spent"],
)
def test_rivals_abreast_are_judged_once_more(
    polish: Polisher, judged: list[Judged], monkeypatch: pytest.MonkeyPatch, ahead: float, steps: float, expected: bool
) -> None:
    """The offset explains what a rival that is said to be as good does not."""
    own = copy.copy(polish)
    own.bench = copy.copy(polish.bench)
    own.bench.delicate, own.bench.options = {judged[0].name, judged[1].name}, Options(steps=steps)
    monkeypatch.setattr(module, "_again", lambda *_: [])  # all sizes are best
    given = sorted([judged[0], replace(judged[1], score=judged[0].score - ahead), *judged[2:]], key=lambda j: -j.score)
    before = own.bench.counter.steps
    out = finer(own, given)
    assert (own.bench.counter.steps > before) is expected
    if not expected:
        assert out == given
        return
    assert out[0].name == OFFSET
    assert {j.name for j in out} == {j.name for j in given}
    assert out[0].residual is judged[0].residual  # its numbers stay
    if ahead > 0:
        assert out == given
    else:
        assert out[0].score - given[0].score > 50.0
        assert out[1:] == [given[0], *judged[2:]]
