"""Candidates for one more effect, judged again, are held against what was found on equal terms."""

from types import SimpleNamespace

import pytest

from btr_mjx.gap.polish import Polisher
from btr_mjx.gap.search_records import Judged


def judged(names, gain, held_out, sides=(None, None)):
    effects = [(SimpleNamespace(name=name), (1.0,)) for name in names]
    hypothesis = SimpleNamespace(effects=effects)
    score = gain + held_out - 10.0 * len(effects)
    return Judged(hypothesis, None, gain, held_out, score, None, None, sides, None)


@pytest.fixture
def polisher(monkeypatch):
    """One whose bench finds `lag` worth 30 and 20 more as soon as it gets directions of its own."""
    monkeypatch.setattr(Judged, "name", property(lambda self: " + ".join(c.name for c, _ in self.hypothesis.effects)))
    own = Polisher(SimpleNamespace(delicate={"offset", "softness"}))
    own._given["lag"] = judged(["lag"], 530.0, 220.0)
    return own


def test_a_plain_candidate_keeps_the_starting_states_it_shares_if_others_judge_it_worse(polisher):
    given, before = judged(["lag"], 500.0, 200.0), judged(["lag", "gain"], 560.0, 220.0)
    worse, better = judged(["lag", "gain"], 540.0, 190.0), judged(["lag", "gain"], 600.0, 230.0)
    assert polisher._beside(given, before, worse) is before
    assert polisher._beside(given, before, better) is better


def test_directions_of_its_own_are_not_counted_as_the_merit_of_what_moves_contacts(polisher):
    given, before = judged(["lag"], 500.0, 200.0), judged(["lag", "offset"], 560.0, 220.0)
    again = judged(["lag", "offset"], 700.0, 300.0)
    beside = polisher._beside(given, before, again)
    assert (beside.gain, beside.held_out, beside.score) == (700.0 - 30.0, 300.0 - 20.0, again.score - 50.0)


def test_what_has_directions_of_its_own_or_is_no_better_with_them_takes_nothing_off(polisher):
    again = judged(["softness", "offset"], 700.0, 300.0)
    assert polisher._beside(judged(["softness"], 500.0, 200.0), again, again) is again
    again = judged(["lag", "offset"], 700.0, 300.0)
    assert polisher._beside(judged(["lag"], 540.0, 230.0), again, again) is again
