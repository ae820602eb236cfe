"""Rounds of the search, on stand-ins for judged candidates: who is looked at again, who is swapped, who is named."""

from types import SimpleNamespace

import numpy as np
import pytest
from gap_judged import Standing

from btr_mjx.gap.inference.search import naming, rounds


class Stage:
    """A bench and a polisher that say what they are told.

    Attributes:
      scores: of single effects and of pairs.
      asked: names that were judged again.
      beyond: calibration, by name.
      limb: names that move the contacts of a limb.
      besides: scores beside its calibration.
      near: scores after a closer look.
      sized: scores at better sizes.
      ran: scores after a run-off.
      apart: scores where what hardly differs is told apart.
      underfoot: scores after a look at what changes the ground.
      usual: names that are no larger than calibration leaves.
      spent: whether much has been spent.
      worn: whether so much that hardly anything may follow.
    """

    spent = worn = False
    delicate = frozenset("m")

    def __init__(self, monkeypatch, scores, polished=None):
        self.scores, self.polished, self.asked = scores, polished or {}, []
        monkeypatch.setattr(rounds, "Polisher", lambda bench: self)
        self.beyond, self.ran, self.usual = dict[str, float](), dict[str, float](), set[str]()
        for module in (rounds, naming):
            monkeypatch.setattr(module, "accepted", self.accepted)
            monkeypatch.setattr(module, "within_calibration", lambda bench, judged: judged.name in self.usual)
        self.near = dict[str, float]()
        monkeypatch.setattr(rounds, "closer", self.closer)
        self.sized = dict[str, float]()
        monkeypatch.setattr(rounds, "finer", self.finer)
        monkeypatch.setattr(rounds, "runoff", self.runoff)
        monkeypatch.setattr(rounds, "told_apart", self.told)
        monkeypatch.setattr(rounds, "beyond_calibration", self.compared)
        self.apart = dict[str, float]()
        self.limb, self.besides, self.underfoot = "", dict[str, float](), dict[str, float]()
        monkeypatch.setattr(rounds, "limb_of", lambda bench, judged: list(self.limb) * (judged.name in self.limb))
        monkeypatch.setattr(rounds, "besides", self.calibrated)
        self.better = dict[str, float]()
        monkeypatch.setattr(rounds, "alone", self.alone)

    def closer(self, bench, judged):
        self.asked += ["closer"] if self.near else []
        again = [self.judged(j.name, {j.name: j.score} | self.near) for j in judged]
        return sorted(again, key=lambda j: -j.score)

    def finer(self, polish, judged):
        again = [self.judged(j.name, {j.name: j.score} | self.sized) for j in judged]
        return sorted(again, key=lambda j: -j.score)

    def runoff(self, bench, judged):
        again = [self.judged(j.name, {j.name: j.score} | self.ran) for j in judged]
        return sorted(again, key=lambda j: -j.score)

    def told(self, bench, judged):
        if not self.apart:
            return judged
        again = [self.judged(j.name, self.scores | self.ran | self.apart) for j in judged]
        return sorted(again, key=lambda j: -j.score)

    def costly(self):
        return self.spent

    def exhausted(self):
        return self.worn

    def compared(self, bench, judged):
        return SimpleNamespace(gain=self.beyond.get(judged.name, np.inf), calibrated=f"calibrated for {judged.name}")

    def calibrated(self, bench, base, hypotheses):
        self.asked.append(base)
        names = ["".join(candidate.name for candidate, _ in h.effects) for h in hypotheses]
        return sorted((self.judged(n, self.scores | self.besides) for n in names), key=lambda j: -j.score)

    def accepted(self, bench, judged, given, share=0.0):
        return not judged.explained and judged.score - (given.score if given else 0.0) > 25.0

    def judged(self, name, scores=None):
        scores = scores or self.scores
        effects = [(SimpleNamespace(name=letter), (1.0,)) for letter in name]
        hypothesis = SimpleNamespace(effects=effects, with_effect=lambda candidate, values: name + candidate.name)
        return Standing(name, scores[name], hypothesis)

    def find(self, given=None):
        first = "" if given is None else given.name
        own = [name for name in self.scores if name[:-1] == first]
        return sorted((self.judged(name) for name in own), key=lambda j: -j.score)

    def __call__(self, judged, most=3, given=None):
        if given is not None:
            if judged[0].name in self.asked:
                return list(judged)
            self.asked.append(judged[0].name)
            judged = [self.judged(judged[0].name, self.scores | self.polished), *judged[1:]]
        return sorted(judged, key=lambda j: -j.score)

    def beside(self, given, hypothesis):
        return self.judged(hypothesis)

    def alone(self, bench, both):
        return self.judged(both.name[:-1], self.scores | self.better), both

    def ground(self, judged):
        self.asked.append("ground")
        again = [self.judged(j.name, self.scores | self.underfoot) for j in judged]
        return sorted(again, key=lambda j: -j.score)

    def named(self):
        return [j.name for j in rounds.search(self, 2, lambda word: None)[1]]


