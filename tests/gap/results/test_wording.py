"""Sentences of a verdict."""

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.results import detail_sentences, format_number, hypothesis_in_words, number_in_words, verdict_sentence
from btr_mjx.gap.results.words.effects import EFFECT_WORDS, effect_at_place
from btr_mjx.gap.results.words.terms import parameters_in_words


def result(after: float, nulls: float, before: float = 180.0) -> dict[str, Any]:
    damping = {"value": 0.4, "low": 0.3, "high": 0.5, "unit": "N m s/rad", "null": 0.0, "edge": False}
    effect = {"effect": "viscous_damping", "location": "joint:elbow", "parameters": {"damping": damping}}
    gap = {"before": before, "after": after, "noise_floor": min(nulls, after), "nulls": nulls}
    return {"verdict": "effect", "effects": [effect], "gap": gap | {"unit": "χ² per degree of freedom"}}


@pytest.mark.parametrize(
    ("after", "subject", "rest"),
    [
        (54.7, "A part of what is missing is", "It explains 70 % of the disagreement on recordings that were not used"),
        (
            54.7,
            "viscous damping at joint elbow (damping 0.40 ± 0.10 N m s/rad)",
            "more than noise is left.",
        ),
        (2.9, "The missing effect is", "more than noise is left."),
        (
            1.0,
            "The missing effect is",
            "It explains 100 % of the disagreement on recordings that were not used; the rest",
        ),
        (1.0, "The missing effect is", "the rest is noise."),
    ],
)
def test_a_name_says_how_much_it_explains_and_leaves(after: float, subject: str, rest: str) -> None:
    text = verdict_sentence(result(after, 1.0))
    assert subject in text
    assert rest in text


@pytest.mark.parametrize(
    ("kind", "unit", "before", "after", "noise"),
    [("rad", "rad", "17°", "0.0057°", "0.0011°"), ("m", "m", "300 mm", "0.1 mm", "0.02 mm")],
)
def test_the_joint_that_has_it_is_told_in_the_unit_of_its_kind(
    kind: str, unit: str, before: str, after: str, noise: str
) -> None:
    rows = [
        {"joint": f"joint {name}", "unit": unit, "horizon": 0.25, "before": first, "after": 1e-4, "noise": 2e-5}
        for name, first in (("shoulder", 0.4), ("elbow", 0.3))
    ]
    told = f"predicted over 0.25 s, joint elbow is off by {after} instead of {before}, where noise makes {noise}"
    assert told in verdict_sentence(result(1.0, 1.0) | {"joint_errors": rows})
    elsewhere = result(1.0, 1.0) | {"joint_errors": rows[:1]}  # the effect is at a joint that is not measured
    assert "joint shoulder is off by" in verdict_sentence(elsewhere)


def test_radians_and_metres_are_not_added() -> None:
    made = {"horizon": 0.25, "believed": 0.3, "mended": 0.1, "constant_velocity": 0.4}
    row = {"joint": "joint elbow", "unit": "rad", "horizon": 0.25, "before": 0.3, "after": 0.1, "noise": 0.01}
    one = result(1.0, 1.0) | {"predictions": made, "joint_errors": [row]}
    one["gap"] |= {"open_loop_before": 0.3, "open_loop_after": 0.1, "open_loop_unit": "rad and m"}
    assert "rad and m" not in " ".join([verdict_sentence(one), *detail_sentences(one)])


def test_what_is_not_all_is_not_said_to_be_all() -> None:
    """Of a gap of millions of times the noise, thousands are left."""
    text = verdict_sentence(result(8328.0, 1.0, before=9e6))
    assert "It explains more than 99 % of the disagreement on recordings that were not used; more than noise" in text
    assert "8328" not in text


def test_the_joint_of_an_actuator_is_named_where_its_name_is_another_one() -> None:
    one = result(1.0, 1.0)
    effect = {
        "effect": "actuator_gain",
        "location": "actuator:m3",
        "parameters": {"change": {"value": 0.1, "unit": "1"}},
    }
    assert "at actuator m3 of joint knee (" in verdict_sentence(one | {"effects": [effect | {"joint": "knee"}]})
    assert "at actuator m3 (" in verdict_sentence(one | {"effects": [effect | {"joint": "m3"}]})


def test_a_gap_that_grows_is_never_said_to_shrink() -> None:
    text = verdict_sentence(result(6415.0, 1.0, before=3323.0))
    details = " ".join(detail_sentences(result(6415.0, 1.0, before=3323.0)))
    assert "the gap does not fall with it: do not rely on this name." in text
    assert "explains" not in text
    assert "The held-out gap grows from 3323 to 6415 χ² per degree of freedom" in details


