"""Sentences of a verdict."""

from typing import Any

import pytest
from gap_results import misfit_entry

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.results import (
    detail_sentences,
    format_number,
    hypotheses_of,
    hypothesis_in_words,
    number_in_words,
    verdict_sentence,
)
from btr_mjx.gap.results.words.effects import EFFECT_WORDS, effect_at_place
from btr_mjx.gap.results.words.terms import parameters_in_words


def result(after: float, before: float = 180.0, steady: float | None = None, unit: str = "rad") -> dict[str, Any]:
    """A result with one effect at joint elbow, with errors in units of the noise."""
    damping = {"value": 0.4, "low": 0.3, "high": 0.5, "unit": "N m s/rad", "null": 0.0, "edge": False}
    effect = {"effect": "viscous_damping", "location": "joint:elbow", "parameters": {"damping": damping}}
    row = {"joint": "joint elbow", "unit": unit, "horizon": 0.25, "before": 0.001 * before, "after": 0.001 * after}
    row |= {"noise": 0.001, "floor": 0.001, "constant_velocity": None if steady is None else 0.001 * steady}
    return {"verdict": "effect", "effects": [effect]} | with_errors([row])


def with_errors(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {"joint_errors": rows, "misfit": misfit_entry(rows)}


@pytest.mark.parametrize(
    ("after", "subject", "rest"),
    [
        (54.7, "A part of what is missing is", "It explains 70 % of the disagreement on recordings that were not used"),
        (54.7, "viscous damping at joint elbow (damping 0.40 ± 0.10 N m s/rad)", "more than noise is left"),
        (2.1, "A part of what is missing is", "more than noise is left, most of it at joint elbow."),
        (1.0, "The missing effect is", "It explains 100 % of the disagreement on recordings that were not used: "),
        (1.9, "The missing effect is", "the rest is noise."),
    ],
)
def test_a_name_says_how_much_it_explains_and_leaves(after: float, subject: str, rest: str) -> None:
    text = verdict_sentence(result(after))
    assert subject in text
    assert rest in text


@pytest.mark.parametrize(
    ("unit", "before", "after", "noise"),
    [("rad", "17.2°", "0.00573°", "0.00115°"), ("m", "300 mm", "0.1 mm", "0.02 mm")],
)
def test_the_joint_that_has_it_is_told_in_the_unit_of_its_kind(unit: str, before: str, after: str, noise: str) -> None:
    rows = [
        {
            "joint": f"joint {name}",
            "unit": unit,
            "horizon": 0.25,
            "before": first,
            "after": 1e-4,
            "noise": 2e-5,
            "floor": 2e-5,
        }
        for name, first in (("shoulder", 0.4), ("elbow", 0.3))
    ]
    told = f"joint elbow is off by {after} instead of {before}, where noise and the time step make {noise}"
    assert told in verdict_sentence(result(1.0) | with_errors(rows))
    elsewhere = result(1.0) | with_errors(rows[:1])  # the effect is at a joint that is not measured
    assert "joint shoulder is off by" in verdict_sentence(elsewhere)


def test_radians_and_metres_are_not_added() -> None:
    one = result(1.0) | {"open_loop": {"before": 0.3, "after": 0.1, "unit": "rad and m"}}
    everything = " ".join([verdict_sentence(one), *detail_sentences(one)])
    assert "rad and m" not in everything
    assert "whole held-out recordings" not in everything


def test_what_is_not_all_is_not_said_to_be_all() -> None:
    """Of an error of millions of times the noise, thousands are left."""
    text = verdict_sentence(result(8328.0, before=9e6))
    assert "It explains more than 99 % of the disagreement on recordings that were not used: " in text
    assert "8328" not in text
    assert "more than noise is left" in text


def test_the_joint_of_an_actuator_is_named_where_its_name_is_another_one() -> None:
    one = result(1.0)
    effect = {
        "effect": "actuator_gain",
        "location": "actuator:m3",
        "parameters": {"change": {"value": 0.1, "unit": "1"}},
    }
    assert "at actuator m3 of joint knee (" in verdict_sentence(one | {"effects": [effect | {"joint": "knee"}]})
    assert "at actuator m3 (" in verdict_sentence(one | {"effects": [effect | {"joint": "m3"}]})


def test_a_misfit_that_grows_is_never_said_to_shrink() -> None:
    text = verdict_sentence(result(6415.0, before=3323.0))
    details = " ".join(detail_sentences(result(6415.0, before=3323.0)))
    assert "predictions are no better with it: do not rely on this name." in text
    assert "explains" not in text
    assert "does not fall: it goes from 3323 to 6415 (1: what noise and the time step make" in details


@pytest.mark.parametrize(
    ("believed", "mended", "steady", "rival"),
    [
        (300, 100, 200, ""),
        (300, 250, 200, "constant velocity"),
        (100, 150, 200, "the believed model"),
        (100, 100, 200, "the believed model"),
    ],
)
def test_a_model_that_beats_no_simple_predictor_says_so_first(
    believed: float, mended: float, steady: float, rival: str
) -> None:
    one = result(mended, believed, steady)
    first = verdict_sentence(one).partition(". ")[0]
    assert ("do not predict" in first) == bool(rival)
    assert rival in first
    (told,) = [line for line in detail_sentences(one) if line.startswith("The misfit of predictions over 0.25 s")]
    assert all(format_number(number) in told for number in (believed, mended, steady))


def test_fitness_has_no_noise() -> None:
    row = {"joint": "Delta_fitness", "unit": "m/s", "horizon": 2.0, "before": 0.4, "after": 0.1}
    one = result(1.0) | with_errors([row])
    assert verdict_sentence(one).endswith("It explains 75 % of Delta_fitness on trials that were not used.")
    assert "noise" not in " ".join([verdict_sentence(one), *detail_sentences(one)])


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

    named = verdict_sentence(result(1.0) | {"effects": [few]})
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


def test_a_change_beside_what_nobody_explains() -> None:
    before = {"verdict": "unexplained", "sentence": "Something is missing."}
    told = {"verdict": "unexplained", "effects": [], "before": before, "where": "joint elbow"}
    assert verdict_sentence(told).startswith("What has changed cannot be told")
    assert verdict_sentence(told | {"before": {"verdict": "none"}}).startswith("Something has changed")
    same = {"verdict": "none", "before": before}
    assert "within the noise" not in verdict_sentence(result(90.0, 90.0) | same)
    assert "within the noise" in verdict_sentence(result(1.0, 1.0) | same)


def test_what_was_tried_together_is_no_runner_up() -> None:
    row = {"location": "all", "margin": 0.0, "parameters": {}, "equivalent": False, "beside": []}
    one = result(1.0)
    named = {key: one["effects"][0][key] for key in ("effect", "location")}
    names = [f"{named['effect']}@{named['location']}", "armature@all"]
    together = [row | named | {"score": 90.0, "together": names}]
    together += [row | {"effect": "armature", "score": 90.0, "together": names}]
    assert not any("Runner-up" in line for line in detail_sentences(one | {"ranking": together}))
    # The best hypothesis had several effects, of which one was left as the name.
    names = ["armature@each:all", "dry_friction@each:all"]
    pruned = [
        row | {"effect": name.partition("@")[0], "location": "each:all", "score": 95.0, "together": names}
        for name in names
    ]
    assert not any("Runner-up" in line for line in detail_sentences(one | {"ranking": [*pruned, together[0]]}))
    other = [*together, row | {"effect": "backlash", "score": 20.0}]
    assert "Runner-up: backlash" in " ".join(detail_sentences(one | {"ranking": other}))


def test_members_of_one_hypothesis_are_told_together() -> None:
    names = [f"{name}@all" for name in ("dry_friction", "viscous_damping", "armature")]
    rows = [
        {"effect": name.partition("@")[0], "location": "all", "score": 40.0, "together": names, "parameters": {}}
        for name in names
    ]
    one = result(90.0) | {"verdict": "unexplained", "effects": [], "ranking": rows, "share": 0.4}
    (told,) = [line for line in detail_sentences(one) if "best candidate" in line]
    assert "dry friction, viscous damping and rotor inertia (armature) at all joints, together" in told
    assert [len(many) for many in hypotheses_of(rows)] == [3]


def test_calibration_that_is_far_off_is_a_finding() -> None:
    mass = {"mass": {"value": 0.6, "low": None, "high": None, "unit": "kg"}}
    row = {"effect": "payload", "location": "body:hand", "parameters": mass, "tolerances": 3.14}
    nothing = result(1.0) | {"verdict": "none", "effects": [], "calibration": [row]}
    assert verdict_sentence(nothing) == (
        "Nothing is missing: simulation and data agree within the noise once calibration is set right. "
        "Mass of body hand is off by 0.6 kg (3.1 times its tolerance)."
    )
    usual = nothing | {"calibration": [row | {"tolerances": 1.9}]}
    assert "usual tolerances" in verdict_sentence(usual)
    assert "off by" not in verdict_sentence(usual)
    named = result(1.0) | {"calibration": [row]}
    assert "Mass of body hand is off by 0.6 kg (3.1 times its tolerance)." in detail_sentences(named)
