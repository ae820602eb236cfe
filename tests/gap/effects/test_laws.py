"""Laws as effects: what they add to a simulation, to a callback, and how they are written."""

import json

import mujoco
import numpy as np
import pytest
from gap_arm import XML, arm

from btr_mjx.gap.effects import LAW_EFFECTS, LAWS, LawState, Scales, candidates, equation_of
from btr_mjx.gap.results import Callback, FoundEffect, mend

EVERY = candidates(arm(), Scales.of(arm()), LAW_EFFECTS)


def values_of(candidate) -> np.ndarray:
    """Coefficients of both signs, and the number within where it starts."""
    return np.array([p.null if p.shape else 5 * p.step * (-1) ** i for i, p in enumerate(candidate.parameters)])


@pytest.mark.parametrize("candidate", EVERY, ids=lambda c: c.name)
def test_a_callback_adds_the_force_of_the_equation(candidate):
    """The force of the term at one state, from its basis functions one by one."""
    values = values_of(candidate)
    found = FoundEffect(
        candidate.effect.name,
        candidate.place.label,
        {p.name: v for p, v in zip(candidate.parameters, values, strict=True)},
    )
    mended = mend(XML, [found])
    assert [term["effect"] for term in mended.terms] == [candidate.effect.name]
    model = mujoco.MjModel.from_xml_string(mended.xml)
    model.dof_frictionloss[:] = 10.0
    missing = Callback(model, json.loads(json.dumps(mended.terms)))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:], data.time = [0.3, -0.5], [1.2, -0.7], [0.1, 0.4], 0.8
    missing(model, data)
    joint, other = candidate.place.joints[0], candidate.place.joints[-1]
    load = data.qfrc_actuator[joint]
    assert load != 0
    one = [
        np.array([float(x)])
        for x in (data.qpos[joint], data.qvel[joint], load, 0.8, data.qpos[other], data.qvel[other])
    ]
    law = candidate.effect.law
    expected = sum(c * f[0] for c, f in zip(values, law.basis(LawState(*one), values[-1]), strict=False))
    added = model.dof_frictionloss - 10.0 if law.friction else data.qfrc_applied
    assert added[joint] == pytest.approx(expected, rel=1e-9)
    assert np.count_nonzero(added) == 1


def test_friction_is_never_negative():
    model = arm()
    missing = Callback(
        model,
        [
            {
                "effect": "law_uneven_friction",
                "location": "joint:shoulder",
                "parameters": {"a": 0.0, "b": -5.0, "ripples": 1.0},
            }
        ],
    )
    data = mujoco.MjData(model)
    missing(model, data)
    assert model.dof_frictionloss[0] == 0


def test_a_sine_and_a_cosine_are_written_as_one():
    ripple = next(c for c in EVERY if c.effect.name == "law_ripple")
    assert equation_of(ripple, (0.3, -0.4, 8.02)) == "τ = 0.5 sin(8.02 q − 0.93)"
    assert equation_of(ripple, (0.3, 0.4, 8.02), latex=True) == r"\tau = 0.5 \sin(8.02 q + 0.93)"
    x = np.linspace(-1, 1, 5)
    np.testing.assert_allclose(0.3 * np.sin(8 * x) + 0.4 * np.cos(8 * x), 0.5 * np.sin(8 * x + np.arctan2(4, 3)))


def test_another_joint_is_named_in_the_equation():
    coupling = next(c for c in EVERY if c.name == "law_coupling@joint:elbow from shoulder")
    assert equation_of(coupling, (-0.25,)) == "τ = −0.25 q_shoulder"


def test_every_term_is_once_in_the_dictionary():
    assert len({law.name for law in LAWS}) == len(LAWS)
    for law in LAWS:
        assert len(law.text) == len(law.latex) == len(law.units)
