"""Sentences of a verdict."""

import pytest

from btr_mjx.gap.results import verdict_sentence
from btr_mjx.gap.results.wording import effect_at_place, parameters_in_words


def result(after: float, nulls: float) -> dict:
    damping = {"value": 0.4, "low": 0.3, "high": 0.5, "unit": "N m s/rad", "null": 0.0, "edge": False}
    effect = {"effect": "viscous_damping", "location": "joint:elbow", "parameters": {"damping": damping}}
    gap = {"before": 180.0, "after": after, "noise_floor": min(nulls, after), "nulls": nulls}
    return {"verdict": "effect", "effects": [effect], "gap": gap | {"closed": (180.0 - after) / 180.0}}


@pytest.mark.parametrize(("after", "expected"), [(23.0, "23 times the noise"), (2.9, ""), (1.0, "")])
def test_a_name_says_how_much_it_leaves(after: float, expected: str) -> None:
    text = verdict_sentence(result(after, 1.0))
    assert "The missing effect is" in text
    assert ("of the held-out gap; " in text) == bool(expected)
    assert expected in text
    assert ("This explains 87 %" in text) == bool(expected)


def test_members_with_a_number_each() -> None:
    rows = {f"armature[j{i}]": {"value": 0.1 * i, "low": 0.1 * i - 0.01, "high": 0.1 * i + 0.01} for i in range(1, 8)}
    entry = {"effect": "armature", "location": "each:subtree:leg", "parameters": rows}
    place = "every joint from body leg down, each with its own number"
    assert effect_at_place(entry) == f"rotor inertia (armature) at {place}"
    assert parameters_in_words(entry) == "armature 0.1 to 0.7"
    few = entry | {"parameters": dict(list(rows.items())[:2])}
    assert parameters_in_words(few) == "armature[j1] 0.100 ± 0.010, armature[j2] 0.200 ± 0.010"