def test_the_first_effect_gives_way_to_a_rival_with_which_both_explain_more(monkeypatch):
    """`a` explains a part of what `b` and `c` do together."""
    scores = {"a": 500.0, "b": 450.0, "c": 100.0, "ac": 560.0, "bc": 700.0}
    stage = Stage(monkeypatch, scores)
    found, named = rounds.search(stage, 2, lambda word: None)
    assert [j.name for j in named] == ["b", "bc"]
    assert [[j.name for j in one] for one in found] == [["b", "a", "c"], ["bc"]]


@pytest.mark.parametrize(
    "changed",
    [
        {"bc": 560.0},  # no better
        {"b": 200.0},  # too weak alone
        {"bd": 470.0, "bc": 0.0},
    ],
)
def test_rivals_that_explain_no_more_change_nothing(monkeypatch, changed):
    scores = {"a": 500.0, "b": 450.0, "c": 100.0, "ac": 560.0, "bc": 700.0} | changed
    assert Stage(monkeypatch, scores).named() == ["a", "ac"]


@pytest.mark.parametrize(
    ("better", "named", "sought"),
    [
        ({"a": 690.0}, ["a"], 2),  # with a better number the first explains what both did, and one more is sought once
        ({"a": 690.0, "ab": 720.0}, ["a", "ab"], 2),
        ({"a": 640.0}, ["a", "ac"], 1),
        ({}, ["a", "ac"], 1),
    ],
)
def test_a_second_effect_that_says_what_a_better_number_says_is_not_named(monkeypatch, better, named, sought):
    scores = {"a": 500.0, "b": 100.0, "ac": 700.0, "ab": 400.0}
    stage, rounds_of = Stage(monkeypatch, scores), []
    stage.better = {name: score for name, score in better.items() if len(name) == 1}

    def find(given=None):
        if given is not None:
            rounds_of.append(given.score)
            stage.scores = scores | better if given.score > 500.0 else scores
        return Stage.find(stage, given)

    stage.find = find
    found, best = rounds.search(stage, 2, lambda word: None)
    assert [j.name for j in best] == named
    assert len(rounds_of) == sought
    assert len(found) == 2
    assert found[0][0].score == (690.0 if sought == 2 else 500.0)
    stage.worn = True
    assert len(rounds.search(stage, 2, lambda word: None)[0]) == 2


def test_one_rival_only_is_tried_again_where_much_has_been_spent(monkeypatch):
    scores = {"a": 500.0, "d": 460.0, "b": 450.0, "c": 100.0, "ac": 560.0, "dc": 400.0, "bc": 700.0}
    stage = Stage(monkeypatch, scores)
    assert stage.named() == ["b", "bc"]
    stage.spent = True
    assert stage.named() == ["a", "ac"]
    stage.scores |= {"d": 430.0}
    assert stage.named() == ["b", "bc"]
    stage.worn = True  # none at all
    assert stage.named() == ["a", "ac"]


def test_what_calibration_explains_as_well_is_not_named(monkeypatch):
    scores = {"a": 500.0, "b": 450.0, "ab": 560.0}
    stage = Stage(monkeypatch, scores)
    stage.limb, stage.beyond["a"] = "ab", rounds.BEYOND - 1.0
    assert stage.named() == []
    assert [j.explained for j in rounds.search(stage, 2, lambda word: None)[0][0]] == [True, False]
    stage.beyond["a"] = rounds.BEYOND + 1.0
    assert stage.named() == ["a", "ab"]
    stage.beyond["ab"] = -1.0  # only the first effect is asked
    assert stage.named() == ["a", "ab"]
    stage.scores["a"], stage.beyond["a"] = 900.0, -1.0  # far more than calibration ever came to
    stage.scores["ab"] = 960.0
    assert stage.named() == ["a", "ab"]


@pytest.mark.parametrize(
    ("besides", "order", "named"),
    [
        ({"b": 90.0, "c": 20.0}, "bcad", ["b"]),  # as it was hidden
        ({"b": 40.0, "c": 120.0}, "cbad", ["c"]),
        ({"b": 20.0, "c": 10.0}, "abcd", []),  # it had explained what calibration explains
    ],
)
def test_others_are_held_against_a_calibrated_model(monkeypatch, besides, order, named):
    stage = Stage(monkeypatch, {"a": 300.0, "d": 250.0, "b": 150.0, "c": 60.0, "e": -9.0})
    stage.limb, stage.beyond["a"], stage.besides = "ad", 3.0, besides
    found, names = rounds.search(stage, 1, lambda word: None)
    assert [j.name for j in names] == named
    assert "".join(j.name for j in found[0] if j.name in "abc") == order.replace("d", "")
    assert next(j for j in found[0] if j.name == "a").explained
    assert stage.asked == ["calibrated for a"]


