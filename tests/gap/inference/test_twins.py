"""Forces of another shape beside a name."""

import pytest
from gap_arm import dataset

from btr_mjx.gap.effects import EFFECTS, KNOWN_EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.rounds import search
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.twins import candidates_of, twin
from btr_mjx.gap.windows import Options

SPRINGS = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "joint_stiffness", "armature"))
QUICK = Options(steps=6e4, leaders=4, contact_leaders=0)


def hardening(model):
    model.jnt_stiffnesspoly[1, 1] += 0.1


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(dataset(hardening, seed=6), SPRINGS, QUICK)


@pytest.fixture(scope="module")
def named(bench: Bench) -> Judged:
    found = search(bench, 1, lambda word: None)[0][0][0]
    assert found.name == "joint_stiffness@joint:elbow"  # what leads, named or not
    return found


def test_twins_sit_where_the_name_does(bench: Bench, named: Judged) -> None:
    found = [(i, c.name) for i, c in candidates_of(bench, named)]
    assert found == [(0, "hardening_spring@joint:elbow"), (0, "one_sided_spring@joint:elbow")]
    library = [e for e in KNOWN_EFFECTS if e.name in ("joint_stiffness", "hardening_spring")]
    other = Bench(dataset(hardening, seed=6), library, QUICK)
    assert [c.name for _, c in candidates_of(other, named)] == ["one_sided_spring@joint:elbow"]


def test_a_twin_adds_to_the_name_as_it_was_found(bench: Bench, named: Judged) -> None:
    """Its gain is the fall of the loss from the name's own fit; half of the name, from where it starts, fits worse."""
    rival = twin(bench, named)
    assert rival is not None
    assert rival.name == "joint_stiffness@joint:elbow + hardening_spring@joint:elbow"
    (_, (stiffness,)), (_, (cubic,)) = rival.hypothesis.effects
    assert cubic == pytest.approx(0.1, rel=0.1)
    assert abs(stiffness) < 0.2 * named.hypothesis.effects[0][1][0]
    for before, fit in zip(rival.before, named.fits, strict=True):
        assert before.loss == pytest.approx(fit.loss, rel=0.05)
    half = named.hypothesis.replaced(0.5 * named.hypothesis.values(bench.joint), bench.joint)
    side = rival.sides[0].based(half)
    assert bench.free(side, half).profile(side.windows.residual, bench.cut).loss > 1.1 * named.fits[0].loss
    assert rival.gain - named.gain == pytest.approx(bench.fall(named.fits[0], rival.fits[0], even=True), rel=0.05)
    assert rival.score > named.score + 50


def test_no_derivative_leads_there(bench: Bench, named: Judged) -> None:
    """Started beside the whole name alone the search ends no higher, which is why parts of it are handed over."""
    (_, candidate), _ = candidates_of(bench, named)
    alone = Polisher(bench).beside(named, named.hypothesis.with_effect(candidate, candidate.null))
    rival = twin(bench, named)
    assert rival is not None
    assert rival.score >= alone.score - 1.0


def test_a_true_spring_has_no_twin() -> None:
    def spring(model):
        model.jnt_stiffness[1] += 0.1

    own = Bench(dataset(spring, seed=6), SPRINGS, QUICK)
    found = search(own, 1, lambda word: None)[1][-1]
    rival = twin(own, found)
    assert rival is None or rival.score < found.score + 15.0
