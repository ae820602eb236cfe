"""Columns of the library are taken beside what is named: what an effect does depends on the motion there."""

from dataclasses import replace

import mujoco
import pytest
from gap_arm import arm
from gap_forces import arm_side, arm_stretches, believed, moved_arm
from gap_models import one

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces.search import first_variances, one_more, start
from btr_mjx.gap.forces.settling import settled
from btr_mjx.gap.simulate import World

MASS, DELAY = 0.1, 0.08


def test_a_mass_is_seen_beside_a_delay() -> None:
    """Without the delay servos pull with other forces, and what the mass does with these says little of it."""
    effects = tuple(e for e in EFFECTS if e.name in ("actuator_delay", "payload"))
    payload, delay = (one(arm(), name, effects) for name in ("payload@body:lower", "actuator_delay@all"))

    def heavy(model: mujoco.MjModel) -> None:
        world = payload.apply(World.of(model), (MASS, 0.3))
        for name in ("body_mass", "body_ipos", "body_inertia", "body_iquat"):
            getattr(model, name)[:] = getattr(world.model, name)

    side = arm_side(arm_stretches([moved_arm(f"r{i}", i, change=heavy, late=-DELAY) for i in (0, 1)]), effects)
    point = replace(start(side, believed()).point, named=((delay, (DELAY,)),))
    fit = settled(side, point, first_variances(side, point.hypothesis(side.library)))
    leads = {lead.candidate.name: lead for lead in one_more(side, fit).leads}
    assert leads[payload.name].values[0] == pytest.approx(MASS, rel=0.15)
    assert next(iter(leads)) == payload.name
    assert leads[payload.name].score > 100