def test_a_run_off_decides_the_first_round(monkeypatch):
    stage = Stage(monkeypatch, {"a": 70.0, "b": 66.0, "ab": 75.0, "ba": 75.0})
    assert stage.named() == ["a"]
    stage.ran = {"a": 90.0, "b": 110.0}
    assert stage.named() == ["b"]
    stage.usual = {"a"}  # no larger than calibration leaves: there is nothing to decide
    assert stage.named() == ["a"]


@pytest.mark.parametrize(
    ("scores", "near", "named", "asked"),
    [
        ({"a": 20.0, "b": 10.0}, {"a": 40.0}, ["a"], True),
        ({"a": 30.0, "b": 10.0}, {"a": 10.0, "b": 4.0}, [], True),
        ({"m": 20.0, "b": 10.0}, {"b": 40.0}, ["b"], True),  # what moves contacts and may not be named hides nobody
        ({"m": 30.0, "b": 10.0}, {"b": 40.0}, ["m"], False),
    ],
)
def test_what_moves_no_contacts_is_looked_at_closer(monkeypatch, scores, near, named, asked):
    stage = Stage(monkeypatch, scores)
    stage.near = near
    assert [j.name for j in rounds.search(stage, 1, lambda word: None)[1]] == named
    assert ("closer" in stage.asked) == asked


def test_of_two_rivals_the_one_is_named_that_is_ahead_at_its_best_size(monkeypatch):
    stage = Stage(monkeypatch, {"a": 700.0, "b": 690.0})
    assert [j.name for j in rounds.search(stage, 1, lambda word: None)[1]] == ["a"]
    stage.sized = {"a": 705.0, "b": 760.0}
    assert [j.name for j in rounds.search(stage, 1, lambda word: None)[1]] == ["b"]


def test_beside_what_is_barely_seen_no_second_effect_is_sought(monkeypatch):
    scores = {"a": 50.0, "ab": 90.0}
    stage = Stage(monkeypatch, scores)
    assert stage.named() == ["a", "ab"]
    stage.spent = True  # where much has been spent
    assert stage.named() == ["a"]
    stage.scores = {"a": 70.0, "ab": 110.0}
    assert stage.named() == ["a", "ab"]


def test_where_too_much_has_been_spent_only_what_is_a_name_already_is_judged_again(monkeypatch):
    stage = Stage(monkeypatch, {"a": 500.0, "ab": 505.0, "ad": 490.0}, {"ab": 540.0})
    stage.worn = True
    assert stage.named() == ["a"]
    assert stage.asked == []
    stage = Stage(monkeypatch, {"a": 500.0, "ab": 530.0, "ad": 490.0}, {"ab": 510.0})
    stage.worn = True
    assert stage.named() == ["a"]
    assert stage.asked == ["ab"]


def test_what_hardly_differs_from_a_name_may_take_its_place(monkeypatch):
    stage = Stage(monkeypatch, {"a": 70.0, "b": 66.0, "ab": 75.0, "ba": 75.0})
    stage.apart = {"b": 71.0}
    assert stage.named() == ["b"]
    allowed = stage.accepted
    for module in (rounds, naming):
        monkeypatch.setattr(
            module, "accepted", lambda b, j, *rest, **more: j.name != "b" and allowed(b, j, *rest, **more)
        )
    assert stage.named() == ["a"]  # what may not be named does not
    stage = Stage(monkeypatch, {"a": 10.0, "b": 9.0})  # there is no name
    stage.apart = {"b": 71.0}
    assert stage.named() == []


@pytest.mark.parametrize(
    ("scores", "spent", "named", "asked"),
    [
        ({"a": 20.0, "g": -5.0, "gb": 81.0}, False, ["g"], True),
        ({"a": 20.0, "g": -5.0}, True, [], False),  # costs too much
        ({"a": 40.0, "g": -5.0, "ab": 41.0}, False, ["a"], False),  # there is a name already
    ],
)
def test_the_ground_is_looked_at_before_anything_is_called_nothing(monkeypatch, scores, spent, named, asked):
    stage = Stage(monkeypatch, scores)
    stage.spent, stage.underfoot, stage.ran = spent, {"g": 80.0}, {"g": 80.0} if asked else {}
    assert stage.named() == named
    assert ("ground" in stage.asked) == asked


def test_whoever_leads_beside_another_effect_has_been_judged_again(monkeypatch):
    scores = {"a": 500.0, "ab": 560.0, "ac": 550.0, "ad": 490.0}
    stage = Stage(monkeypatch, scores, {"ab": 540.0, "ac": 570.0})
    assert stage.named() == ["a", "ac"]
    assert stage.asked == ["ab", "ac"]
    stage = Stage(monkeypatch, {"a": 500.0, "ab": 505.0, "ad": 490.0}, {"ab": 540.0})
    assert stage.named() == ["a", "ab"]  # too weak for a name before
