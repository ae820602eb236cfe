"""Sentences, numbers and tables of cells about a diagnosis that was written by hand."""

import pytest
from gap_results import RESULT

from btr_mjx.gap.results import detail_sentences, estimate_cells, format_number, verdict_sentence
from btr_mjx.gap.results.words.terms import format_estimate


def test_two_effects_and_equivalent_ones_in_the_sentence() -> None:
    second = {
        "effect": "payload",
        "location": "body:torso",
        "parameters": {"mass": {"value": 2.0, "low": 1.0, "high": 4.0, "unit": "kg"}},
    }
    result = RESULT | {"effects": [*RESULT["effects"], second]}
    text, details = verdict_sentence(result), " ".join(detail_sentences(result))
    assert "A part of what is missing is load-dependent" in text
    assert "a payload at body torso (mass 2 [1, 4] kg)" in text
    assert "cannot tell it apart from load-dependent gear friction at every joint from body thigh0 down: run" in details


def test_whole_recordings_are_said_apart() -> None:
    loop = {"before": 0.054, "after": 0.027, "unit": "rad"}
    text = " ".join(detail_sentences(RESULT | {"open_loop": loop}))
    assert "simulated from their first sample, falls from 3.09° to 1.55°." in text
    assert "The misfit of predictions over 0.25 s on held-out recordings falls from 62.2 to 55 (1: what noise" in text


def test_an_open_loop_error_that_grows_is_not_called_an_improvement() -> None:
    loop = {"before": 0.125, "after": 0.147, "unit": "rad"}
    text = " ".join(detail_sentences(RESULT | {"open_loop": loop}))
    assert "first sample, is 7.16° with the believed model and 8.42° with the mended one: where small" in text
    assert "recordings, simulated from their first sample, falls" not in text


def test_numbers_for_readers() -> None:
    assert [format_number(x) for x in (0.0, 1234.5, 0.31234, -2.0, 1e-7, None)] == [
        "0",
        "1234",
        "0.312",
        "−2",
        "1.00·10^−7",
        "–",
    ]
    assert format_estimate({"value": 12.34, "low": 11.9, "high": 12.8, "unit": "N m"}) == "12.34 ± 0.45 N m"
    assert format_estimate({"value": 1.0, "unit": "kg"}) == "1 kg"
    edge = {"value": 0.9, "low": 0.9, "high": 0.9, "unit": "1", "edge": True}
    assert format_estimate(edge) == "0.9 (the edge of what is tried; the true one may be beyond)"
    assert estimate_cells({"value": 2.0031, "low": 1.9962, "high": 2.0098}) == {
        "value": "2.0031",
        "low": "1.9962",
        "high": "2.0098",
    }
    assert estimate_cells({"value": -0.31, "low": -0.35, "high": 12.0}) == {
        "value": "−0.310",
        "low": "−0.350",
        "high": "12.000",
    }
    assert estimate_cells({"value": 1.0, "low": None, "high": None}) == {"value": "1", "low": "–", "high": "–"}
    assert estimate_cells({"value": 4e7, "low": 3.9e7, "high": 4.1e7})["high"] == "4.10·10^7"


@pytest.mark.parametrize(
    ("second", "said"),
    [(15.0, "far behind (14 %"), (80.0, "behind (75 %"), (100.0, "close behind (94 %"), (-9.0, "far behind (0 %")],
)
def test_a_runner_up_is_compared_with_the_name(second: float, said: str) -> None:
    best = {"effect": "load_friction", "location": "joint:knee0", "score": 106.0}
    other = {"effect": "payload", "location": "body:torso", "score": second}
    sentence = " ".join(detail_sentences(RESULT | {"ranking": [best, other]}))
    assert "Runner-up: " in sentence
    assert f" at body torso, {said} of the score)." in sentence


def test_what_scores_more_than_the_name_is_not_behind_it() -> None:
    best = {"effect": "load_friction", "location": "joint:knee0", "score": 106.0}
    other = {"effect": "payload", "location": "body:torso", "score": 133.0}
    sentence = " ".join(detail_sentences(RESULT | {"ranking": [other, best]}))
    assert "A payload at body torso scores more and may not be named: it gains too little" in sentence
    assert "behind" not in sentence