@pytest.mark.parametrize(
    ("believed", "mended", "steady", "rival"),
    [
        (0.3, 0.1, 0.2, ""),
        (0.3, 0.25, 0.2, "constant velocity"),
        (0.1, 0.15, 0.2, "the believed model"),
        (0.1, 0.1, 0.2, "the believed model"),
    ],
)
def test_a_model_that_beats_no_simple_predictor_says_so_first(
    believed: float, mended: float, steady: float, rival: str
) -> None:
    made = {"horizon": 0.25, "believed": believed, "mended": mended, "constant_velocity": steady}
    one = result(1.0, 1.0) | {"predictions": made}
    first = verdict_sentence(one).partition(". ")[0]
    assert ("do not predict" in first) == bool(rival)
    assert rival in first
    (told,) = [line for line in detail_sentences(one) if line.startswith("Predicted over 0.25 s")]
    assert all(f"{format_number(np.degrees(number))}°" in told for number in (believed, mended, steady))


def test_fitness_has_no_noise() -> None:
    one = result(0.1, 0.0, before=0.4)
    one["gap"] |= {"unit": "m/s of Delta_fitness"}
    assert verdict_sentence(one).endswith("It explains 75 % of Delta_fitness on trials that were not used.")


def test_members_with_a_number_each() -> None:
    rows = {
        f"armature[j{i}]": {"value": 0.1 * i, "low": 0.1 * i - 0.01, "high": 0.1 * i + 0.01, "unit": "kg m^2"}
        for i in range(1, 8)
    }
    entry = {"effect": "armature", "location": "each:subtree:leg", "parameters": rows}
    place = "every joint from body leg down, each with its own number"
    assert effect_at_place(entry) == f"rotor inertia (armature) at {place}"
    assert parameters_in_words(entry) == "armature from 0.1 to 0.7 kg m², the largest at j7"
    few = entry | {"parameters": dict(list(rows.items())[:2])}
    assert parameters_in_words(few) == "armature at j1 0.100 ± 0.010 kg m², armature at j2 0.200 ± 0.010 kg m²"

    named = verdict_sentence(result(1.0, 1.0) | {"effects": [few]})
    assert "is rotor inertia (armature) at every joint from body leg down (armature at j1 0.100" in named


def test_a_relative_change_is_in_per_cent() -> None:
    change = {"value": -0.1, "low": -0.11, "high": -0.09, "unit": "1"}
    entry = {"effect": "actuator_gain", "location": "actuator:c", "parameters": {"change": change}}
    assert parameters_in_words(entry) == "change −10.0 ± 1.0 %"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("dry_friction joint:shoulder torque", "dry friction at joint shoulder"),
        ("dry_friction joint:left knee torque", "dry friction at joint left knee"),
        ("payload body:torso mass", "a payload at body torso, mass"),
        ("armature each:all armature[knee]", "rotor inertia (armature) at knee"),
        ("link length [m]", "link length [m]"),
        ("bl_14", "bl_14"),
    ],
)
def test_numbers_of_a_simulator_that_grew(name: str, words: str) -> None:
    assert number_in_words(name) == words


def test_hypotheses_in_words() -> None:
    name = "dry_friction@joint:knee + payload@body:torso"
    assert hypothesis_in_words(name) == "dry friction at joint knee and a payload at body torso"
    assert hypothesis_in_words("nothing") == "nothing"


def test_every_effect_has_a_title() -> None:
    assert {effect.name for effect in KNOWN_EFFECTS} <= set(EFFECT_WORDS)


UNITS = ("N m", "N", "rad", "m", "kg", "s", "N m s/rad", "kg m^2")
PLACES = ("joint:knee", "joint:leg.knee", "body:torso", "world", "all", "subtree:leg", "actuator:c", "each:all")
_SIZE = st.floats(1e-7, 1e7)


