"""Negative delays are told of the log; anything else stays as it was."""

from dataclasses import replace

import pytest

from btr_mjx.gap.results import Diagnosis, Estimate, NamedEffect, without_late_log


def named(effect: str, value: float) -> NamedEffect:
    estimate = Estimate(value, value - 0.001, value + 0.001, "s", 0.0, False)
    return NamedEffect(effect, "all", {"delay": estimate}, 50.0, 20.0, (), "", "")


def diagnosis(*effects: NamedEffect) -> Diagnosis:
    return Diagnosis(effects, (), 1, 1.0, equivalent=("actuator_lag@all",), notes=("first",))


def test_a_delay_below_zero_alone_leaves_nothing_missing():
    told = without_late_log(diagnosis(named("actuator_delay", -0.0076)))
    assert (told.verdict, told.effects, told.equivalent) == ("none", (), ())
    assert told.notes == ("first", "Commands act 7.6 ms before the time that is logged: their stamps are late.")


def test_other_effects_stay():
    damping = named("viscous_damping", 0.1)
    told = without_late_log(diagnosis(named("actuator_delay", -0.01), damping))
    assert (told.verdict, told.effects) == ("effect", (damping,))
    assert len(told.notes) == 2


@pytest.mark.parametrize("effects", [(named("actuator_delay", 0.01),), (named("viscous_damping", -0.1),), ()])
def test_nothing_else_is_changed(effects):
    given = diagnosis(*effects)
    assert without_late_log(given) is given


def test_a_late_log_is_told_of_what_is_unexplained_as_well():
    told = without_late_log(replace(diagnosis(named("actuator_delay", -0.01)), unexplained=("a force",)))
    assert (told.verdict, told.effects) == ("unexplained", ())
    assert "10 ms" in told.notes[-1]
