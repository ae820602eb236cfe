"""Drives of servos whose stiffness is not the believed one, from recordings of the arm."""

from dataclasses import replace

import mujoco
import numpy as np
from gap_arm import LIBRARY
from gap_forces import arm_side, arm_stretches, believed, moved_arm

from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.forces.drive import drive_points
from btr_mjx.gap.forces.search import start

NAMES = ("dry_friction", "viscous_damping", "armature", "offset_torque", "servo_stiffness")
EFFECTS = tuple(e for e in KNOWN_EFFECTS if e.name in NAMES)


def soft(model: mujoco.MjModel) -> None:
    """A tenth of the stiffness at the shoulder and a quarter at the elbow, and friction."""
    model.actuator_gainprm[:, 0] *= [0.1, 0.25]
    model.actuator_biasprm[:, 1] *= [0.1, 0.25]
    model.dof_frictionloss[:] += [0.2, 0.1]


def test_stiffness_and_friction_of_servos_are_found_together():
    side = arm_side(arm_stretches([moved_arm(f"r{i}", i, change=soft, seconds=1.5) for i in range(2)]), EFFECTS)
    fit = start(side, believed())
    plain, servos, soft_alone = drive_points(side, fit)
    assert [c.effect.name for c, _ in plain.named] == list(NAMES[:4])
    found = {c.effect.name: values for c, values in servos.named}
    assert list(found) == list(NAMES)
    np.testing.assert_allclose(found["servo_stiffness"], [-0.9, -0.75], atol=0.03)
    np.testing.assert_allclose(found["dry_friction"], [0.2, 0.1], rtol=0.6)
    assert [c.effect.name for c, _ in soft_alone.named] == ["servo_stiffness"]
    assert drive_points(side, replace(fit, point=servos)) == []


def test_servos_without_an_effect_of_stiffness_have_the_believed_one():
    effects = tuple(e for e in LIBRARY if e.name in NAMES[:3])
    side = arm_side(arm_stretches([moved_arm(f"r{i}", i, change=soft) for i in range(2)]), effects)
    fit = start(side, believed())
    points = drive_points(side, fit)
    assert len(points) == 1
    assert {c.effect.name for c, _ in points[0].named} == {e.name for e in effects}