@st.composite
def results(draw: st.DrawFn) -> dict[str, Any]:
    """Results of every kind of verdict."""
    verdict = draw(st.sampled_from(["effect", "none", "unexplained"]))
    entry = st.fixed_dictionaries(
        {"effect": st.sampled_from(sorted(EFFECT_WORDS)), "location": st.sampled_from(PLACES), "score": _SIZE}
    )
    effects = []
    for row in draw(st.lists(entry, min_size=1, max_size=5)) if verdict == "effect" else []:
        count = draw(st.integers(1, 24)) if row["location"] == "each:all" else draw(st.integers(1, 2))
        unit, parameters = draw(st.sampled_from(UNITS)), {}
        for i in range(count):
            value, error = draw(_SIZE), draw(_SIZE)
            ends = {"value": value, "low": value - error, "high": value + draw(_SIZE), "edge": draw(st.booleans())}
            parameters[f"number[{'abcdefghijklmnopqrstuvwxyz'[i]}]"] = ends | {"unit": unit}
        effects.append(row | {"parameters": parameters})
    gap = {key: draw(st.none() | _SIZE) for key in ("before", "after", "nulls", "open_loop_before", "open_loop_after")}
    gap |= {"noise_floor": gap["nulls"], "unit": "χ² per degree of freedom", "open_loop_unit": "rad and m"}
    return {
        "verdict": verdict,
        "effects": effects,
        "gap": gap,
        "joint_errors": [
            {"joint": "joint knee", "horizon": 0.25, "unit": draw(st.sampled_from(["rad", "m"]))}
            | {key: draw(_SIZE) for key in ("before", "after", "noise")}
            for _ in range(draw(st.integers(0, 2)))
        ],
        "where": draw(st.sampled_from(["", "joint leg.knee, when it moves fast"])),
        "ranking": draw(st.lists(entry, max_size=4)),
        "equivalent": draw(st.lists(entry, max_size=6)),
        "share": draw(st.none() | st.floats(-1, 1)),
        "unexplained": draw(st.lists(st.just("joint knee: 41 % of the unexplained force, 0.2 N m"), max_size=3)),
        "next_experiment": draw(st.none() | st.just({"text": "x"})),
    }


def sentences(text: str) -> list[str]:
    return [part for part in re.split(r"[.!?](?:\s|$)", text) if part.strip()]


UNIT = r"(?:N m|N|rad|mm|m|kg|s|times|of the motor torque|%)(?=\W|$)"


@settings(max_examples=300, deadline=None)
@given(results())
def test_verdicts_are_two_sentences_with_units(one: dict[str, Any]) -> None:
    text, details = verdict_sentence(one), detail_sentences(one)
    assert 1 <= len(sentences(text)) <= 2
    assert all(len(sentences(line)) == 1 for line in details)
    everything = " ".join([text, *details])
    assert "SI" not in everything
    before, after = one["gap"]["before"], one["gap"]["after"]
    falls = one["verdict"] == "effect" and before is not None and after is not None and after < before
    assert ("shrink" in everything) == falls
    assert ("explains" in text or "explain " in text) <= (falls or "none of the known effects explains" in text)
    assert not numbers_without_unit(text)


def numbers_without_unit(text: str) -> list[str]:
    """Numbers of a sentence that no unit follows; those of an interval or a range share the unit behind it."""
    number = r"−?\d+(?:\.\d+)?(?:·10\^−?\d+)?"
    text = re.sub(rf"{number} \[{number}, {number}\]", "7", text)
    text = re.sub(rf"{number} ± {number}", "7", text)
    text = re.sub(rf"from {number} to {number}", "7", text)
    text = re.sub(r"\d+ more", "more", text).replace("m²", "m")  # candidates are counted
    return [m[0] for m in re.finditer(number, text) if not re.match(rf"°| {UNIT}", text[m.end() :])]


def test_a_change_beside_what_nobody_explains() -> None:
    before = {"verdict": "unexplained", "sentence": "Something is missing."}
    told = {"verdict": "unexplained", "effects": [], "before": before, "where": "joint elbow"}
    assert verdict_sentence(told).startswith("What has changed cannot be told")
    assert verdict_sentence(told | {"before": {"verdict": "none"}}).startswith("Something has changed")
    same = {
        "verdict": "none",
        "before": before,
        "gap": {"before": 90.0, "after": 90.0, "noise_floor": 1.0, "nulls": 1.0},
    }
    assert "within the noise" not in verdict_sentence(same)
    assert "within the noise" in verdict_sentence(same | {"gap": same["gap"] | {"before": 1.0, "after": 1.0}})


def test_what_was_tried_together_is_no_runner_up() -> None:
    row = {"location": "all", "margin": 0.0, "parameters": {}, "equivalent": False, "beside": []}
    one = result(1.0, 1.0)
    named = {key: one["effects"][0][key] for key in ("effect", "location")}
    together = [row | named | {"score": 90.0}, row | {"effect": "armature", "score": 90.0}]
    assert not any("Runner-up" in line for line in detail_sentences(one | {"ranking": together}))
    # The best hypothesis had several effects, of which one was left as the name.
    pruned = [row | {"effect": name, "location": "each:all", "score": 95.0} for name in ("armature", "dry_friction")]
    assert not any("Runner-up" in line for line in detail_sentences(one | {"ranking": [*pruned, together[0]]}))
    other = [*together, row | {"effect": "backlash", "score": 20.0}]
    assert "Runner-up: backlash" in " ".join(detail_sentences(one | {"ranking": other}))
