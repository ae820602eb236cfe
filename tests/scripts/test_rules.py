"""Rules that benchmarks take away, one at a time: what they change exists."""

import importlib

import convention_rules
import force_rules
import pytest


@pytest.mark.parametrize("script", [force_rules, convention_rules])
def test_rules_change_what_there_is(script) -> None:
    for rule, changes in script.RULES.items():
        for module, name, _ in changes:
            assert hasattr(importlib.import_module(f"btr_mjx.gap.{module}"), name), f"{rule}: {module} has no {name}"
