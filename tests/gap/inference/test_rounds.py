"""Rounds of the search, on stand-ins for judged candidates: who is looked at again, who is named."""

from dataclasses import dataclass
from types import SimpleNamespace

from btr_mjx.gap.inference.search import naming, rounds


@dataclass(frozen=True)
class Standing:
    """What rounds look at in a judged candidate."""

    name: str
    score: float
    hypothesis: SimpleNamespace
    held_out: float = 0.0


class Stage:
    """A bench and a polisher that say what they are told.

    Attributes:
      scores: of single effects and of pairs.
      polished: scores of those that are judged again.
      asked: names that were judged again.
    """

    contact_sensitive = frozenset[str]()
    base = SimpleNamespace(with_effect=lambda candidate, values: candidate.name)

    def __init__(self, monkeypatch, scores, polished=None):
        self.scores, self.polished, self.asked = scores, polished or {}, []
        monkeypatch.setattr(rounds, "Finalists", lambda bench: self)
        for module in (rounds, naming):
            monkeypatch.setattr(module, "accepted", self.accepted)
        monkeypatch.setattr(naming, "within_calibration", lambda bench, judged: False)

    def accepted(self, bench, judged, given):
        return judged.score > 15.0 if given is None else judged.score - given.score > 25.0

    def judged(self, name, scores=None):
        scores = scores or self.scores
        effects = [(SimpleNamespace(name=letter), (1.0,)) for letter in name]
        hypothesis = SimpleNamespace(effects=effects, with_effect=lambda candidate, values: name + candidate.name)
        known = {frozenset(own): score for own, score in scores.items()}
        return Standing(name, known.get(frozenset(name), 0.0), hypothesis)

    def again(self, hypotheses, given):
        return [self.judged(name) for name in hypotheses]

    def find(self, given=None):
        first = "" if given is None else given.name
        own = [name for name in self.scores if name[:-1] == first]
        return sorted((self.judged(name) for name in own), key=lambda j: -j.score)

    def __call__(self, judged, most=3, given=None):
        if given is not None and judged:
            if judged[0].name in self.asked:
                return list(judged)
            self.asked.append(judged[0].name)
            judged = [self.judged(judged[0].name, self.scores | self.polished), *judged[1:]]
        return sorted(judged, key=lambda j: -j.score)

    def beside(self, given, hypothesis):
        return self.judged(hypothesis)

    def named(self, most=2):
        return [j.name for j in rounds.search(self, most, lambda word: None)[1]]


def test_a_name_that_later_ones_make_worthless_is_dropped(monkeypatch):
    """`a` stood for a part of `b` and `c`."""
    scores = {"a": 500.0, "ab": 600.0, "abc": 1000.0, "b": 200.0, "bc": 990.0, "ac": 550.0}
    stage = Stage(monkeypatch, scores)
    found, named = rounds.search(stage, 3, lambda word: None)
    assert [j.name for j in named] == ["b", "bc"]
    assert [[j.name for j in one] for one in found] == [["b", "a"], ["bc"]]
    stage.scores |= {"bc": 900.0}
    assert stage.named(3) == ["a", "ab", "abc"]
    assert stage.named(2) == ["a", "ab"]


def test_whoever_leads_beside_another_effect_has_been_judged_again(monkeypatch):
    scores = {"a": 500.0, "ab": 560.0, "ac": 550.0, "ad": 490.0}
    stage = Stage(monkeypatch, scores, {"ab": 540.0, "ac": 570.0})
    assert stage.named() == ["a", "ac"]
    assert stage.asked == ["ab", "ac"]
    stage = Stage(monkeypatch, {"a": 500.0, "ab": 505.0, "ad": 490.0}, {"ab": 540.0})
    assert stage.named() == ["a", "ab"]  # too weak for a name before
    stage = Stage(monkeypatch, {"a": 500.0, "ab": 530.0, "ad": 490.0}, {"ab": 510.0})
    assert stage.named() == ["a"]  # a name before, and none any more
    assert stage.asked == ["ab"]
