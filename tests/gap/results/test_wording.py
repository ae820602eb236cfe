"""Sentences of a verdict."""

import pytest

from btr_mjx.gap.results import verdict_sentence


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
